/* The rows of a linear regression at the samples of a log, and sums of their products, in one pass.

   Compiled together with the generated function and lanes.h. What stands before this defines
     NX, ND, NU, NF   numbers of states, degrees of freedom, inputs, and parameters that are sought
     ROWS             name of the function f(x, nu_dot, u, p, t, rows): of every row the nonzeros, then the target
     ENTRIES          how many these are; START says where each row begins, COLUMN in which column each stands
     NEEDED, NEEDS    which of x, nu_dot, u and t, in this order, the function needs, and how many
     TABLE            numbers of the sums of all rows
   and GRAM and BUILD, the names of the entry points.

   LANES samples go side by side, DEEP of them one after the other, so that the sums of a tile stay in registers
   meanwhile. Everything is on the stack of a call. */

#define DEEP 16
#define INPUTS (NX + ND + NU + 1)
#define WIDTH (NF + 1)
#if defined(__AVX512F__) || defined(__aarch64__)
#define TILE 4
#else
#define TILE 3
#endif
#ifdef __GNUC__
#define UNROLLED _Pragma("GCC unroll 4")
#else
#define UNROLLED
#endif
/* So many columns at once are more than the processor foresees by itself; it may look beyond their ends. */
#ifdef __GNUC__
#define FETCH(address) __builtin_prefetch(address)
#else
#define FETCH(address)
#endif
#define AHEAD 128
/* Samples between two deliveries of the sums in lanes: few enough that rounding does not add up. */
#define DELIVERY (64 * DEEP * LANES)

typedef struct {
  int64_t n;                   /* samples */
  const double *const *column; /* of every needed input, n */
  const double *p;
} Data;

INLINE Real load(const double *from, int64_t left) {
  Real value = real(NAN);
  for (int i = 0; i < LANES && i < left; i++) LANE(value, i) = from[i];
  return value;
}

INLINE Real load_full(const double *from) {
  Real value;
  memcpy(&value, from, sizeof value);
  return value;
}

static int all_of(Truth which) {
#if LANES == 1
  return which;
#else
  int64_t all = -1;
  for (int i = 0; i < LANES; i++) all &= which[i];
  return all != 0;
#endif
}

/* Rows at LANES samples from `first`; what has gaps counts nothing. Returns in how many samples there is no gap. */
static int64_t rows_at(const Data *data, int64_t first, Real *rows) {
  static const double none[LANES];
  const int64_t left = data->n - first;
  Real in[INPUTS], seen = left < LANES ? load(none, left) : real(0.0);
  for (int i = 0; i < INPUTS; i++) in[i] = real(0.0);
  for (int i = 0; i < NEEDS; i++) {
    const double *from = data->column[i] + first;
    in[NEEDED[i]] = left < LANES ? load(from, left) : load_full(from);
    FETCH(from + AHEAD);
    seen += in[NEEDED[i]] * 0.0; /* NaN from the first gap on */
  }
  const Truth whole = seen == 0.0;
  const int gaps = !all_of(whole);
  if (gaps)
    for (int i = 0; i < NEEDS; i++) in[NEEDED[i]] = real_where(whole, in[NEEDED[i]], real(0.0));
  ROWS(in, in + NX, in + NX + ND, data->p, in[INPUTS - 1], rows);
  if (!gaps) return LANES;
  for (int k = 0; k < ENTRIES; k++) rows[k] = real_where(whole, rows[k], real(0.0));
  int64_t counted = 0;
  const Real one = real_truth(whole);
  for (int i = 0; i < LANES; i++) counted += LANE(one, i) != 0;
  return counted;
}

/* --- products ------------------------------------------------------------------------------------ */

/* Sums of products of m with n entries of a row; `sums` is a block of TILE x TILE. */
INLINE void tile(int m, int n, int upper, const Real *a, const Real *b, int deep, Real *sums) {
  Real s[TILE][TILE];
  UNROLLED for (int i = 0; i < m; i++)
    UNROLLED for (int j = upper ? i : 0; j < n; j++) s[i][j] = sums[i * TILE + j];
  for (int d = 0; d < deep; d++, a += ENTRIES, b += ENTRIES)
    UNROLLED for (int i = 0; i < m; i++)
      UNROLLED for (int j = upper ? i : 0; j < n; j++) s[i][j] += a[i] * b[j];
  UNROLLED for (int i = 0; i < m; i++)
    UNROLLED for (int j = upper ? i : 0; j < n; j++) sums[i * TILE + j] = s[i][j];
}

