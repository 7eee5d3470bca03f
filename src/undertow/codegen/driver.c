/* Classical fourth-order Runge-Kutta over a whole log, inputs held between samples.

   What stands before this is either a generated function and its model's sizes,
     NX, NU           numbers of states and inputs
     ND               number of degrees of freedom; rows ND .. 2 ND - 1 of x_dot hold the acceleration
     tangents         (x, u, p, t, x_dot, W, R_x, R_p), and the sparsity of R_x and R_p:
     RX_COLUMN, RX_ROW, RX_NONZEROS, RP_COLUMN, RP_ROW, RP_NONZEROS
   or tape.c and INTERPRETED: then the model is data, and its instructions run over BLOCK runs side by side.
   SIMULATE is the name under which the entry point is exported.

   Everything a call needs lives on its stack or in the block it allocates: calls may run in parallel. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#ifdef INTERPRETED
#define GROUP BLOCK
typedef struct {
  Tape tape;
  int64_t nx, nu, nd;                                 /* as NX, NU, ND; no ND where no sensitivities are wanted */
  const int64_t *rx_column, *rx_row, *rp_column, *rp_row; /* sparsity of R_x and R_p, columns compressed */
  int64_t rx_nonzeros, rp_nonzeros;
} Model;
#define NX (work->model->nx)
#define NU (work->model->nu)
#define ND (work->model->nd)
#define RX_COLUMN work->model->rx_column
#define RX_ROW work->model->rx_row
#define RX_NONZEROS (work->model->rx_nonzeros)
#define RP_COLUMN work->model->rp_column
#define RP_ROW work->model->rp_row
#define RP_NONZEROS (work->model->rp_nonzeros)
#define REGISTERS (work->model->tape.slots * BLOCK)
#define MODEL_GIVEN const Model *model,
#else
#define GROUP 1
#define REGISTERS 0
#define MODEL_GIVEN
#endif

#define SLOPES_PER_CALL (NX + ND * ND + RX_NONZEROS + RP_NONZEROS)

/* Of every run of a group one after the other, where nothing else is said. */
typedef struct {
#ifdef INTERPRETED
  const Model *model;
#endif
  const double *u, *p; /* held inputs and parameters of the first run, and the distances to the next */
  int64_t u_stride, p_stride;
  const int64_t *wrt; /* parameter of every sensitivity column, -1 for a column of an initial state */
  int64_t columns;    /* number of sensitivity columns */
  int64_t runs;       /* how many the group has */
  double *slopes;     /* x_dot, then W, R_x, R_p */
  double *stage, *total;
  double *z, *dz, *sum; /* tangent at a stage, its rate, its weighted sum: each NX x columns, row by row */
  double *force;        /* ND x columns; the same for all runs */
  double *registers;
} Workspace;

static int is_finite(const double *x, int64_t n) {
  for (int64_t i = 0; i < n; i++)
    if (!(x[i] - x[i] == 0)) return 0;
  return 1;
}

static void fill_nan(double *x, int64_t n) {
  for (int64_t i = 0; i < n; i++) x[i] = NAN;
}

/* Slopes of all runs at their stages, each at its time. */
static void evaluate(Workspace *work, const double *t) {
  double *f = work->slopes, *w = f + NX, *rx = w + ND * ND, *rp = rx + RX_NONZEROS;
#ifdef INTERPRETED
  const double *const in[] = {work->stage, work->u, work->p, t};
  const int64_t in_stride[] = {NX, work->u_stride, work->p_stride, 1};
  double *const out[] = {f, w, rx, rp};
  const int64_t out_stride[] = {SLOPES_PER_CALL, SLOPES_PER_CALL, SLOPES_PER_CALL, SLOPES_PER_CALL};
  const Tables tables = {in, in_stride, out, out_stride};
  run_block(&work->model->tape, &tables, work->registers, 0, work->runs);
#else
  tangents(work->stage, work->u, work->p, *t, f, w, rx, rp);
#endif
}

static void add_multiple(int64_t n, double factor, const double *restrict from, double *restrict to) {
  for (int64_t i = 0; i < n; i++) to[i] += factor * from[i];
}

