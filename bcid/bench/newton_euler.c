/* The Newton-Euler car, front driven, written by hand for C: the peer of our compiled rollouts.
   Compiled with -DREAL=float it computes in single precision. */
#include <math.h>
#ifndef REAL
#define REAL double
#endif
typedef REAL R;
#define INLINE inline __attribute__((always_inline))

typedef struct {
  R m, I_z, l_f, l_r, T_s, d, F_m_max, K_t, K_b, C_f, C_r, F_f_max, F_r_max, R_1, R_2, v_0;
} Car;
typedef struct { R v_x, v_y, w, delta; } State;

/* Of single or double precision, whichever R is. */
#define OF(name, ...) (sizeof(R) == 4 ? (R)name##f(__VA_ARGS__) : (R)name(__VA_ARGS__))
static INLINE R least(R a, R b) { return OF(fmin, a, b); }
static INLINE R most(R a, R b) { return OF(fmax, a, b); }
static INLINE R clip(R x, R low, R high) { return least(most(x, low), high); }
static INLINE R size(R x) { return OF(fabs, x); }

#ifdef POLYNOMIALS
/* Branch-free, so that loops over cars become vector code: about the nearest multiple of pi/2 by Taylor's series, and
   by a polynomial below tan(pi/8) that single precision gets fewer terms of. */
#define SHORT (sizeof(R) == 4)
static INLINE void sine_and_cosine(R x, R *s, R *c) {
  R q = OF(floor, x * (R)0.63661977236758134308 + (R)0.5);
  R y = (x - q * (R)1.5707963267341256) - q * (R)6.0771005065061922e-11, z = y * y;
  R odd = SHORT ? (R)(-1.0 / 6) + z * ((R)(1.0 / 120) + z * (R)(-1.0 / 5040))
                : (R)(-1.0 / 6) + z * ((R)(1.0 / 120) + z * ((R)(-1.0 / 5040) + z * ((R)(1.0 / 362880) +
                  z * ((R)(-1.0 / 39916800) + z * ((R)(1.0 / 6227020800.) + z * (R)(-1.0 / 1307674368000.))))));
  R even = SHORT ? (R)(1.0 / 24) + z * ((R)(-1.0 / 720) + z * (R)(1.0 / 40320))
                 : (R)(1.0 / 24) + z * ((R)(-1.0 / 720) + z * ((R)(1.0 / 40320) + z * ((R)(-1.0 / 3628800) +
                   z * ((R)(1.0 / 479001600) + z * ((R)(-1.0 / 87178291200.) + z * (R)(1.0 / 20922789888000.))))));
  R sin_y = y + y * z * odd, cos_y = 1 - (R)0.5 * z + z * z * even;
  R turned = q - 4 * OF(floor, (R)0.25 * q);
  int swapped = (turned == 1) | (turned == 3);
  R a = swapped ? cos_y : sin_y, b = swapped ? sin_y : cos_y;
  *s = turned >= 2 ? -a : a;
  *c = (turned == 1) | (turned == 2) ? -b : b;
}
static INLINE R angle(R y, R x) { /* atan(y/x) for x > 0 */
  R a = size(y);
  int steep = a > x;
  R low = steep ? x : a, high = steep ? a : x;
  int middle = low > (R)0.41421356237309504880 * high;
  R w = (middle ? low - high : low) / (middle ? low + high : high), z = w * w;
  R p = SHORT ? (R)0.9999999812646108 + z * ((R)-0.33332785771920354 + z * ((R)0.19974082415388142 + z *
                  ((R)-0.13848490211157605 + z * ((R)0.07976291803477795))))
                : (R)1.0000000000000002 + z * ((R)-0.3333333333329829 + z * ((R)0.19999999986905082 + z *
                  ((R)-0.14285713037727155 + z * ((R)0.1111105729264439 + z * ((R)-0.09089635745239827 + z *
                  ((R)0.07674293373806314 + z * ((R)-0.06508962196078655 + z * ((R)0.05030301131043289 + z *
                  ((R)-0.025345761550124208)))))))));
  R t = w * p + (middle ? (R)0.78539816339744830962 : 0);
  t = steep ? (R)1.57079632679489661923 - t : t;
  return OF(copysign, t, y);
}
#else
static INLINE void sine_and_cosine(R x, R *s, R *c) { *s = sin(x); *c = cos(x); }
static INLINE R angle(R y, R x) { return atan(y / x); }
#endif

