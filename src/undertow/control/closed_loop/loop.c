/* Vehicles under a controller: sample, compute, hold, integrate; LANES of them side by side (lanes.h).

   Compiled together with the generated functions. What stands before this defines
     NX, NU, NS, NR   numbers of states, commands, states of the controller, desired values
     NY, NT           numbers of reported values and of the forces that the law asks for
     NP, NK           numbers of parameters and gains
     NQ, NW           numbers of what follows from parameters alone, and from that and held commands
   (none of the arrays is empty: what has no entry counts one) and the functions
     prepare(p, q), hold(u, q, w), held_dynamics(x, w, q, t, x_dot), outputs(x, u, p, t, y),
     control(y, r, s, k, dt, u, s_next, tau), law(y, r, s, k, u, s_dot, tau)
   and RUN, the name under which the entry point is exported.

   Arrays hold the lanes of a number side by side, so that a group of LANES runs is read like one run. Everything
   a call changes is in the groups that it is given: calls for different groups may run in parallel. */

typedef struct {
  double dt;                   /* sampling interval, s */
  int64_t substeps;            /* Runge-Kutta steps in it */
  int64_t continuous;          /* 1: the law acts at every stage and is not sampled */
  int64_t input_delay;         /* samples from a command to its thrust */
  int64_t report_ring;         /* largest output_delay + 1 */
  const int64_t *output_delay; /* samples from a motion to its report, NY */
  int64_t stride, rows;        /* samples from one recorded row to the next, rows of a group in this call */
  /* Parameters, desired values, gains; the first distances are those from group to group. */
  int64_t p_step, r_step, k_step;
  const double *p, *r, *k;
  double *x, *s;               /* states of vehicle and controller; the first ones are given */
  double *command;             /* the last one, NU */
  double *commands, *reports;  /* rings of (input_delay + 1) x NU and of report_ring x NY */
  const double *noise;         /* of every sample of a call, NY; or none */
  const double *extra;         /* commands beside those of the controller, of every sample, NU; or none */
  double *record[5];           /* x, reports, commands, s, tau: a row for every stride samples; or none */
} Loop;

#define GROUP 1
#define NUMBER Real
#define TIME double
#include "runge_kutta.h"

/* One run, or several in lanes. */
typedef struct {
  const Loop *loop;
  Real z[NX + NS], *x, *s; /* states of the vehicle, then of the controller */
  Real p[NP], q[NQ], r[NR], k[NK];
  Real command[NU]; /* the last one */
  double *commands, *reports;
} Group;

INLINE void take(Real *to, const double *from, int n) {
  for (int i = 0; i < n; i++) to[i] = ((const Stored *)from)[i];
}

INLINE void put(double *to, const Real *from, int n) {
  for (int i = 0; i < n; i++) ((Stored *)to)[i] = from[i];
}

typedef struct {
  const Group *group;
  const Real *w;         /* what follows from held commands */
  const double *extra;   /* commands beside those of the law, or none */
  Real u[NU];            /* the last commands of the law */
} Moving;

/* The vehicle with its commands held. */
INLINE void held_rates(void *system, const double *t, const Real *x, Real *x_dot) {
  const Moving *moving = system;
  held_dynamics(x, moving->w, moving->group->q, *t, x_dot);
}

/* Vehicle and law together. */
INLINE void joint_rates(void *system, const double *t, const Real *z, Real *rate) {
  Moving *moving = system;
  const Group *group = moving->group;
  Real *u = moving->u, w[NW], y[NY], tau[NT];
  outputs(z, u, group->p, *t, y);
  law(y, group->r, z + NX, group->k, u, rate + NX, tau);
  for (int i = 0; i < NU; i++) u[i] += moving->extra ? moving->extra[i] : 0.0;
  hold(u, group->q, w);
  held_dynamics(z, w, group->q, *t, rate);
}

INLINE void held_step(Group *group, const Real *w, double t, double h) {
  Real room[3 * NX];
  Moving moving = {group, w, 0, {real(0)}};
  runge_kutta(held_rates, &moving, 1, NX, 0, &t, &h, group->z, room);
}

static void joint_step(Group *group, const double *extra, double t, double h) {
  Real room[3 * (NX + NS)];
  Moving moving = {group, 0, extra, {real(0)}};
  runge_kutta(joint_rates, &moving, 1, NX + NS, 0, &t, &h, group->z, room);
}

