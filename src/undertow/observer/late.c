static void @NAME@_keep(@NAME@_memory *m, int k, const @REAL@ *x, const @REAL@ *P) {
  for (int i = 0; i < @N@; i++) {
    m->x[k][i] = x[i];
  }
  for (int i = 0; i < (@N@ * @N@); i++) {
    m->P[k][i] = P[i];
  }
  for (int i = 0; i < @SENSORS@; i++) {
    m->there[k][i] = 0;
  }
}

void @NAME@_begin(@NAME@_memory *m, const @REAL@ *x, const @REAL@ *P, @REAL@ t) {
  for (int i = 0; i < @COMMANDS@; i++) {
    m->u[0][i] = @ZERO@;
  }
  m->t[0] = t;
  m->dt[0] = @ZERO@;
  m->newest = 0;
  m->kept = 1;
  @NAME@_keep(m, 0, x, P);
}

void @NAME@_step(@NAME@_memory *m, @REAL@ *x, @REAL@ *P, const @REAL@ *u, const @NAME@_parameters *p, @REAL@ dt) {
  const int k = (m->newest + 1) % @KEPT@;
  @NAME@_predict(x, P, u, p, m->t[m->newest], dt, x, P);
  for (int i = 0; i < @COMMANDS@; i++) {
    m->u[k][i] = u[i];
  }
  m->t[k] = m->t[m->newest] + dt;
  m->dt[k] = dt;
  m->newest = k;
  m->kept += (m->kept < @KEPT@) ? 1 : 0;
  @NAME@_keep(m, k, x, P);
}

/* Sets x and P to the newest step, done again from a step on; returned is what one report of that step says. */
static @REAL@ @NAME@_again(@NAME@_memory *m, @REAL@ *x, @REAL@ *P, const @NAME@_parameters *p, int from, int sensor) {
  @REAL@ found = @ZERO@;
  int k = from;
  for (int i = 0; i < @N@; i++) {
    x[i] = m->x[k][i];
  }
  for (int i = 0; i < (@N@ * @N@); i++) {
    P[i] = m->P[k][i];
  }
  for (;;) {
@UPDATES@
    if (k == m->newest) {
      break;
    }
    k = (k + 1) % @KEPT@;
    @NAME@_predict(x, P, m->u[k], p, m->t[k] - m->dt[k], m->dt[k], x, P);
    for (int i = 0; i < @N@; i++) {
      m->x[k][i] = x[i];
    }
    for (int i = 0; i < (@N@ * @N@); i++) {
      m->P[k][i] = P[i];
    }
  }
  return found;
}

/* The report of a sensor that came late is of the step when it was true, the nearest that is kept. */
static @REAL@ @NAME@_late(@NAME@_memory *m, @REAL@ *x, @REAL@ *P, const @NAME@_parameters *p, int sensor, @REAL@ age,
                        @REAL@ y) {
  const @REAL@ when = m->t[m->newest] - age;
  int k = m->newest;
  int back = 1;
  while ((back < m->kept) && (@CALL@(fabs)(m->t[(k + @KEPT@ - 1) % @KEPT@] - when) < @CALL@(fabs)(m->t[k] - when))) {
    k = (k + @KEPT@ - 1) % @KEPT@;
    back++;
  }
  @REAL@ nis = -@ONE@;
  if ((m->t[k] - when) <= (@HALF@ * m->dt[m->newest])) {
    m->y[k][sensor] = y;
    m->there[k][sensor] = 1;
    nis = @NAME@_again(m, x, P, p, k, sensor);
  }
  return nis;
}
