/* Real: a double, or LANES of them that go through every operation together.

   LANES is 1, 4 or 8; more than 1 needs the vector extensions of GCC and Clang. What is called real_* does to each
   lane what the C function of that name does, NaN and zeros with a sign included. Only sines, cosines and tangents
   are our own; from LARGEST_ANGLE on they are those of the C library. */

#include "portable.h"
#ifdef __AVX__
#include <immintrin.h>
#endif

#ifndef LANES
#define LANES 1
#endif

/* --- sine and cosine of several angles at once -------------------------------------------------- */

#ifdef __GNUC__
#define WIDE (LANES > 1 ? LANES : 4)
#define LARGEST_ANGLE 2e4
typedef double Wide __attribute__((vector_size(8 * WIDE)));
typedef int64_t WideBits __attribute__((vector_size(8 * WIDE)));

/* Whether any lane is not zero. */
INLINE int wide_any(WideBits which) {
#if LANES == 8 && defined(__AVX512DQ__)
  return _mm512_movepi64_mask((__m512i)which) != 0;
#elif LANES < 8 && defined(__AVX__)
  return _mm256_movemask_pd((__m256d)which) != 0;
#else
  int64_t any = 0;
  for (int i = 0; i < WIDE; i++) any |= which[i];
  return any != 0;
#endif
}

static SEPARATE void wide_far(const Wide *angle, Wide *sine, Wide *cosine) {
  for (int i = 0; i < WIDE; i++)
    if (fabs((*angle)[i]) > LARGEST_ANGLE) (*sine)[i] = sin((*angle)[i]), (*cosine)[i] = cos((*angle)[i]);
}

/* The angle less the nearest multiple of pi/2 in three steps (Cody and Waite): the first product is exact, so is
   the second, and where a difference is small beside what it is of, it is exact, too. Then the polynomials of
   FreeBSD's msun. Off by at most 2 units in the last place. */
INLINE void wide_sincos(Wide angle, Wide *sine, Wide *cosine) {
  const double to_integer = 6755399441055744.0; /* 1.5 * 2^52: what is added to it loses its fraction */
  const Wide shifted = angle * 0.63661977236758134308 + to_integer;
  const WideBits quadrant = (WideBits)shifted;
  const Wide n = shifted - to_integer;
  const Wide near = (angle - n * 1.57079632673412561417e+00) - n * 6.07710050630396597660e-11;
  const Wide r = near - n * 2.02226624879595063154e-21;
  const Wide z = r * r, zz = z * z, half = 0.5 * z, most = 1.0 - half;
  const Wide s = (8.33333333332248946124e-03 - z * 1.98412698298579493134e-04) +
                 zz * ((2.75573137070700676789e-06 - z * 2.50507602534068634195e-08) + zz * 1.58969099521155010221e-10);
  const Wide c = (4.16666666666666019037e-02 - z * 1.38888888888741095749e-03) +
                 zz * ((2.48015872894767294178e-05 - z * 2.75573143513906633035e-07) +
                       zz * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11));
  /* The sign of r is that of its sine, also where r is zero. */
  const WideBits small = (WideBits)(r + z * r * (z * s - 1.66666666666666324348e-01)) | ((WideBits)r & INT64_MIN);
  const WideBits large = (WideBits)(most + (((1.0 - most) - half) + zz * c));
  const WideBits odd = -(quadrant & 1);
  *sine = (Wide)(((odd & large) | (~odd & small)) ^ ((quadrant & 2) << 62));
  *cosine = (Wide)(((odd & small) | (~odd & large)) ^ (((quadrant + 1) & 2) << 62));
  const WideBits far = (Wide)((WideBits)angle & INT64_MAX) > LARGEST_ANGLE;
  if (UNLIKELY(wide_any(far))) wide_far(&angle, sine, cosine);
}
#endif

/* --- one lane ------------------------------------------------------------------------------------ */

#if LANES == 1
typedef double Real, Stored;
typedef int Truth;
#define LANE(a, i) (a)

INLINE Real real(double value) { return value; }
INLINE Real real_where(Truth which, Real a, Real b) { return which ? a : b; }
INLINE Real real_truth(Truth which) { return which; }
INLINE Real real_fabs(Real a) { return fabs(a); }
INLINE Real real_floor(Real a) { return floor(a); }

