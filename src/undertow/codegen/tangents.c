/* Simulates logs with sensitivities. What becomes of a sample: it is recorded, or added to the sums of products that a
   Gauss-Newton step needs. Without columns this simulates alone.

   What stands before this is either the generated functions of a model, then it defines
     NX, NU, ND, NF   numbers of states, inputs, degrees of freedom, and parameters to differentiate by
     COLUMNS          number of derivatives: by parameters, then by initial states
     slopes(x, u, p, t, W, x_dot, R_x, R_p)   d(x_dot)/dx is R_x, and R_p likewise, with the rows ND .. 2 ND - 1
                      multiplied by W, the inverse of the mass matrix
     inverse(x, u, p, t, W)   STEADY if W depends on p alone
     RX_START, RX_COLUMN, RX_PLACE, RX_NONZEROS   nonzeros of R_x row by row, and where each stands in the output
     RP_...           the same of R_p
   or tape.c and INTERPRETED: then the model is data, and its instructions run over GROUP runs side by side.
   SIMULATE is the name under which the entry point is exported.

   The columns of the sensitivities lie side by side in vectors V. Everything a call needs lives on its stack or in the
   block it allocates: calls may run in parallel. */

#include "portable.h"

#if defined(__GNUC__) /* the compiler splits a vector where the processor has narrower ones */
#define ABREAST 8
typedef double V __attribute__((vector_size(8 * ABREAST)));
#else
#define ABREAST 1
typedef double V;
#endif

#ifdef INTERPRETED
#define GROUP 16 /* runs: enough that what an instruction is takes less time than to do it */
typedef struct {
  Tape tape;
  int64_t nx, nu, nd, nf, columns;
  const int *rx_start, *rx_column, *rx_place, *rp_start, *rp_column, *rp_place;
  int64_t rx_nonzeros, rp_nonzeros;
} Model;
#define NX (work->model->nx)
#define NU (work->model->nu)
#define ND (work->model->nd)
#define NF (work->model->nf)
#define COLUMNS (work->model->columns)
#define RX_START work->model->rx_start
#define RX_COLUMN work->model->rx_column
#define RX_PLACE work->model->rx_place
#define RP_START work->model->rp_start
#define RP_COLUMN work->model->rp_column
#define RP_PLACE work->model->rp_place
#define W(i, j) w[(j) * ND + (i)]
#define SLOPES (ND * ND + work->model->rx_nonzeros + work->model->rp_nonzeros)
#define AT_ONCE 1
#define MODEL_GIVEN const Model *model,
#else
#define GROUP 1
#define W(i, j) w[(i) * ND + (j)]
#define AT_ONCE VECTORS
#define MODEL_GIVEN
#endif

#define MOST_ND 6
#define NS (2 * ND) /* states that are measured, and whose initial values are unknown in a Gauss-Newton step */
#define VECTORS ((COLUMNS + ABREAST - 1) / ABREAST)
#define AT(i) ((i) * VECTORS)
#define FIRST_VECTOR ((NX + ABREAST - 1) / ABREAST) /* the states themselves lie before their derivatives */
#define NUMBERS (FIRST_VECTOR + AT(NX))
#define SUMS (AT(COLUMNS) + VECTORS + 1) /* products, products with the error, and in a vector of its own its square */
#define ROOM (GROUP * 4 * NUMBERS + AT(2 * ND) + AT(ND) + GROUP * SUMS)
#if defined(__GNUC__) /* unrolled, the sums of a row stay in registers */
#define EACH(n) _Pragma("GCC unroll 16") for (int g = 0; g < (n); g++)
#else
#define EACH(n) for (int g = 0; g < (n); g++)
#endif

#define NUMBER V
#define TIME double
#include "runge_kutta.h"

/* Where runs share times, steps, inputs or parameters, the distance from run to run is zero. */
typedef struct {
  int64_t samples, first, last; /* of a run in these arrays; the first and the last that is simulated */
  int64_t t_stride, u_stride, p_stride, steps_stride, x_stride;
  const double *t, *u, *p;
  const int64_t *steps;         /* Runge-Kutta steps to the next sample */
  double *x, *s;                /* recorded states and sensitivities; those of the first sample are given */
  /* Or the table of sums, then x and s are of the start alone. Sample i belongs to sum group[i], which never falls. */
  int64_t groups;
  const double *measured, *weight;
  const int64_t *group;
  double *table, *squares;      /* zero before: for each run groups x (COLUMNS + 1)^2, and NS */
} Logs;

