/* The vehicle of benchmarks/speed/vehicle.py as a careful engineer would write it by hand.

   Six degrees of freedom, full M = M_RB + M_A and D, quadratic damping, restoring, a steady current, eight
   thrusters. All that depends on parameters alone is in the struct. In a steady irrotational current the rigid
   body may be stated in the relative velocity, too, so that one momentum h = M nu_r serves for both Coriolis
   terms. Matrices are stored by columns of eight, so that the compiler can put several rows into one vector.

   Include this file, or compile it to a library: hand_dynamics(x, u, p, x_dot). */

#include <math.h>

#define HAND_ROWS 8

typedef struct {
  double mass[6][HAND_ROWS];      /* M */
  double inverse[6][HAND_ROWS];   /* M^-1 */
  double damping[6][HAND_ROWS];   /* D, linear: force = D nu_r */
  double allocation[8][HAND_ROWS]; /* force and moment of each command */
  double quadratic[HAND_ROWS];    /* force = quadratic |nu_r| nu_r */
  double moment[4];               /* static moments of weight and buoyancy */
  double weight;                  /* weight minus buoyancy */
  double current[3];              /* velocity of the water, north, east, down */
} HandParameters;

static inline void hand_cross(const double *a, const double *b, double *c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}

/* y += A x, row by row: sums in registers; by columns, with y in memory, it takes half as long again. */
static inline void hand_add(int n, const double (*restrict a)[HAND_ROWS], const double *restrict x, double *restrict y) {
  for (int i = 0; i < 6; i++) {
    double sum = y[i];
    for (int j = 0; j < n; j++) sum += a[j][i] * x[j];
    y[i] = sum;
  }
}

static inline void hand_dynamics(const double *restrict x, const double *restrict u, const HandParameters *restrict p,
                                 double *restrict x_dot) {
  const double sf = sin(x[3]), cf = cos(x[3]), st = sin(x[4]), ct = cos(x[4]), ss = sin(x[5]), cs = cos(x[5]);
  const double *v = x + 6, *w = x + 9;
  const double r11 = cs * ct, r21 = ss * ct, cs_st = cs * st, ss_st = ss * st;
  const double r12 = cs_st * sf - ss * cf, r13 = cs_st * cf + ss * sf;
  const double r22 = ss_st * sf + cs * cf, r23 = ss_st * cf - cs * sf;
  const double down[3] = {-st, ct * sf, ct * cf};

  x_dot[0] = r11 * v[0] + r12 * v[1] + r13 * v[2];
  x_dot[1] = r21 * v[0] + r22 * v[1] + r23 * v[2];
  x_dot[2] = down[0] * v[0] + down[1] * v[1] + down[2] * v[2];
  x_dot[4] = cf * w[1] - sf * w[2];
  x_dot[5] = (sf * w[1] + cf * w[2]) / ct;
  x_dot[3] = w[0] + st * x_dot[5];

  const double *c = p->current;
  const double water[3] = {r11 * c[0] + r21 * c[1] + down[0] * c[2], r12 * c[0] + r22 * c[1] + down[1] * c[2],
                           r13 * c[0] + r23 * c[1] + down[2] * c[2]};
  const double nu[HAND_ROWS] = {v[0] - water[0], v[1] - water[1], v[2] - water[2], w[0], w[1], w[2]};
  double h[HAND_ROWS] = {0}, force[HAND_ROWS], a[HAND_ROWS] = {0};
  double w_h1[3], v_h1[3], w_h2[3], righting[3], turning[3];
  hand_add(6, p->mass, nu, h);
  hand_cross(w, h, w_h1);
  hand_cross(nu, h, v_h1);
  hand_cross(w, h + 3, w_h2);
  hand_cross(p->moment, down, righting);
  hand_cross(w, water, turning);

  for (int i = 0; i < 6; i++) force[i] = p->quadratic[i] * fabs(nu[i]) * nu[i];
  hand_add(6, p->damping, nu, force);
  hand_add(8, p->allocation, u, force);
  for (int i = 0; i < 3; i++) {
    force[i] += p->weight * down[i] - w_h1[i];
    force[3 + i] += righting[i] - v_h1[i] - w_h2[i];
  }
  hand_add(6, p->inverse, force, a);
  for (int i = 0; i < 6; i++) x_dot[6 + i] = a[i];
  for (int i = 0; i < 3; i++) x_dot[6 + i] -= turning[i];
}
