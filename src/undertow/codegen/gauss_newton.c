/* Simulates windows of logs with sensitivities, and keeps only the products that a Gauss-Newton step needs.

   Compiled together with the generated functions. What stands before this defines
     NX, NU, ND, NF   numbers of states, inputs, degrees of freedom, and parameters to differentiate by
     LANES            doubles in a vector V: the columns of the sensitivities lie side by side in vectors
     SLOPES           name of the function f(x, u, p, t, W, x_dot, R_x, R_p): d(x_dot)/dx is R_x, and R_p likewise,
                      with the rows ND .. 2 ND - 1 multiplied by W, the inverse of the mass matrix
     INVERSE          name of the function that gives W(x, u, p, t); STEADY if W depends on p alone
     RX_START, RX_COLUMN, RX_PLACE, RX_NONZEROS   nonzeros of R_x row by row, and where each stands in the output
     RP_...           the same of R_p
   and PRODUCTS, the name under which the entry point is exported.

   Columns: NF parameters, then the initial values of the first 2 ND states. All lives on the stack of a call. */

#define NS (2 * ND)            /* states that are measured, and whose initial values are unknown */
#define COLUMNS (NF + NS)
#define VECTORS ((COLUMNS + LANES - 1) / LANES)
#define AT(i) ((i) * VECTORS)
#if defined(__GNUC__) /* unrolled, the sums of a row stay in registers */
#define EACH_VECTOR _Pragma("GCC unroll 16") for (int g = 0; g < VECTORS; g++)
#else
#define EACH_VECTOR for (int g = 0; g < VECTORS; g++)
#endif

typedef struct {
  double x[NX], w[ND * ND];
  V s[NX * VECTORS];           /* d(state)/d(columns), row by row */
} State;

typedef struct {
  V products[COLUMNS * VECTORS], with_error[VECTORS];
  double square;
} Sums;

/* rate = d(x_dot)/dx z + d(x_dot)/dp, given the nonzeros of R_x and R_p. */
static void tangent_rate(const double *w, const double *rx, const double *rp, const V *z, V *rate) {
  V force[ND * VECTORS];
  for (int i = 0; i < NX; i++) {
    V row[VECTORS] = {0};
    for (int k = RX_START[i]; k < RX_START[i + 1]; k++)
      EACH_VECTOR row[g] += rx[RX_PLACE[k]] * z[AT(RX_COLUMN[k]) + g];
    V *to = i < ND || i >= NS ? rate + AT(i) : force + AT(i - ND);
    EACH_VECTOR to[g] = row[g];
    for (int k = RP_START[i]; k < RP_START[i + 1]; k++) ((double *)to)[RP_COLUMN[k]] += rp[RP_PLACE[k]];
  }
  /* The rows of the acceleration hold forces so far; W turns them into accelerations. */
  for (int i = 0; i < ND; i++) {
    V row[VECTORS] = {0};
    for (int j = 0; j < ND; j++)
      EACH_VECTOR row[g] += w[i * ND + j] * force[AT(j) + g];
    EACH_VECTOR rate[AT(ND + i) + g] = row[g];
  }
}

/* One classical Runge-Kutta step of length h from t. */
static void step(State *state, const double *u, const double *p, double t, double h) {
  static const double reach[5] = {0, 0.5, 0.5, 1, 0}, weight[4] = {1, 2, 2, 1};
  double stage[NX], total[NX], f[NX], rx[RX_NONZEROS + 1], rp[RP_NONZEROS + 1];
  V z[NX * VECTORS], rate[NX * VECTORS], sum[NX * VECTORS];
  for (int i = 0; i < NX; i++) stage[i] = state->x[i], total[i] = 0;
  for (int i = 0; i < NX * VECTORS; i++) z[i] = state->s[i], sum[i] = (V){0};
  for (int k = 0; k < 4; k++) {
#ifndef STEADY
    INVERSE(stage, u, p, t + reach[k] * h, state->w);
#endif
    SLOPES(stage, u, p, t + reach[k] * h, state->w, f, rx, rp);
    tangent_rate(state->w, rx, rp, z, rate);
    const double next = reach[k + 1] * h;
    for (int i = 0; i < NX; i++) total[i] += weight[k] * f[i], stage[i] = state->x[i] + next * f[i];
    for (int i = 0; i < NX * VECTORS; i++) sum[i] += weight[k] * rate[i], z[i] = state->s[i] + next * rate[i];
  }
  for (int i = 0; i < NX; i++) state->x[i] += h / 6 * total[i];
  for (int i = 0; i < NX * VECTORS; i++) state->s[i] += h / 6 * sum[i];
}

