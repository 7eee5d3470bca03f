/* Sigma points around x, by the columns of the Cholesky factor of P, one after the other in s. */
static void @NAME@_points(const @REAL@ *x, const @REAL@ *P, @REAL@ *s) {
  @REAL@ *column = &s[@N@];
  for (int j = 0; j < @N@; j++) {
    for (int i = 0; i < @N@; i++) {
      @REAL@ rest = (i < j) ? @ZERO@ : P[(i * @N@) + j];
      for (int k = 0; (k < j) && (i >= j); k++) {
        rest -= column[(k * @N@) + i] * column[(k * @N@) + j];
      }
      column[(j * @N@) + i] = rest;
    }
    const @REAL@ pivot = column[(j * @N@) + j];
    const @REAL@ scale = (pivot > (@ROUNDING@ * P[(j * @N@) + j])) ? @ONE@ / @CALL@(sqrt)(pivot) : @ZERO@;
    for (int i = j; i < @N@; i++) {
      column[(j * @N@) + i] *= scale;
    }
  }
  for (int i = 0; i < @N@; i++) {
    s[i] = x[i];
  }
  for (int k = 0; k < (@N@ * @N@); k++) {
    const @REAL@ off = @REACH@ * column[k];
    column[(@N@ * @N@) + k] = x[k % @N@] - off;
    column[k] = x[k % @N@] + off;
  }
}

/* Mean of every width-th number, one for each point; what is left there is the deviation from it. */
static @REAL@ @NAME@_centred(@REAL@ *s, int width) {
  @REAL@ mean = @ZERO@;
  for (int k = 1; k < @COUNT@; k++) {
    mean += s[k * width];
  }
  mean = (@SHARE@ * mean) + (@CENTRE@ * s[0]);
  for (int k = 0; k < @COUNT@; k++) {
    s[k * width] -= mean;
  }
  return mean;
}

static @REAL@ @NAME@_covariance(const @REAL@ *a, int wide, const @REAL@ *b, int width) {
  @REAL@ sum = @ZERO@;
  for (int k = 1; k < @COUNT@; k++) {
    sum += a[k * wide] * b[k * width];
  }
  return (@SHARE@ * sum) + (@SPREAD@ * a[0] * b[0]);
}

void @NAME@_predict(const @REAL@ *x, const @REAL@ *P, const @REAL@ *u, const @NAME@_parameters *p, @REAL@ t,
                    @REAL@ dt, @REAL@ *xn, @REAL@ *Pn) {
  @REAL@ s[@COUNT@ * @N@];
  @NAME@_points(x, P, s);
  for (int k = 0; k < @COUNT@; k++) {
    @NAME@_moved(&s[k * @N@], u, p, t, dt, &s[k * @N@]);
  }
  @NAME@_noise(x, u, p, t, dt, Pn);
  for (int i = 0; i < @N@; i++) {
    xn[i] = @NAME@_centred(&s[i], @N@);
  }
  for (int k = 0; k < (@N@ * @N@); k++) {
    Pn[k] += @NAME@_covariance(&s[k / @N@], @N@, &s[k % @N@], @N@);
  }
}

/* State after a report y of variance r, given the points and what is reported at each. */
static @REAL@ @NAME@_update_by(@REAL@ *x, @REAL@ *P, @REAL@ *s, @REAL@ *z, @REAL@ y, @REAL@ r, @REAL@ gate,
                             int angle) {
  @REAL@ gain[@N@];
  const @REAL@ error = y - @NAME@_centred(z, 1);
  const @REAL@ turns = (angle != 0) ? @CALL@(floor)((error / @TURN@) + @HALF@) : @ZERO@;
  const @REAL@ innovation = error - (@TURN@ * turns);
  const @REAL@ variance = @NAME@_covariance(z, 1, z, 1) + r;
  const @REAL@ nis = innovation * innovation / variance;
  if (!(nis > gate)) {
    for (int i = 0; i < @N@; i++) {
      for (int k = 0; k < @COUNT@; k++) {
        s[(k * @N@) + i] -= x[i];
      }
      gain[i] = @NAME@_covariance(&s[i], @N@, z, 1) / variance;
      for (int k = 0; k < @COUNT@; k++) {
        s[(k * @N@) + i] -= z[k] * gain[i];
      }
      x[i] += gain[i] * innovation;
    }
    for (int k = 0; k < (@N@ * @N@); k++) {
      const int i = k / @N@;
      const int j = k % @N@;
      P[k] = @NAME@_covariance(&s[i], @N@, &s[j], @N@) + (gain[i] * gain[j] * r);
    }
  }
  return nis;
}
