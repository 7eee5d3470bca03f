
/* Command of a thrust, between the points of the thruster's curve; beyond them that of the nearest end. */
@LOWER@_real @LOWER@_command(int thruster, @LOWER@_real thrust) {
  const @LOWER@_real *x = thrusts[thruster], *y = commands[thruster];
  int i = 1;
  if (thrust <= x[0]) {
    return y[0];
  }
  while ((i < POINTS - 1) && (thrust > x[i])) {
    i++;
  }
  if (thrust >= x[i]) {
    return y[i];
  }
  return y[i - 1] + (y[i] - y[i - 1]) * (thrust - x[i - 1]) / (x[i] - x[i - 1]);
}

/* Width of a servo pulse in microseconds for a command, within its ends. */
@LOWER@_real @LOWER@_pulse(@LOWER@_real command, const @LOWER@_pulses *pulses) {
  const @LOWER@_real share = command / pulses->full_command;
  const @LOWER@_real held = (share > (@LOWER@_real)1) ? (@LOWER@_real)1
                            : ((share < (@LOWER@_real)-1) ? (@LOWER@_real)-1 : share);
  return pulses->neutral + held * pulses->span;
}