/* The compiler makes one loop of each size, so that all sums are in registers. */
INLINE void tile_of(int n, const Real *a, const Real *b, int deep, Real *sums) {
  if (a == b) {
    if (n == TILE) tile(TILE, TILE, 1, a, b, deep, sums);
    else if (n == 1) tile(1, 1, 1, a, b, deep, sums);
    else if (n == 2) tile(2, 2, 1, a, b, deep, sums);
    else tile(3, 3, 1, a, b, deep, sums);
  } else if (n == TILE) tile(TILE, TILE, 0, a, b, deep, sums);
  else if (n == 1) tile(TILE, 1, 0, a, b, deep, sums);
  else if (n == 2) tile(TILE, 2, 0, a, b, deep, sums);
  else tile(TILE, 3, 0, a, b, deep, sums);
}

INLINE int least(int a, int b) { return a < b ? a : b; }

/* Products of all entries of each row with each other, rows one after the other, tile by tile. */
static void add_products(const Real *rows, int deep, Real *sums) {
  for (int r = 0; r < ND; r++)
    for (int i = START[r]; i < START[r + 1]; i += TILE)
      for (int j = i; j < START[r + 1]; j += TILE, sums += TILE * TILE)
        tile_of(least(TILE, START[r + 1] - j), rows + i, rows + j, deep, sums);
}

/* What rounding takes from a long sum is kept beside it (Neumaier). */
static void add_exactly(double value, double *sum, double *lost) {
  const double total = *sum + value;
  *lost += fabs(*sum) >= fabs(value) ? (*sum - total) + value : (value - total) + *sum;
  *sum = total;
}

static double across(Real value) {
  double sum = 0;
  for (int i = 0; i < LANES; i++) sum += LANE(value, i);
  return sum;
}

/* Add the sums to the upper triangle of a table of WIDTH rows, and clear them. */
static void deliver(Real *sums, double *table, double *lost) {
  for (int r = 0; r < ND; r++)
    for (int i = START[r]; i < START[r + 1]; i += TILE)
      for (int j = i; j < START[r + 1]; j += TILE, sums += TILE * TILE)
        for (int a = i; a < least(i + TILE, START[r + 1]); a++)
          for (int b = j > a ? j : a; b < least(j + TILE, START[r + 1]); b++) {
            const int place = COLUMN[a] * WIDTH + COLUMN[b];
            Real *sum = sums + (a - i) * TILE + b - j;
            add_exactly(across(*sum), table + place, lost + place);
            *sum = real(0.0);
          }
}

#define DATA int64_t n, const double *const *column, const double *p
#define GIVEN {n, column, p}

/* Adds products of rows and target to `table` and `lost` (WIDTH x WIDTH, upper triangle); returns the samples. */
EXPORTED int64_t GRAM(DATA, double *table, double *lost);

int64_t GRAM(DATA, double *table, double *lost) {
  const Data data = GIVEN;
  Real rows[ENTRIES * DEEP], sums[TABLE * TILE * TILE];
  int64_t counted = 0;
  memset(sums, 0, sizeof sums);
  for (int64_t first = 0; first < n;) {
    int deep = 0;
    for (; deep < DEEP && first < n; deep++, first += LANES) counted += rows_at(&data, first, rows + deep * ENTRIES);
    add_products(rows, deep, sums);
    if (first % DELIVERY == 0 || first >= n) deliver(sums, table, lost);
  }
  return counted;
}

/* Rows and target as a matrix of n ND rows of WIDTH, row by row; rows of samples with gaps are zero. */
EXPORTED int64_t BUILD(DATA, double *matrix);

int64_t BUILD(DATA, double *matrix) {
  const Data data = GIVEN;
  Real rows[ENTRIES];
  int64_t counted = 0;
  memset(matrix, 0, sizeof(double) * (size_t)(n * ND * WIDTH));
  for (int64_t first = 0; first < n; first += LANES) {
    counted += rows_at(&data, first, rows);
    for (int i = 0; i < LANES && first + i < n; i++)
      for (int r = 0; r < ND; r++)
        for (int k = START[r]; k < START[r + 1]; k++)
          matrix[((first + i) * ND + r) * WIDTH + COLUMN[k]] = LANE(rows[k], i);
  }
  return counted;
}
