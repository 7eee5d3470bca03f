/* Classical fourth-order Runge-Kutta over logs, inputs held between samples; LANES runs side by side (lanes.h).

   Compiled together with the generated functions. What stands before this defines
     NX, NU, NP       numbers of states, inputs and parameters
     NQ, NW           numbers of what follows from parameters alone, and from that and held inputs
   (none of the arrays is empty: what has no entry counts one) and the functions
     prepare(p, q), hold(u, q, w), held_dynamics(x, w, q, t, x_dot)
   and RUN, the name under which the entry point is exported.

   Arrays hold the lanes of a number side by side, so that a group of LANES runs is read like one run. Calls for
   different groups may run in parallel. */

#define GROUP 1
#define NUMBER Real
#define TIME Real
#include "runge_kutta.h"

typedef struct {
  int64_t samples;                        /* of a run in these arrays */
  int64_t t_step, count_step, u_step, p_step; /* distances from group to group, zero for what all runs share */
  const double *t, *count, *u, *p;        /* times, Runge-Kutta steps to the next sample, inputs, parameters */
  double *x;                              /* states; those of the first sample are given */
} Logs;

INLINE void take(Real *to, const double *from, int n) {
  for (int i = 0; i < n; i++) to[i] = ((const Stored *)from)[i];
}

typedef struct {
  const Real *w, *q;
} Held;

INLINE void rates(void *system, const Real *t, const Real *x, Real *x_dot) {
  const Held *held = system;
  held_dynamics(x, held->w, held->q, *t, x_dot);
}

/* One step of length h from t; lanes that have no step left stay where they are. */
INLINE void step(Held *held, Real t, Real h, Truth moving, Real *x) {
  Real next[NX], room[3 * NX];
  for (int i = 0; i < NX; i++) next[i] = x[i];
  runge_kutta(rates, held, 1, NX, 0, &t, &h, next, room);
  for (int i = 0; i < NX; i++) x[i] = real_where(moving, next[i], x[i]);
}

/* States that are not finite become NaN, and so do the others of their run. */
INLINE void settle(Real *x) {
  Real nothing = real(0);
  for (int i = 0; i < NX; i++) nothing += x[i] - x[i];
  for (int i = 0; i < NX; i++) x[i] = real_where(nothing == 0.0, x[i], real(NAN));
}

INLINE void run_group(const Logs *logs, const double *time, const double *count, const double *input, const Real *q,
                      double *states) {
  Real x[NX], u[NU], w[NW], t, next, steps;
  take(x, states, NX);
  for (int64_t i = 0; i + 1 < logs->samples; i++) {
    take(u, input + i * NU * LANES, NU);
    take(&t, time + i * LANES, 1);
    take(&next, time + (i + 1) * LANES, 1);
    take(&steps, count + i * LANES, 1);
    double most = 0;
    for (int l = 0; l < LANES; l++) most = LANE(steps, l) > most ? LANE(steps, l) : most;
    const Real h = (next - t) / steps;
    hold(u, q, w);
    Held held = {w, q};
    for (double k = 0; k < most; k++) step(&held, t + k * h, h, k < steps, x);
    settle(x);
    for (int j = 0; j < NX; j++) ((Stored *)(states + (i + 1) * NX * LANES))[j] = x[j];
  }
}

EXPORTED void RUN(const Logs *logs, int64_t groups);

void RUN(const Logs *logs, int64_t groups) {
  for (int64_t g = 0; g < groups; g++) {
    Real p[NP], q[NQ];
    take(p, logs->p + g * logs->p_step, NP);
    prepare(p, q);
    run_group(logs, logs->t + g * logs->t_step, logs->count + g * logs->count_step, logs->u + g * logs->u_step, q,
              logs->x + g * logs->samples * NX * LANES);
  }
}