static INLINE State rate(State q, R u_s, R u_m, Car p) {
  R s, c;
  sine_and_cosine(q.delta, &s, &c);
  R across = q.v_y + p.l_f * q.w, v_fx = c * q.v_x + s * across, v_fy = c * across - s * q.v_x;
  R F_af = clip(-p.C_f * angle(v_fy, most(size(v_fx), p.v_0)), -p.F_f_max, p.F_f_max);
  R F_ar = clip(-p.C_r * angle(q.v_y - p.l_r * q.w, most(size(q.v_x), p.v_0)), -p.F_r_max, p.F_r_max);
  R pulls = clip(p.K_t * (u_m - v_fx), 0, p.F_m_max), brakes = clip(u_m * p.K_b * v_fx, -p.F_m_max, p.F_m_max);
  R F_l = (u_m >= 0 ? pulls : brakes) - p.R_1 * v_fx - p.R_2 * v_fx * size(v_fx);
  R F_y = s * F_l + c * F_af;
  State rates = {(c * F_l - s * F_af) / p.m + q.w * q.v_y, (F_y + F_ar) / p.m - q.w * q.v_x,
                 (p.l_f * F_y - p.l_r * F_ar) / p.I_z, clip((u_s - q.delta) / p.T_s, -p.d, p.d)};
  return rates;
}
static INLINE State ahead(State q, R h, State k) {
  State there = {q.v_x + h * k.v_x, q.v_y + h * k.v_y, q.w + h * k.w, q.delta + h * k.delta};
  return there;
}
static INLINE State rk4(State q, R u_s, R u_m, Car p, R h) {
  State a = rate(q, u_s, u_m, p), b = rate(ahead(q, h / 2, a), u_s, u_m, p);
  State c = rate(ahead(q, h / 2, b), u_s, u_m, p), d = rate(ahead(q, h, c), u_s, u_m, p);
  return ahead(q, h / 6, ahead(ahead(ahead(a, 2, b), 2, c), 1, d));
}
static Car car_of(const double *constants) {
  Car p;
  for (int i = 0; i < 16; i++) ((R *)&p)[i] = (R)constants[i];
  return p;
}

/* Twists (N, 3) of one car under commands (N, 2). */
void rollout(const double *start, const double *commands, const double *constants, double period, long N, double *out) {
  Car p = car_of(constants);
  R h = (R)(0.5 * period);
  State q = {start[0], start[1], start[2], start[3]};
  for (long k = 0; k < N; k++) {
    R u_s = commands[2 * k], u_m = commands[2 * k + 1];
    q = rk4(rk4(q, u_s, u_m, p, h), u_s, u_m, p, h);
    out[3 * k] = q.v_x, out[3 * k + 1] = q.v_y, out[3 * k + 2] = q.w;
  }
}

#define ABREAST 256
/* Twists (B, N, 3) of B cars under commands (B, N, 2), ABREAST at once. */
void rollouts(const double *starts, const double *commands, const double *constants, double period, long B, long N,
              double *out) {
  Car p = car_of(constants);
  R h = (R)(0.5 * period);
  static R v_x[ABREAST], v_y[ABREAST], w[ABREAST], delta[ABREAST], u_s[ABREAST], u_m[ABREAST];
  for (long first = 0; first < B; first += ABREAST) {
    long n = B - first < ABREAST ? B - first : ABREAST;
    for (long b = 0; b < n; b++) {
      const double *x = starts + 4 * (first + b);
      v_x[b] = x[0], v_y[b] = x[1], w[b] = x[2], delta[b] = x[3];
    }
    for (long k = 0; k < N; k++) {
      for (long b = 0; b < n; b++) {
        const double *u = commands + 2 * ((first + b) * N + k);
        u_s[b] = u[0], u_m[b] = u[1];
      }
#pragma omp simd
      for (long b = 0; b < n; b++) {
        State q = {v_x[b], v_y[b], w[b], delta[b]};
        q = rk4(rk4(q, u_s[b], u_m[b], p, h), u_s[b], u_m[b], p, h);
        v_x[b] = q.v_x, v_y[b] = q.v_y, w[b] = q.w, delta[b] = q.delta;
      }
      for (long b = 0; b < n; b++) {
        double *t = out + 3 * ((first + b) * N + k);
        t[0] = v_x[b], t[1] = v_y[b], t[2] = w[b];
      }
    }
  }
}
