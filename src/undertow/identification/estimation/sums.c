/* Sums of the weak form over windows of samples, and the solution of its banded systems.

   What stands before this defines TESTED and SOLVED, the names under which these are exported. Nothing is kept between
   calls: they may run in parallel. */

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