/* Up to four angles. */
INLINE void real_sincos(int n, const Real *angle, Real *sine, Real *cosine) {
#ifdef __GNUC__
  Wide s, c;
  const Wide angles = {angle[0], n > 1 ? angle[1] : 0, n > 2 ? angle[2] : 0, n > 3 ? angle[3] : 0};
  wide_sincos(angles, &s, &c);
  for (int i = 0; i < n; i++) sine[i] = s[i], cosine[i] = c[i];
#else
  for (int i = 0; i < n; i++) sine[i] = sin(angle[i]), cosine[i] = cos(angle[i]);
#endif
}

/* --- several lanes ------------------------------------------------------------------------------- */

#else
typedef Wide Real;
typedef WideBits Truth;
typedef Wide Stored __attribute__((aligned(8), may_alias)); /* as it lies in an array of doubles */
#define LANE(a, i) ((a)[i])

#if LANES == 4
INLINE Real real(double v) { return (Real){v, v, v, v}; }
#else
INLINE Real real(double v) { return (Real){v, v, v, v, v, v, v, v}; }
#endif
INLINE Real real_where(Truth which, Real a, Real b) { return (Real)((which & (Truth)a) | (~which & (Truth)b)); }
INLINE Real real_truth(Truth which) { return (Real)(which & (Truth)real(1.0)); }
INLINE Real real_fabs(Real a) { return (Real)((Truth)a & INT64_MAX); }

/* From 2^52 on there is no fraction. The result has the sign of the number, also where it is zero. */
INLINE Real real_floor(Real a) {
  const double to_integer = 4503599627370496.0;
  const Real near = (real_fabs(a) + to_integer) - to_integer;
  const Real rounded = (Real)((Truth)near | ((Truth)a & INT64_MIN));
  const Real down = rounded - real_truth(rounded > a);
  return real_where(real_fabs(a) < to_integer, (Real)((Truth)down | ((Truth)a & INT64_MIN)), a);
}

INLINE void real_sincos(int n, const Real *angle, Real *sine, Real *cosine) {
  for (int i = 0; i < n; i++) wide_sincos(angle[i], sine + i, cosine + i);
}
#endif

/* --- for any number of lanes ------------------------------------------------------------------- */

#define COMPARISON(name, operator) \
  INLINE Real real_##name(Real a, Real b) { return real_truth(a operator b); }
COMPARISON(less, <)
COMPARISON(at_most, <=)
COMPARISON(equal, ==)
COMPARISON(unequal, !=)

INLINE Real real_and(Real a, Real b) { return real_truth((a != 0.0) & (b != 0.0)); }
INLINE Real real_or(Real a, Real b) { return real_truth((a != 0.0) | (b != 0.0)); }
INLINE Real real_not(Real a) { return real_truth(a == 0.0); }
INLINE Real real_if(Real which, Real a) { return real_where(which != 0.0, a, real(0.0)); }
INLINE Real real_sign(Real a) { return real_where(a == a, real_truth(a > 0.0) - real_truth(a < 0.0), a); }
/* As those of C: of a number and NaN the number. */
INLINE Real real_fmin(Real a, Real b) { return real_where((a < b) | (b != b), a, b); }
INLINE Real real_fmax(Real a, Real b) { return real_where((a > b) | (b != b), a, b); }

#define LANE_BY_LANE(name) \
  INLINE Real real_##name(Real a) { \
    Real result = a; \
    for (int i = 0; i < LANES; i++) LANE(result, i) = name(LANE(a, i)); \
    return result; \
  }
LANE_BY_LANE(asin)
LANE_BY_LANE(acos)
LANE_BY_LANE(atan)
LANE_BY_LANE(sinh)
LANE_BY_LANE(cosh)
LANE_BY_LANE(tanh)
LANE_BY_LANE(exp)
LANE_BY_LANE(log)
LANE_BY_LANE(sqrt)

#define LANE_BY_LANE_OF_TWO(name) \
  INLINE Real real_##name(Real a, Real b) { \
    Real result = a; \
    for (int i = 0; i < LANES; i++) LANE(result, i) = name(LANE(a, i), LANE(b, i)); \
    return result; \
  }
LANE_BY_LANE_OF_TWO(atan2)
LANE_BY_LANE_OF_TWO(pow)
