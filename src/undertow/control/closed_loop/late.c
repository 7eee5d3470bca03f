/* The controller behind an observer whose reports come late, in place of a generated `control`.

   What stands before this defines
     NZ, STEP         numbers of what the filter carries, and of a step of the past: known commands, reports, which
                      of them there are, whether the loop had begun
     KEPT             steps of the past that are kept, the oldest first
     SENSORS, KNOWN   numbers of sensors and of commands that the observer knows
     OWN              number of states of the controller
     sensor, lag      places of the sensors among the reports, and samples that each is late
   and the functions
     due(age, dt, there, age_next), again(z, step, dt, z_next),
     present(z, step, r, s, k, dt, u, known, z_next, s_next, tau). */

static SEPARATE void control(const Real *y, const Real *r, const Real *s, const Real *k, const double *dt, Real *u,
                             Real *s_next, Real *tau) {
  const Real *past = s + NZ, *kept = past + NZ, *age = kept + KEPT * STEP, *own = age + SENSORS;
  Real z[NZ], oldest[NZ], ahead[NZ], steps[(KEPT + 1) * STEP], *now = steps + KEPT * STEP;
  Real there[SENSORS], since[SENSORS], known[KNOWN], states[OWN];
  for (int i = 0; i < NZ; i++) z[i] = past[i];
  for (int i = 0; i < KEPT * STEP; i++) steps[i] = kept[i];
  for (int i = 0; i < STEP; i++) now[i] = real(i == STEP - 1);
  due(age, dt, there, since);
  for (int i = 0; i < SENSORS; i++) {
    Real *then = now - lag[i] * STEP + KNOWN;
    then[i] = y[sensor[i]], then[SENSORS + i] = there[i];
  }
  for (int j = 0; j < KEPT; j++) {
    again(z, steps + j * STEP, dt, z);
    if (!j)
      for (int i = 0; i < NZ; i++) oldest[i] = z[i];
  }
  present(z, now, r, own, k, dt, u, known, ahead, states, tau);
  for (int i = 0; i < KNOWN; i++) now[i] = known[i];
  for (int i = 0; i < NZ; i++) *s_next++ = ahead[i];
  for (int i = 0; i < NZ; i++) *s_next++ = oldest[i];
  for (int i = STEP; i < (KEPT + 1) * STEP; i++) *s_next++ = steps[i];
  for (int i = 0; i < SENSORS; i++) *s_next++ = since[i];
  for (int i = 0; i < OWN; i++) *s_next++ = states[i];
}
