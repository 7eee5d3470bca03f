
/* One fourth-order Runge-Kutta step of h seconds from t, u held. */
void @LOWER@_vehicle_step(@LOWER@_real *x, const @LOWER@_real *u, const @LOWER@_parameters *p, @LOWER@_real t,
                          @LOWER@_real h) {
  static const @LOWER@_real reach[5] = {(@LOWER@_real)0, (@LOWER@_real)0.5, (@LOWER@_real)0.5, (@LOWER@_real)1,
                                        (@LOWER@_real)0};
  static const @LOWER@_real weight[4] = {(@LOWER@_real)1, (@LOWER@_real)2, (@LOWER@_real)2, (@LOWER@_real)1};
  @LOWER@_real stage[@UPPER@_STATES];
  @LOWER@_real rate[@UPPER@_STATES];
  @LOWER@_real total[@UPPER@_STATES];
  for (int i = 0; i < @UPPER@_STATES; i++) {
    stage[i] = x[i];
    total[i] = (@LOWER@_real)0;
  }
  for (int k = 0; k < 4; k++) {
    @LOWER@_dynamics(stage, u, p, t + (reach[k] * h), rate);
    for (int i = 0; i < @UPPER@_STATES; i++) {
      total[i] += weight[k] * rate[i];
      stage[i] = x[i] + (reach[k + 1] * h * rate[i]);
    }
  }
  for (int i = 0; i < @UPPER@_STATES; i++) {
    x[i] += h / (@LOWER@_real)6 * total[i];
  }
}