typedef struct {
#ifdef INTERPRETED
  const Model *model;
  double *slopes, *registers;
#endif
  const Logs *logs;
  int64_t begin, runs;          /* the first run of the group, and how many it has */
  const double *u, *p;          /* held inputs and parameters of the first run */
  const int *moving;            /* which of them do; 0: all */
  double w[MOST_ND * MOST_ND];
  V *z, *room, *force, *rows, *sums; /* state and derivatives, and room for what is worked out on the way */
} Work;

/* rate = d(x_dot)/dx z + d(x_dot)/dp, given the nonzeros of R_x and R_p. */
INLINE void tangent_rate(const Work *work, const double *w, const double *rx, const double *rp, const V *z, V *rate) {
  for (int64_t i = 0; i < NX; i++) {
    V *to = i < ND || i >= NS ? rate + AT(i) : work->force + AT(i - ND);
    for (int64_t from = 0; from < VECTORS; from += AT_ONCE) {
      V row[AT_ONCE] = {0};
      for (int k = RX_START[i]; k < RX_START[i + 1]; k++)
        EACH(AT_ONCE) row[g] += rx[RX_PLACE[k]] * z[AT(RX_COLUMN[k]) + from + g];
      EACH(AT_ONCE) to[from + g] = row[g];
    }
    for (int k = RP_START[i]; k < RP_START[i + 1]; k++) ((double *)to)[RP_COLUMN[k]] += rp[RP_PLACE[k]];
  }
  /* The rows of the acceleration hold forces so far; W turns them into accelerations. */
  for (int64_t i = 0; i < ND; i++)
    for (int64_t from = 0; from < VECTORS; from += AT_ONCE) {
      V row[AT_ONCE] = {0};
      for (int64_t j = 0; j < ND; j++)
        EACH(AT_ONCE) row[g] += W(i, j) * work->force[AT(j) + from + g];
      EACH(AT_ONCE) rate[AT(ND + i) + from + g] = row[g];
    }
}

static void rates(void *system, const double *t, const V *z, V *rate) {
  Work *work = system;
#ifdef INTERPRETED
  const int64_t numbers = NUMBERS, stride = numbers * ABREAST, each = SLOPES;
  double *w = work->slopes, *rx = w + ND * ND, *rp = rx + work->model->rx_nonzeros;
  const double *const in[] = {(const double *)z, work->u, work->p, t};
  const int64_t in_stride[] = {stride, work->logs->u_stride, work->logs->p_stride, 1};
  double *const out[] = {(double *)rate, w, rx, rp};
  const int64_t out_stride[] = {stride, each, each, each};
  const Tables tables = {in, in_stride, out, out_stride};
  run_block(&work->model->tape, &tables, work->registers, 0, work->runs, GROUP);
  for (int64_t g = 0; g < work->runs && COLUMNS; g++)
    if (work->moving[g])
      tangent_rate(work, w + g * each, rx + g * each, rp + g * each, z + g * numbers + FIRST_VECTOR,
                   rate + g * numbers + FIRST_VECTOR);
#else
  double rx[RX_NONZEROS + 1], rp[RP_NONZEROS + 1];
  const double *x = (const double *)z;
#ifndef STEADY
  inverse(x, work->u, work->p, *t, work->w);
#endif
  rate[FIRST_VECTOR - 1] = (V){0}; /* what fills up the last vector is no state */
  slopes(x, work->u, work->p, *t, work->w, (double *)rate, rx, rp);
  tangent_rate(work, work->w, rx, rp, z + FIRST_VECTOR, rate + FIRST_VECTOR);
#endif
}

/* --- what becomes of a sample ------------------------------------------------------------------------ */

