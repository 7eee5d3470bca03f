/* Sums of the weak form over windows of samples, and the solution of its banded systems.

   What stands before this defines TESTED, PRODUCTS and SOLVED, the names under which these are exported. Nothing is
   kept between calls: they may run in parallel. */

#include <stdint.h>

/* Numbers that go through an operation together. */
#define SIDE 8

/* --- test functions times signals ---------------------------------------------------------------- */

typedef struct {
  int64_t count, width, samples; /* test functions, samples in a window, samples */
  const int64_t *first;          /* first sample of every window */
  const double *weights;         /* kinds of weights, each count x width */
} Windows;

/* table[k, target[e]] += sum over the window of k of weight * data[sample, e].
   A run of signals has one kind of weights: begin, end, kind. `sums` has room for all signals. */
EXPORTED void TESTED(const Windows *windows, int64_t signals, const double *data, int64_t runs, const int64_t *run,
                     const int64_t *target, int64_t size, double *sums, double *table);

void TESTED(const Windows *windows, int64_t signals, const double *data, int64_t runs, const int64_t *run,
            const int64_t *target, int64_t size, double *restrict sums, double *restrict table) {
  for (int64_t k = 0; k < windows->count; k++) {
    const int64_t left = windows->samples - windows->first[k];
    const int64_t width = left < windows->width ? left : windows->width;
    for (int64_t e = 0; e < signals; e++) sums[e] = 0;
    for (int64_t i = 0; i < width; i++) {
      const double *restrict sample = data + (windows->first[k] + i) * signals;
      for (int64_t j = 0; j < runs; j++) {
        const double weight = windows->weights[(run[3 * j + 2] * windows->count + k) * windows->width + i];
        if (weight == 0) continue; /* what lies outside the support counts for nothing, whatever it is */
        for (int64_t e = run[3 * j]; e < run[3 * j + 1]; e++) sums[e] += weight * sample[e];
      }
    }
    for (int64_t j = 0; j < runs; j++)
      for (int64_t e = run[3 * j]; e < run[3 * j + 1]; e++) table[k * size + target[e]] += sums[e];
  }
}

/* --- products of rows whose windows overlap ------------------------------------------------------ */

/* Inner products of one vector with four. */
static void inner(int64_t n, const double *restrict x, const double *const *y, double *result) {
  double sum[4][SIDE] = {{0}};
  int64_t i = 0;
  for (; i + SIDE <= n; i += SIDE)
    for (int j = 0; j < 4; j++)
      for (int l = 0; l < SIDE; l++) sum[j][l] += x[i + l] * y[j][i + l];
  for (int j = 0; j < 4; j++) {
    result[j] = 0;
    for (int l = 0; l < SIDE; l++) result[j] += sum[j][l];
    for (int64_t rest = i; rest < n; rest++) result[j] += x[rest] * y[j][rest];
  }
}

/* Lower half, in LAPACK's bands (each of count x rows), of the products of all rows with all.
   Rows of a window are `length` numbers, `channels` of them for a sample. */
EXPORTED void PRODUCTS(int64_t count, int64_t rows, int64_t length, int64_t channels, const int64_t *first,
                       const double *felt, double *bands);

void PRODUCTS(int64_t count, int64_t rows, int64_t length, int64_t channels, const int64_t *first,
              const double *felt, double *bands) {
  for (int64_t k = 0; k < count; k++) {
    for (int64_t later = k; later < count; later++) {
      const int64_t shift = (first[later] - first[k]) * channels;
      if (shift >= length) break;
      for (int64_t a = 0; a < rows; a++) {
        const double *x = felt + (k * rows + a) * length + shift;
        for (int64_t b = later == k ? a : 0; b < rows; b += 4) {
          const double *y[4];
          double result[4];
          for (int j = 0; j < 4; j++) y[j] = felt + (later * rows + (b + j < rows ? b + j : b)) * length;
          inner(length - shift, x, y, result);
          for (int64_t j = 0; j < 4 && b + j < rows; j++)
            bands[((later - k) * rows + b + j - a) * count * rows + k * rows + a] = result[j];
        }
      }
    }
  }
}

/* --- lower banded systems ------------------------------------------------------------------------ */

/* L z = r for many right-hand sides: r, rows x columns, row by row, becomes z. L in LAPACK's bands, each of `rows`,
   Fortran's order; `columns` is a multiple of SIDE. */
EXPORTED void SOLVED(int64_t bands, int64_t rows, int64_t columns, const double *factor, double *right);

void SOLVED(int64_t bands, int64_t rows, int64_t columns, const double *factor, double *right) {
  for (int64_t j = 0; j < rows; j++) {
    const double *column = factor + j * bands;
    const double inverse = 1 / column[0];
    double *restrict z = right + j * columns;
    for (int64_t c = 0; c < columns; c++) z[c] *= inverse;
    for (int64_t i = 1; i < bands && j + i < rows; i++) {
      double *restrict r = right + (j + i) * columns;
      const double by = column[i];
      for (int64_t c = 0; c < columns; c += SIDE)
        for (int l = 0; l < SIDE; l++) r[c + l] -= by * z[c + l];
    }
  }
}
