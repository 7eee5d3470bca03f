/* A closed loop by hand: the model of hand.c, a PID law with gravity compensation in pose coordinates, thrust
   allocation by a pseudo-inverse, fourth-order Runge-Kutta, one step for each sample of the controller. */

#include "hand.c"

typedef struct {
  double proportional[6], damping[6], integral[6];
  double inverse[8][6]; /* command of each thruster for a force */
} HandGains;

static inline void hand_control(const double *restrict x, const double *restrict sum, const double *restrict desired,
                                const HandGains *restrict k, const HandParameters *restrict p, double *restrict u,
                                double *restrict error) {
  const double sf = sin(x[3]), cf = cos(x[3]), st = sin(x[4]), ct = cos(x[4]), ss = sin(x[5]), cs = cos(x[5]);
  const double r[3][3] = {{cs * ct, cs * st * sf - ss * cf, cs * st * cf + ss * sf},
                          {ss * ct, ss * st * sf + cs * cf, ss * st * cf - cs * sf},
                          {-st, ct * sf, ct * cf}};
  const double *v = x + 6, *w = x + 9;
  const double turn = (sf * w[1] + cf * w[2]) / ct;
  double rate[6] = {0, 0, 0, w[0] + st * turn, cf * w[1] - sf * w[2], turn}, y[6], force[6];
  double righting[3];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) rate[i] += r[i][j] * v[j];
  for (int i = 0; i < 6; i++) {
    error[i] = desired[i] - x[i];
    if (i > 2) error[i] -= 2 * M_PI * floor((error[i] + M_PI) / (2 * M_PI));
    y[i] = k->proportional[i] * error[i] - k->damping[i] * rate[i] + k->integral[i] * sum[i];
  }
  hand_cross(p->moment, r[2], righting);
  for (int i = 0; i < 3; i++) force[i] = r[0][i] * y[0] + r[1][i] * y[1] + r[2][i] * y[2] - p->weight * r[2][i];
  const double lever = (st * y[3] + y[5]) / ct;
  force[3] = y[3] - righting[0];
  force[4] = sf * lever + cf * y[4] - righting[1];
  force[5] = cf * lever - sf * y[4] - righting[2];
  for (int i = 0; i < 8; i++) {
    u[i] = 0;
    for (int j = 0; j < 6; j++) u[i] += k->inverse[i][j] * force[j];
  }
}

void hand_rollout(long samples, double dt, const HandParameters *p, const HandGains *k, const double *start,
                  const double *desired, long stride, double *restrict log) {
  double x[12], sum[6] = {0}, u[8], error[6], rate[12], total[12], stage[12];
  for (int i = 0; i < 12; i++) x[i] = start[i];
  for (long n = 0; n < samples; n++) {
    if (n % stride == 0) {
      for (int i = 0; i < 12; i++) log[i] = x[i];
      log += 12;
    }
    hand_control(x, sum, desired, k, p, u, error);
    for (int i = 0; i < 6; i++) sum[i] += dt * error[i];
    hand_dynamics(x, u, p, rate);
    for (int i = 0; i < 12; i++) total[i] = rate[i], stage[i] = x[i] + 0.5 * dt * rate[i];
    hand_dynamics(stage, u, p, rate);
    for (int i = 0; i < 12; i++) total[i] += 2 * rate[i], stage[i] = x[i] + 0.5 * dt * rate[i];
    hand_dynamics(stage, u, p, rate);
    for (int i = 0; i < 12; i++) total[i] += 2 * rate[i], stage[i] = x[i] + dt * rate[i];
    hand_dynamics(stage, u, p, rate);
    for (int i = 0; i < 12; i++) x[i] += dt / 6 * (total[i] + rate[i]);
  }
}

/* Runs that differ in their parameters. */
void hand_batch(long runs, int threads, long samples, double dt, const HandParameters *p, const HandGains *k,
                const double *start, const double *desired, long stride, double *log) {
  const long rows = (samples - 1) / stride + 1;
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
  for (long b = 0; b < runs; b++) hand_rollout(samples, dt, p + b, k, start, desired, stride, log + b * rows * 12);
}