/* dz = d(x_dot)/dx z + d(x_dot)/dp of one run, column by column of what the sensitivities are wanted for. */
static void tangent_rate(Workspace *work, const double *slopes, const double *z, double *dz) {
  const int64_t m = work->columns;
  const double *w = slopes + NX, *rx = w + ND * ND, *rp = rx + RX_NONZEROS;
  for (int64_t i = 0; i < NX * m; i++) dz[i] = 0;
  for (int64_t j = 0; m && j < NX; j++)
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

/* Where in a group's arrays and in the logs the runs are. */
typedef struct {
  double *x, *s; /* states (NX) and sensitivities (NX x columns) of the first run */
  int64_t x_stride, s_stride;
  int going[GROUP]; /* which of them move */
} Runs;

/* One step of lengths h from times t; what moves is advanced in place. */
static void step(Workspace *work, const Runs *runs, const double *t, const double *h) {
  const double reach[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
  const int64_t size = NX * work->columns, nx = NX, each = SLOPES_PER_CALL;
  double at[GROUP];
  for (int64_t g = 0; g < work->runs; g++) {
    const double *x = runs->x + g * runs->x_stride, *s = runs->s + g * runs->s_stride;
    for (int64_t i = 0; i < nx; i++) work->stage[g * nx + i] = x[i], work->total[g * nx + i] = 0;
    for (int64_t i = 0; i < size; i++) work->z[g * size + i] = s[i], work->sum[g * size + i] = 0;
  }
  for (int k = 0; k < 4; k++) {
    for (int64_t g = 0; g < work->runs; g++) at[g] = t[g] + reach[k] * h[g];
    evaluate(work, at);
    for (int64_t g = 0; g < work->runs; g++) {
      if (!runs->going[g]) continue;
      const double next = k < 3 ? reach[k + 1] * h[g] : 0;
      const double *f = work->slopes + g * each, *x = runs->x + g * runs->x_stride, *s = runs->s + g * runs->s_stride;
      double *stage = work->stage + g * nx, *total = work->total + g * nx;
      double *z = work->z + g * size, *dz = work->dz + g * size, *sum = work->sum + g * size;
      for (int64_t i = 0; i < nx; i++) total[i] += weight[k] * f[i], stage[i] = x[i] + next * f[i];
      tangent_rate(work, f, z, dz);
      for (int64_t i = 0; i < size; i++) {
        sum[i] += weight[k] * dz[i];
        z[i] = s[i] + next * dz[i];
      }
    }
  }
  for (int64_t g = 0; g < work->runs; g++) {
    double *x = runs->x + g * runs->x_stride, *s = runs->s + g * runs->s_stride;
    if (!runs->going[g]) continue;
    for (int64_t i = 0; i < nx; i++) x[i] += h[g] / 6 * work->total[g * nx + i];
    for (int64_t i = 0; i < size; i++) s[i] += h[g] / 6 * work->sum[g * size + i];
  }
}

/* From one sample, where x and s of the runs are, to the next; states that are not finite become NaN and stay so.
   Runs with fewer steps than others wait. */
static void advance(Workspace *work, Runs *runs, const double *t, int64_t t_stride, const int64_t *steps,
                    int64_t steps_stride) {
  const int64_t size = NX * work->columns, nx = NX;
  double h[GROUP], now[GROUP];
  for (int64_t g = 0; g < work->runs; g++) {
    double *x = runs->x + g * runs->x_stride, *s = runs->s + g * runs->s_stride;
    for (int64_t i = 0; i < nx; i++) x[nx + i] = x[i];
    for (int64_t i = 0; i < size; i++) s[size + i] = s[i];
    h[g] = (t[g * t_stride + 1] - t[g * t_stride]) / (double)steps[g * steps_stride];
  }
  runs->x += nx, runs->s += size;
  for (int64_t k = 0;; k++) {
    int any = 0;
    for (int64_t g = 0; g < work->runs; g++) {
      now[g] = t[g * t_stride] + (double)k * h[g];
      any |= runs->going[g] = k < steps[g * steps_stride] && is_finite(runs->x + g * runs->x_stride, nx);
    }
    if (!any) break;
    step(work, runs, now, h);
  }
  for (int64_t g = 0; g < work->runs; g++) {
    if (is_finite(runs->x + g * runs->x_stride, nx)) continue;
    fill_nan(runs->x + g * runs->x_stride, nx);
    fill_nan(runs->s + g * runs->s_stride, size);
  }
}

/* Samples first .. last of every run of a batch; sample `first` of x and s is there already.
   Strides are the distances between runs in t, steps (t - 1), u and p, zero where all runs share them.
   Returns 1 if there is no memory. */
EXPORTED int SIMULATE(MODEL_GIVEN int64_t batch, int64_t samples, int64_t first, int64_t last, const double *t,
             int64_t t_stride, const int64_t *steps, const double *u, int64_t u_stride, const double *p,
             int64_t p_stride, const int64_t *wrt, int64_t columns, double *x, double *s);

int SIMULATE(MODEL_GIVEN int64_t batch, int64_t samples, int64_t first, int64_t last, const double *t,
             int64_t t_stride, const int64_t *steps, const double *u, int64_t u_stride, const double *p,
             int64_t p_stride, const int64_t *wrt, int64_t columns, double *x, double *s) {
  Workspace place = {0}, *work = &place;
#ifdef INTERPRETED
  work->model = model;
#endif
  work->u_stride = u_stride, work->p_stride = p_stride, work->wrt = wrt, work->columns = columns;
  const int64_t nx = NX, size = nx * columns;
  const int64_t each = SLOPES_PER_CALL + 2 * nx + 3 * size;
  double *block = malloc(sizeof(double) * (size_t)(GROUP * each + ND * columns + REGISTERS));
  if (!block) return 1;
  work->slopes = block, work->stage = block + GROUP * SLOPES_PER_CALL, work->total = work->stage + GROUP * nx;
  work->z = work->total + GROUP * nx, work->dz = work->z + GROUP * size, work->sum = work->dz + GROUP * size;
  work->force = work->sum + GROUP * size, work->registers = work->force + ND * columns;
  const int64_t steps_stride = t_stride ? samples - 1 : 0;
  for (int64_t b = 0; b < batch; b += GROUP) {
    work->runs = batch - b < GROUP ? batch - b : GROUP;
    work->p = p + b * p_stride;
    Runs runs = {x + (b * samples + first) * nx, s + (b * samples + first) * size, samples * nx, samples * size, {0}};
    for (int64_t i = first; i < last; i++) {
      work->u = u + b * u_stride + i * NU;
      advance(work, &runs, t + b * t_stride + i, t_stride, steps + b * steps_stride + i, steps_stride);
    }
  }
  free(block);
  return 0;
}