static void record(const Work *work, const double *z, int64_t run, int64_t sample) {
  const int64_t row = run * work->logs->samples + sample;
  double *x = work->logs->x + row * NX, *s = work->logs->s + row * NX * COLUMNS;
  for (int64_t i = 0; i < NX; i++) x[i] = z[i];
  for (int64_t i = 0; i < NX; i++)
    for (int64_t c = 0; c < COLUMNS; c++) s[i * COLUMNS + c] = z[(FIRST_VECTOR + AT(i)) * ABREAST + c];
}

/* Take in the weighted errors of one sample, and their derivatives. */
static void take(const Work *work, const double *z, int64_t run, int64_t sample, V *sums) {
  const Logs *logs = work->logs;
  const int64_t row = run * logs->samples + sample;
  const double *measured = logs->measured + row * NS, *weight = logs->weight + row * NS;
  const V *s = (const V *)z + FIRST_VECTOR;
  V *rows = work->rows, *with_error = sums + AT(COLUMNS);
  double error[2 * MOST_ND];
  int used = 0;
  for (int64_t i = 0; i < NS; i++) {
    if (weight[i] == 0) continue; /* nothing was measured */
    error[used] = weight[i] * (z[i] - measured[i]);
    logs->squares[run * NS + i] += error[used] * error[used];
    EACH(VECTORS) rows[AT(used) + g] = weight[i] * s[AT(i) + g];
    used++;
  }
  for (int k = 0; k < used; k++) {
    *(double *)(with_error + VECTORS) += error[k] * error[k];
    EACH(VECTORS) with_error[g] += error[k] * rows[AT(k) + g];
  }
  for (int64_t a = 0; a < COLUMNS; a++)
    for (int64_t g = a / ABREAST; g < VECTORS; g++) {
      V sum = sums[AT(a) + g];
      for (int k = 0; k < used; k++) sum += ((const double *)(rows + AT(k)))[a] * rows[AT(k) + g];
      sums[AT(a) + g] = sum;
    }
}

/* Add the sums to a table of COLUMNS + 1 rows, upper triangle, and clear them. */
static void deliver(const Work *work, V *sums, double *table) {
  (void)work;
  const int64_t width = COLUMNS + 1;
  const double *with_error = (const double *)(sums + AT(COLUMNS));
  for (int64_t a = 0; a < COLUMNS; a++) {
    const double *row = (const double *)(sums + AT(a));
    for (int64_t b = a; b < COLUMNS; b++) table[a * width + b] += row[b];
    table[a * width + COLUMNS] += with_error[a];
  }
  table[width * width - 1] += *(const double *)(sums + AT(COLUMNS) + VECTORS);
  for (int64_t i = 0; i < SUMS; i++) sums[i] = (V){0};
}

static void take_and_deliver(const Work *work, const double *z, int64_t run, int64_t sample, V *sums) {
  const Logs *logs = work->logs;
  const int64_t *group = logs->group + run * logs->samples + sample, table = (COLUMNS + 1) * (COLUMNS + 1);
  take(work, z, run, sample, sums);
  if (sample == logs->last || group[1] != group[0])
    deliver(work, sums, logs->table + (run * logs->groups + *group) * table);
}

/* --- runs of a group --------------------------------------------------------------------------------- */

static int is_finite(const double *x, int64_t n) {
  for (int64_t i = 0; i < n; i++)
    if (!(x[i] - x[i] == 0)) return 0;
  return 1;
}

static void start(Work *work, double *z, int64_t run) {
  const Logs *logs = work->logs;
  const int64_t first = logs->table ? 0 : logs->first;
  const double *x = logs->x + run * logs->x_stride + first * NX;
  const double *s = logs->s + (logs->table ? run : run * logs->samples + first) * NX * COLUMNS;
  double *derivatives = z + FIRST_VECTOR * ABREAST;
  for (int64_t i = 0; i < NUMBERS * ABREAST; i++) z[i] = 0;
  for (int64_t i = 0; i < NX; i++) z[i] = x[i];
  for (int64_t i = 0; i < NX; i++)
    for (int64_t c = 0; c < COLUMNS; c++) derivatives[AT(i) * ABREAST + c] = s[i * COLUMNS + c];
#ifndef INTERPRETED
  inverse(x, work->u, work->p, logs->t[run * logs->t_stride + first], work->w);
#endif
}

