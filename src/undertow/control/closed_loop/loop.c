/* A vehicle under a controller: sample, compute, hold, integrate.

   Compiled together with the generated functions. What stands before this defines
     NX, NU, NS, NR   numbers of states, commands, states of the controller, desired values
     NY, NT           numbers of reported values and of the forces that the law asks for
   and the functions
     dynamics(x, u, p, t, x_dot), outputs(x, u, p, t, y),
     control(y, r, s, k, dt, u, s_next, tau), law(y, r, s, k, u, s_dot, tau)
   and RUN, the name under which the entry point is exported.

   Everything a call changes is in the block that it is handed: calls may run in parallel. */

#include <math.h>
#include <stdint.h>

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

typedef struct {
  double dt;                   /* sampling interval, s */
  int64_t substeps;            /* Runge-Kutta steps in it */
  int64_t continuous;          /* 1: the law acts at every stage and is not sampled */
  int64_t input_delay;         /* samples from a command to its thrust */
  const int64_t *output_delay; /* samples from a motion to its report, NY */
  const double *p, *r, *k;     /* parameters, desired values, gains */
  double *x, *s;               /* states of vehicle and controller; the first ones are given */
  double *commands, *reports;  /* rings of (input_delay + 1) x NU and (largest output_delay + 1) x NY */
  int64_t report_ring;         /* largest output_delay + 1 */
} Loop;

typedef struct {
  double *x, *y, *u, *s, *tau; /* a row for every sample */
} Record;

static void copy(double *to, const double *from, int64_t n) {
  for (int64_t i = 0; i < n; i++) to[i] = from[i];
}

/* One step of the vehicle with its commands held. */
static void held_step(const Loop *loop, const double *u, double t, double h) {
  static const double reach[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
  double stage[NX], total[NX], f[NX];
  for (int64_t i = 0; i < NX; i++) stage[i] = loop->x[i], total[i] = 0;
  for (int k = 0; k < 4; k++) {
    dynamics(stage, u, loop->p, t + reach[k] * h, f);
    const double next = k < 3 ? reach[k + 1] * h : 0;
    for (int64_t i = 0; i < NX; i++) total[i] += weight[k] * f[i], stage[i] = loop->x[i] + next * f[i];
  }
  for (int64_t i = 0; i < NX; i++) loop->x[i] += h / 6 * total[i];
}

/* One step of vehicle and law together. */
static void joint_step(const Loop *loop, const double *extra, double t, double h) {
  static const double reach[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
  double z[NX], w[NS], total[NX], total_s[NS], f[NX], g[NS], u[NU], y[NY], tau[NT];
  for (int64_t i = 0; i < NX; i++) z[i] = loop->x[i], total[i] = 0;
  for (int64_t i = 0; i < NS; i++) w[i] = loop->s[i], total_s[i] = 0;
  for (int64_t i = 0; i < NU; i++) u[i] = 0;
  for (int k = 0; k < 4; k++) {
    outputs(z, u, loop->p, t + reach[k] * h, y);
    law(y, loop->r, w, loop->k, u, g, tau);
    for (int64_t i = 0; i < NU; i++) u[i] += extra[i];
    dynamics(z, u, loop->p, t + reach[k] * h, f);
    const double next = k < 3 ? reach[k + 1] * h : 0;
    for (int64_t i = 0; i < NX; i++) total[i] += weight[k] * f[i], z[i] = loop->x[i] + next * f[i];
    for (int64_t i = 0; i < NS; i++) total_s[i] += weight[k] * g[i], w[i] = loop->s[i] + next * g[i];
  }
  for (int64_t i = 0; i < NX; i++) loop->x[i] += h / 6 * total[i];
  for (int64_t i = 0; i < NS; i++) loop->s[i] += h / 6 * total_s[i];
}

/* What the controller is told at a sample: the reports, each as old as its sensor is late, and noise. */
static void report(const Loop *loop, int64_t sample, const double *y, const double *noise, double *told) {
  copy(loop->reports + sample % loop->report_ring * NY, y, NY);
  for (int64_t i = 0; i < NY; i++) {
    const int64_t from = sample > loop->output_delay[i] ? sample - loop->output_delay[i] : 0;
    told[i] = loop->reports[from % loop->report_ring * NY + i] + noise[i];
  }
}

EXPORTED void RUN(const Loop *loop, const Record *record, int64_t first, int64_t samples, const double *noise,
                  const double *extra);

/* Samples first .. first + samples - 1; noise and extra commands have a row for each of them. */
void RUN(const Loop *loop, const Record *record, int64_t first, int64_t samples, const double *noise,
         const double *extra) {
  const int64_t ring = loop->input_delay + 1;
  const double h = loop->dt / (double)loop->substeps;
  for (int64_t n = 0; n < samples; n++) {
    const int64_t sample = first + n;
    const double t = (double)sample * loop->dt;
    double y[NY], next[NS], u[NU];
    double *told = record->y + n * NY, *command = record->u + n * NU;
    copy(record->x + n * NX, loop->x, NX);
    copy(u, loop->commands + (sample + ring - 1) % ring * NU, NU);
    outputs(loop->x, u, loop->p, t, y);
    report(loop, sample, y, noise + n * NY, told);
    const double hold = loop->continuous ? 0 : loop->dt;
    control(told, loop->r, loop->s, loop->k, &hold, command, next, record->tau + n * NT);
    copy(loop->s, next, NS);
    copy(record->s + n * NS, next, NS);
    copy(loop->commands + sample % ring * NU, command, NU);
    for (int64_t i = 0; i < NU; i++) {
      const double sent = sample >= loop->input_delay ? loop->commands[(sample + 1) % ring * NU + i] : 0;
      u[i] = sent + extra[n * NU + i];
    }
    for (int64_t k = 0; k < loop->substeps; k++) {
      const double at = t + (double)k * h;
      if (loop->continuous) joint_step(loop, extra + n * NU, at, h);
      else held_step(loop, u, at, h);
    }
  }
}
