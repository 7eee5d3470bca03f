/* One step of the classical fourth-order Runge-Kutta method.

   What stands before this defines
     NUMBER   type of what a state is made of: a double, doubles in lanes, a vector of derivatives
     TIME     type of times
     GROUP    the most runs that move in one call; each has a time and a step of its own */

typedef void Rates(void *system, const TIME *t, const NUMBER *z, NUMBER *rate);

/* Runs of n numbers each, one after the other in z, moved by h from t; those that are not `moving` stay where they
   are (0: all move). `room` is for three times as many numbers as z has. */
INLINE void runge_kutta(Rates rates, void *system, int64_t runs, int64_t n, const int *moving, const TIME *t,
                        const TIME *h, NUMBER *z, NUMBER *room) {
  const double reach[5] = {0, 0.5, 0.5, 1, 0}, weight[4] = {1, 2, 2, 1};
  NUMBER *stage = room, *rate = stage + runs * n, *total = rate + runs * n;
  TIME at[GROUP];
  for (int64_t i = 0; i < runs * n; i++) stage[i] = z[i], total[i] = (NUMBER){0};
  for (int k = 0; k < 4; k++) {
    for (int64_t g = 0; g < runs; g++) at[g] = t[g] + reach[k] * h[g];
    rates(system, at, stage, rate);
    for (int64_t g = 0; g < runs; g++) {
      if (moving && !moving[g]) continue;
      const TIME next = reach[k + 1] * h[g];
      for (int64_t i = g * n; i < (g + 1) * n; i++) total[i] += weight[k] * rate[i], stage[i] = z[i] + next * rate[i];
    }
  }
  for (int64_t g = 0; g < runs; g++) {
    if (moving && !moving[g]) continue;
    const TIME sixth = h[g] / 6;
    for (int64_t i = g * n; i < (g + 1) * n; i++) z[i] += sixth * total[i];
  }
}