/* From sample i to the next; runs with fewer steps than others wait, and so do those that have left the numbers. */
static void advance(Work *work, int64_t i, const int *finite) {
  const Logs *logs = work->logs;
  double now[GROUP], h[GROUP];
  int moving[GROUP];
  const double *t = logs->t + work->begin * logs->t_stride + i;
  const int64_t *steps = logs->steps + work->begin * logs->steps_stride + i;
  for (int64_t g = 0; g < work->runs; g++)
    h[g] = (t[g * logs->t_stride + 1] - t[g * logs->t_stride]) / (double)steps[g * logs->steps_stride];
  for (int64_t k = 0;; k++) {
    int any = 0;
    for (int64_t g = 0; g < work->runs; g++) {
      now[g] = t[g * logs->t_stride] + (double)k * h[g];
      any |= moving[g] = k < steps[g * logs->steps_stride] && h[g] != 0 && finite[g]; /* no time passes: padding */
    }
    if (!any) break;
    work->moving = GROUP == 1 ? 0 : moving;
    runge_kutta(rates, work, GROUP == 1 ? 1 : work->runs, NUMBERS, work->moving, now, h, work->z, work->room);
  }
}

/* Returns how many runs have left the numbers: recorded, they are NaN from there on. */
static int64_t simulate(Work *work) {
  const Logs *logs = work->logs;
  const int64_t stride = NUMBERS * ABREAST;
  double *z = (double *)work->z;
  int finite[GROUP];
  int64_t diverged = 0;
  for (int64_t g = 0; g < work->runs; g++) start(work, z + g * stride, work->begin + g), finite[g] = 1;
  for (int64_t i = logs->first;; i++) {
    for (int64_t g = 0; g < work->runs; g++) {
      double *state = z + g * stride;
      if (finite[g] && !is_finite(state, NX)) {
        finite[g] = 0, diverged++;
        for (int64_t j = 0; j < stride; j++) state[j] = NAN;
      }
      if (logs->table && finite[g]) take_and_deliver(work, state, work->begin + g, i, work->sums + g * SUMS);
      if (!logs->table && i > logs->first) record(work, state, work->begin + g, i);
    }
    if (i == logs->last || (logs->table && diverged == work->runs)) return diverged;
    work->u = logs->u + work->begin * logs->u_stride + i * NU;
    advance(work, i, finite);
  }
}

EXPORTED int64_t SIMULATE(MODEL_GIVEN const Logs *logs, int64_t batch);

/* All runs of a batch. Returns how many diverged, or -1 if there is no memory. */
int64_t SIMULATE(MODEL_GIVEN const Logs *logs, int64_t batch) {
  Work place = {0}, *work = &place;
  int64_t diverged = 0;
  work->logs = logs;
#ifdef INTERPRETED
  work->model = model;
  const int64_t numbers = GROUP * SLOPES + GROUP * model->tape.slots;
  char *block = malloc(sizeof(V) * (size_t)(ROOM + 1) + sizeof(double) * (size_t)numbers);
  if (!block) return -1;
  V *room = (V *)(block + (sizeof(V) - (size_t)((uintptr_t)block % sizeof(V))) % sizeof(V));
  work->slopes = (double *)(room + ROOM), work->registers = work->slopes + GROUP * SLOPES;
#else
  V room[ROOM];
#endif
  work->z = room, work->room = work->z + GROUP * NUMBERS, work->force = work->room + GROUP * 3 * NUMBERS;
  work->rows = work->force + AT(ND), work->sums = work->rows + AT(NS);
  for (int64_t i = 0; i < GROUP * SUMS; i++) work->sums[i] = (V){0};
  for (work->begin = 0; work->begin < batch; work->begin += GROUP) {
    work->runs = GROUP == 1 ? 1 : batch - work->begin < GROUP ? batch - work->begin : GROUP;
    work->u = logs->u + work->begin * logs->u_stride, work->p = logs->p + work->begin * logs->p_stride;
    diverged += simulate(work);
  }
#ifdef INTERPRETED
  free(block);
#endif
  return diverged;
}