static int is_finite(const double *x) {
  for (int i = 0; i < NX; i++)
    if (!(x[i] - x[i] == 0)) return 0;
  return 1;
}

/* Take in the weighted errors of one sample, and their derivatives. */
static void take(const State *state, const double *measured, const double *weight, Sums *sums, double *squares) {
  V rows[NS * VECTORS];
  double error[NS];
  int used = 0;
  for (int i = 0; i < NS; i++) {
    if (weight[i] == 0) continue; /* nothing was measured */
    error[used] = weight[i] * (state->x[i] - measured[i]);
    squares[i] += error[used] * error[used];
    EACH_VECTOR rows[AT(used) + g] = weight[i] * state->s[AT(i) + g];
    used++;
  }
  for (int k = 0; k < used; k++) {
    sums->square += error[k] * error[k];
    EACH_VECTOR sums->with_error[g] += error[k] * rows[AT(k) + g];
  }
  for (int a = 0; a < COLUMNS; a++)
    for (int g = a / LANES; g < VECTORS; g++) {
      V sum = sums->products[AT(a) + g];
      for (int k = 0; k < used; k++) sum += ((const double *)(rows + AT(k)))[a] * rows[AT(k) + g];
      sums->products[AT(a) + g] = sum;
    }
}

/* Add the sums to a table of COLUMNS + 1 rows, upper triangle, and clear them. */
static void deliver(Sums *sums, double *table) {
  const double *with_error = (const double *)sums->with_error;
  for (int a = 0; a < COLUMNS; a++) {
    const double *row = (const double *)(sums->products + AT(a));
    for (int b = a; b < COLUMNS; b++) table[a * (COLUMNS + 1) + b] += row[b];
    table[a * (COLUMNS + 1) + COLUMNS] += with_error[a];
  }
  table[(COLUMNS + 1) * (COLUMNS + 1) - 1] += sums->square;
  *sums = (Sums){0};
}

static void start(State *state, const double *x, const double *u, const double *p, double t) {
  *state = (State){0};
  for (int i = 0; i < NX; i++) state->x[i] = x[i];
  for (int i = 0; i < NS; i++) ((double *)(state->s + AT(i)))[NF + i] = 1;
  INVERSE(x, u, p, t, state->w);
}

/* Windows of a batch, each with `samples` samples; strides are the distances between windows in t and steps, u and p,
   zero where all share them. `table` (batch x groups x (COLUMNS + 1)^2) and `squares` (batch x NS) are zero before.
   Sample i of a window belongs to group[i], which never falls. Returns how many windows diverged. */
EXPORTED int64_t PRODUCTS(int64_t batch, int64_t samples, int64_t groups, const double *t, int64_t t_stride,
                          const int64_t *steps, const double *u, int64_t u_stride, const double *p, int64_t p_stride,
                          const double *x, const double *measured, const double *weight, const int64_t *group,
                          double *table, double *squares);

int64_t PRODUCTS(int64_t batch, int64_t samples, int64_t groups, const double *t, int64_t t_stride,
                 const int64_t *steps, const double *u, int64_t u_stride, const double *p, int64_t p_stride,
                 const double *x, const double *measured, const double *weight, const int64_t *group,
                 double *table, double *squares) {
  int64_t diverged = 0;
  for (int64_t b = 0; b < batch; b++) {
    const double *time = t + b * t_stride, *input = u + b * u_stride, *parameters = p + b * p_stride;
    const int64_t *count = steps + (t_stride ? b * (samples - 1) : 0);
    State state;
    Sums sums = {0};
    start(&state, x + b * NX, input, parameters, time[0]);
    for (int64_t i = 0; i < samples; i++) {
      const int64_t row = b * samples + i;
      take(&state, measured + row * NS, weight + row * NS, &sums, squares + b * NS);
      if (i + 1 == samples || group[row + 1] != group[row])
        deliver(&sums, table + (b * groups + group[row]) * (COLUMNS + 1) * (COLUMNS + 1));
      if (i + 1 == samples) break;
      const double interval = time[i + 1] - time[i], h = interval / (double)count[i];
      if (interval == 0) continue; /* padding */
      for (int64_t k = 0; k < count[i]; k++)
        step(&state, input + i * NU, parameters, time[i] + (double)k * h, h);
      if (!is_finite(state.x)) {
        diverged++;
        break;
      }
    }
  }
  return diverged;
}
