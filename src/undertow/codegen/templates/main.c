/* Steps the model of '@TITLE@' for 10 s from rest under constant inputs and prints the states as CSV.
   cc main.c model.c -lm -o example && ./example */
#include <stdio.h>
#include "model.h"

enum { N = @UPPER@_STATES };

/* One fourth-order Runge-Kutta step of h seconds, u held. */
static void step(double *x, const double *u, const double *p, double t, double h) {
  const double reach[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
  double stage[N], rate[N], total[N];
  for (int i = 0; i < N; i++) stage[i] = x[i], total[i] = 0;
  for (int k = 0; k < 4; k++) {
    @LOWER@_dynamics(stage, u, p, t + reach[k] * h, rate);
    for (int i = 0; i < N; i++) total[i] += weight[k] * rate[i];
    for (int i = 0; k < 3 && i < N; i++) stage[i] = x[i] + reach[k + 1] * h * rate[i];
  }
  for (int i = 0; i < N; i++) x[i] += h / 6 * total[i];
}

int main(void) {
  const double h = 0.02, u[] = {@EXAMPLE_INPUT@};
  double x[N] = {0};
  for (int i = 0; i < N; i++) printf(i ? ",%s" : "t,%s", @LOWER@_state_names[i]);
  for (int k = 0; k <= 500; k++) {
    if (k % 25 == 0) printf("\n%.17g", k * h);
    for (int i = 0; k % 25 == 0 && i < N; i++) printf(",%.17g", x[i]);
    step(x, u, @LOWER@_parameters, k * h, h);
  }
  printf("\n");
  return 0;
}