/* What the controller gets at a sample: the reports y, each as old as its sensor is late, and noise. */
INLINE void report(const Group *group, int64_t sample, const double *noise, Real *y) {
  const int64_t ring = group->loop->report_ring;
  if (ring > 1) {
    put(group->reports + sample % ring * NY * LANES, y, NY);
    for (int i = 0; i < NY; i++) {
      const int64_t late = group->loop->output_delay[i], from = sample > late ? sample - late : 0;
      take(y + i, group->reports + (from % ring * NY + i) * LANES, 1);
    }
  }
  if (!noise) return;
  Real added[NY];
  take(added, noise, NY);
  for (int i = 0; i < NY; i++) y[i] += added[i];
}

/* What the thrusters are sent at a sample: the command of now or, where they are late, of then; room for NU. */
INLINE const Real *sent(const Group *group, int64_t sample, const double *extra, Real *room) {
  const int64_t delay = group->loop->input_delay, ring = delay + 1;
  const Real *u = group->command;
  if (delay) {
    put(group->commands + sample % ring * NU * LANES, u, NU);
    if (sample >= delay) take(room, group->commands + (sample + 1) % ring * NU * LANES, NU);
    else
      for (int i = 0; i < NU; i++) room[i] = real(0);
    u = room;
  }
  if (!extra) return u;
  for (int i = 0; i < NU; i++) room[i] = u[i] + extra[i];
  return room;
}

INLINE void record(const Loop *loop, int64_t row, int what, const Real *from, int n) {
  if (loop->record[what]) put(loop->record[what] + row * n * LANES, from, n);
}

/* One sample of the controller and the motion up to the next; recorded in a row, unless that is below zero. */
INLINE void one_sample(Group *group, int64_t sample, const double *noise, const double *extra, int64_t row) {
  const Loop *loop = group->loop;
  const double t = (double)sample * loop->dt, h = loop->dt / (double)loop->substeps;
  const double hold_for = loop->continuous ? 0 : loop->dt;
  Real room[NU], y[NY], tau[NT], w[NW];
  if (row >= 0) record(loop, row, 0, group->x, NX);
  outputs(group->x, group->command, group->p, t, y);
  report(group, sample, noise, y);
  control(y, group->r, group->s, group->k, &hold_for, group->command, group->s, tau);
  if (row >= 0) {
    record(loop, row, 1, y, NY), record(loop, row, 2, group->command, NU);
    record(loop, row, 3, group->s, NS), record(loop, row, 4, tau, NT);
  }
  if (loop->continuous) {
    for (int64_t k = 0; k < loop->substeps; k++) joint_step(group, extra, t + (double)k * h, h);
    return;
  }
  hold(sent(group, sample, extra, room), group->q, w);
  for (int64_t k = 0; k < loop->substeps; k++) held_step(group, w, t + (double)k * h, h);
}

EXPORTED void RUN(const Loop *loop, int64_t begin, int64_t end, int64_t first, int64_t samples);

/* Samples first .. first + samples - 1 of the groups begin .. end - 1. */
void RUN(const Loop *loop, int64_t begin, int64_t end, int64_t first, int64_t samples) {
  const int64_t stride = loop->stride;
  for (int64_t g = begin; g < end; g++) {
    Group group;
    group.loop = loop, group.x = group.z, group.s = group.z + NX;
    take(group.x, loop->x + g * NX * LANES, NX);
    take(group.s, loop->s + g * NS * LANES, NS);
    take(group.p, loop->p + g * loop->p_step, NP);
    take(group.r, loop->r + g * loop->r_step, NR);
    take(group.k, loop->k + g * loop->k_step, NK);
    group.commands = loop->commands + g * (loop->input_delay + 1) * NU * LANES;
    group.reports = loop->reports + g * loop->report_ring * NY * LANES;
    take(group.command, loop->command + g * NU * LANES, NU);
    prepare(group.p, group.q);
    int64_t row = 0, next = (first + stride - 1) / stride * stride;
    for (int64_t n = 0; n < samples; n++) {
      const int64_t sample = first + n;
      const double *noise = loop->noise ? loop->noise + (g * samples + n) * NY * LANES : 0;
      const double *extra = loop->extra ? loop->extra + n * NU : 0;
      if (sample == next) {
        one_sample(&group, sample, noise, extra, g * loop->rows + row);
        row++, next += stride;
      } else {
        one_sample(&group, sample, noise, extra, -1);
      }
    }
    put(loop->x + g * NX * LANES, group.x, NX);
    put(loop->s + g * NS * LANES, group.s, NS);
    put(loop->command + g * NU * LANES, group.command, NU);
  }
}
