
/* Command of a thrust, between the points of the thruster's curve; beyond them that of the nearest end. */
@LOWER@_real @LOWER@_command(int thruster, @LOWER@_real thrust, const @LOWER@_thrusters *h) {
  const @LOWER@_real *x = h->thrusts[thruster], *y = h->commands[thruster];
  int i = 1;
  if (thrust <= x[0]) {
    return y[0];
  }
  while ((i < @UPPER@_POINTS - 1) && (thrust > x[i])) {
    i++;
  }
  if (thrust >= x[i]) {
    return y[i];
  }
  return y[i - 1] + (y[i] - y[i - 1]) * (thrust - x[i - 1]) / (x[i] - x[i - 1]);
}

/* Width of a servo pulse in microseconds for a command, within its ends. */
@LOWER@_real @LOWER@_pulse(@LOWER@_real command, const @LOWER@_thrusters *h) {
  const @LOWER@_real share = command / h->full_command;
  const @LOWER@_real held = (share > (@LOWER@_real)1) ? (@LOWER@_real)1
                            : ((share < (@LOWER@_real)-1) ? (@LOWER@_real)-1 : share);
  return h->neutral + held * h->span;
}
