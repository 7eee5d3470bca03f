
/* Command of a thrust, between the points of the thruster's curve; beyond them that of the nearest end. */
@LOWER@_real @LOWER@_command(int thruster, @LOWER@_real thrust, const @LOWER@_thrusters *h) {
  const @LOWER@_real *x = h->thrusts[thruster];
  const @LOWER@_real *y = h->commands[thruster];
  @LOWER@_real command = y[0];
  if (thrust > x[0]) {
    int i = 1;
    while ((i < (@UPPER@_POINTS - 1)) && (thrust > x[i])) {
      i++;
    }
    command = y[i];
    if (thrust < x[i]) {
      command = y[i - 1] + ((y[i] - y[i - 1]) * (thrust - x[i - 1]) / (x[i] - x[i - 1]));
    }
  }
  return command;
}

/* Width of a servo pulse in microseconds for a command, within its ends. */
@LOWER@_real @LOWER@_pulse(@LOWER@_real command, const @LOWER@_thrusters *h) {
  const @LOWER@_real share = command / h->full_command;
  const @LOWER@_real held = (share > (@LOWER@_real)1) ? (@LOWER@_real)1
                            : ((share < (@LOWER@_real)-1) ? (@LOWER@_real)-1 : share);
  return h->neutral + (held * h->span);
}
