/* Classical fourth-order Runge-Kutta over a whole log, inputs held between samples.

   Compiled together with the generated function. What stands before this defines
     NX, NU           numbers of states and inputs
     ND               number of degrees of freedom; rows ND .. 2 ND - 1 of x_dot hold the acceleration
     tangents         (x, u, p, t, x_dot, W, R_x, R_p), and the sparsity of R_x and R_p:
     RX_COLUMN, RX_ROW, RX_NONZEROS, RP_COLUMN, RP_ROW, RP_NONZEROS
   and SIMULATE, the name under which the entry point is exported.

   Everything a call needs lives on its stack or in the block it allocates: calls may run in parallel. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#define SLOPES_PER_CALL (NX + ND * ND + RX_NONZEROS + RP_NONZEROS)

typedef struct {
  const double *u, *p;  /* held inputs, parameters */
  const int64_t *wrt;   /* parameter of every sensitivity column, -1 for a column of an initial state */
  int64_t columns;      /* number of sensitivity columns */
  double *slopes;       /* x_dot, then W, R_x, R_p */
  double *z, *dz, *sum; /* tangent at a stage, its rate, its weighted sum: each NX x columns, row by row */
  double *force;        /* ND x columns */
} Workspace;

static int is_finite(const double *x, int64_t n) {
  for (int64_t i = 0; i < n; i++)
    if (!(x[i] - x[i] == 0)) return 0;
  return 1;
}

static void fill_nan(double *x, int64_t n) {
  for (int64_t i = 0; i < n; i++) x[i] = NAN;
}

static void evaluate(Workspace *work, const double *x, double t) {
  double *f = work->slopes, *w = f + NX, *rx = w + ND * ND, *rp = rx + RX_NONZEROS;
  tangents(x, work->u, work->p, t, f, w, rx, rp);
}

static void add_multiple(int64_t n, double factor, const double *restrict from, double *restrict to) {
  for (int64_t i = 0; i < n; i++) to[i] += factor * from[i];
}

/* dz = d(x_dot)/dx z + d(x_dot)/dp, column by column of what the sensitivities are wanted for. */
static void tangent_rate(Workspace *work, const double *z) {
  const int64_t m = work->columns;
  const double *w = work->slopes + NX, *rx = w + ND * ND, *rp = rx + RX_NONZEROS;
  double *dz = work->dz;
  for (int64_t i = 0; i < NX * m; i++) dz[i] = 0;
  for (int64_t j = 0; j < NX; j++)
    for (int64_t k = RX_COLUMN[j]; k < RX_COLUMN[j + 1]; k++) add_multiple(m, rx[k], z + j * m, dz + RX_ROW[k] * m);
  for (int64_t c = 0; c < m; c++) {
    const int64_t j = work->wrt[c];
    if (j < 0) continue;
    for (int64_t k = RP_COLUMN[j]; k < RP_COLUMN[j + 1]; k++) dz[RP_ROW[k] * m + c] += rp[k];
  }
  /* The rows of the acceleration hold forces so far; W turns them into accelerations. */
  double *force = work->force, *acceleration = dz + ND * m;
  for (int64_t i = 0; i < ND * m; i++) force[i] = acceleration[i], acceleration[i] = 0;
  for (int64_t i = 0; i < ND; i++)
    for (int64_t j = 0; j < ND; j++) add_multiple(m, w[j * ND + i], force + j * m, acceleration + i * m);
}

/* One step of length h from t; x (NX) and, with sensitivities, s (NX x columns) are advanced in place. */
static void step(Workspace *work, double t, double h, double *x, double *s) {
  const double reach[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
  double stage[NX], total[NX];
  const double *f = work->slopes;
  for (int64_t i = 0; i < NX; i++) stage[i] = x[i], total[i] = 0;
  const int64_t size = NX * work->columns;
  for (int64_t i = 0; i < size; i++) work->z[i] = s[i], work->sum[i] = 0;
  for (int k = 0; k < 4; k++) {
    evaluate(work, stage, t + reach[k] * h);
    const double next = k < 3 ? reach[k + 1] * h : 0;
    for (int64_t i = 0; i < NX; i++) total[i] += weight[k] * f[i], stage[i] = x[i] + next * f[i];
    tangent_rate(work, work->z);
    for (int64_t i = 0; i < size; i++) {
      work->sum[i] += weight[k] * work->dz[i];
      work->z[i] = s[i] + next * work->dz[i];
    }
  }
  for (int64_t i = 0; i < NX; i++) x[i] += h / 6 * total[i];
  for (int64_t i = 0; i < size; i++) s[i] += h / 6 * work->sum[i];
}

/* From sample i to sample i + 1 of one run; states that are not finite become NaN and stay so. */
static void advance(Workspace *work, double t, double interval, int64_t steps, double *x, double *s) {
  const int64_t size = NX * work->columns;
  double *x_next = x + NX, *s_next = s + size;
  for (int64_t i = 0; i < NX; i++) x_next[i] = x[i];
  for (int64_t i = 0; i < size; i++) s_next[i] = s[i];
  const double h = interval / (double)steps;
  for (int64_t k = 0; k < steps && is_finite(x_next, NX); k++) step(work, t + (double)k * h, h, x_next, s_next);
  if (is_finite(x_next, NX)) return;
  fill_nan(x_next, NX);
  fill_nan(s_next, size);
}

/* Samples first .. last of every run of a batch; sample `first` of x and s is there already.
   Strides are the distances between runs in t, steps (t - 1), u and p, zero where all runs share them.
   Returns 1 if there is no memory. */
EXPORTED int SIMULATE(int64_t batch, int64_t samples, int64_t first, int64_t last, const double *t, int64_t t_stride,
             const int64_t *steps, const double *u, int64_t u_stride, const double *p, int64_t p_stride,
             const int64_t *wrt, int64_t columns, double *x, double *s);

int SIMULATE(int64_t batch, int64_t samples, int64_t first, int64_t last, const double *t, int64_t t_stride,
             const int64_t *steps, const double *u, int64_t u_stride, const double *p, int64_t p_stride,
             const int64_t *wrt, int64_t columns, double *x, double *s) {
  const int64_t size = NX * columns;
  double *block = malloc(sizeof(double) * (size_t)(SLOPES_PER_CALL + 3 * size + ND * columns));
  if (!block) return 1;
  double *z = block + SLOPES_PER_CALL;
  Workspace work = {0, 0, wrt, columns, block, z, z + size, z + 2 * size, z + 3 * size};
  for (int64_t b = 0; b < batch; b++) {
    const double *time = t + b * t_stride;
    const int64_t *count = steps + (t_stride ? b * (samples - 1) : 0);
    work.p = p + b * p_stride;
    for (int64_t i = first; i < last; i++) {
      const int64_t row = b * samples + i;
      work.u = u + b * u_stride + i * NU;
      advance(&work, time[i], time[i + 1] - time[i], count[i], x + row * NX, s + row * size);
    }
  }
  free(block);
  return 0;
}
