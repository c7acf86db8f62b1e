// Sine, cosine, exponential, logarithm and hyperbolic tangent with the same bits on every machine.
//
// The results of the standard libraries differ in the last digit between versions and instruction
// sets, and no loop that calls them is vectorised. The functions here are straight-line arithmetic,
// and one environment gives the bits of a batch. The multiplications and additions of the
// polynomials are fused explicitly: a compiler that may fuse freely decides differently in
// different loops. tests/capsule_gym/core/test_elementary.py checks the errors.
#pragma once
#include "number.hpp"

namespace LEVEL {
// 2 pi to twice the precision of a double.
constexpr double TURN = 2.0 * PI;
constexpr double TURN_REST = 2.4492935982947064e-16;
constexpr double TURNS_PER_RADIAN = 1.0 / TURN;
// Adding and subtracting it rounds a number below 2^51 to a whole number, half to even.
constexpr double ROUNDING = 1.5 * 4503599627370496.0;

// Coefficients of polynomials in z = y^2 that interpolate (sin(y) / y - 1) / z and
// (cos(y) - 1 + z / 2) / z^2 at the Chebyshev nodes of [0, (1.0001 pi / 2)^2].
constexpr double SINE[8] = {-0.16666666666666666,    0.008333333333333316,
                            -0.00019841269841254955, 2.755731921915843e-06,
                            -2.5052107616384595e-08, 1.6058977272815506e-10,
                            -7.643969031052769e-13,  2.731428986122616e-15};
constexpr double COSINE[8] = {0.041666666666666664,   -0.001388888888888888,
                              2.4801587301579844e-05, -2.7557319221567154e-07,
                              2.0876756602568905e-09, -1.1470712252875163e-11,
                              4.777877290768691e-14,  -1.521855926409455e-16};

// The polynomial of third degree in z with these coefficients, from zz = z^2. In pairs instead of
// Horner's scheme: a single environment waits for every operation that waits for another.
template <class T> INLINE T cubic(const double* c, T z, T zz) {
  return fma(fma(c[3], z, c[2]), zz, fma(c[1], z, c[0]));
}

template <class T> struct SinCos {
  T sin, cos;
};

// Sine and cosine of an angle in rad: within 3.4e-16 of the exact values up to +-pi / 2,
// within 1.2e-15 beyond.
//
// The angle is brought to +-pi by whole turns and halved; in sin(2 y) = 2 sin(y) cos(y) and cos(2
// y) = 1 - 2 sin(y)^2 the remaining half turns cancel, so that no quadrant has to be determined.
template <class T> INLINE SinCos<T> sincos(T angle) {
  T turns = fma(angle, TURNS_PER_RADIAN, ROUNDING) - ROUNDING;
  T y = fma(-turns, 0.5 * TURN_REST, fma(-turns, 0.5 * TURN, 0.5 * angle));
  T z = y * y;
  T zz = z * z;
  T s = fma(cubic(SINE + 4, z, zz), zz * zz, cubic(SINE, z, zz));
  T c = fma(cubic(COSINE + 4, z, zz), zz * zz, cubic(COSINE, z, zz));
  T twice = y + y;
  T sine = fma(y * z, s, y);
  T doubled = fma(twice * z, s, twice);
  T cosine = fma(zz, c, fma(-0.5, z, 1.0));
  return {doubled * cosine, fma(-doubled, sine, 1.0)};
}

// The logarithm of 2 to twice the precision of a double.
constexpr double LN_2 = 0.6931471805599453;
constexpr double LN_2_REST = 2.3190468138462996e-17;
constexpr double LOG2_E = 1.0 / LN_2;
// Interpolates (exp(r) - 1 - r) / r^2 at the Chebyshev nodes of +-1.0001 ln(2) / 2, which
// leaves 4.1e-17 of exp(r) - 1.
constexpr double EXPONENTIAL[10] = {
    0.5000000000000001,     0.16666666666666669,    0.04166666666662413,    0.008333333333330062,
    0.0013888888917213717,  0.00019841269863053618, 2.4801521295954376e-05, 2.7557268459997064e-06,
    2.7620088445409746e-07, 2.510038549551032e-08};

template <class T> struct Exponential {
  T scale, rest;
};

// 2^n for n + ROUNDING: the lowest digits of the sum become the exponent.
template <class T> INLINE T power_of_two(T shifted) {
  return from_bits((bits_of(shifted) << 52) + (1023ULL << 52));
}

// 2^n and exp(r) - 1 with x = n ln(2) + r and |r| <= ln(2) / 2; |n| must not exceed 1022.
template <class T> INLINE Exponential<T> exponential(T x) {
  T shifted = fma(x, LOG2_E, ROUNDING);
  T n = shifted - ROUNDING;
  T r = fma(-n, LN_2_REST, fma(-n, LN_2, x));
  T z = r * r;
  T zz = z * z;
  T low = cubic(EXPONENTIAL, r, z);
  T middle = cubic(EXPONENTIAL + 4, r, z);
  T high = fma(EXPONENTIAL[9], r, EXPONENTIAL[8]);
  T p = fma(fma(high, zz, middle), zz, low);
  return {power_of_two(shifted), fma(z, p, r)};
}

// e^x, within 1.7e-16 of the exact value relative to it; |x| must not exceed 708.
template <class T> INLINE T exp(T x) {
  auto [scale, rest] = exponential(x);
  return fma(scale, rest, scale);
}

// e^-x for any x >= 0; beyond 700, where `exp` ends, it stays at 1e-304.
template <class T> INLINE T decay(T x) { return exp(-min(x, T(700.0))); }

// The hyperbolic tangent, within 4.3e-16 of the exact value relative to it; NaN stays NaN.
template <class T> INLINE T tanh(T x) {
  // From here on it is 1 to the last digit.
  constexpr double FLAT = 20.0;
  T size = abs(x);
  size = select(size > FLAT, T(FLAT), size);
  auto [scale, rest] = exponential(-2.0 * size);
  T e = fma(scale, rest, scale - 1.0);  // exp(-2 |x|) - 1
  return copysign(e / (e + 2.0), x);
}

// The natural logarithm of a positive, normal number, within 2.2e-16 of the exact value, beyond +-1
// relative to it; for any other number the result is meaningless. Halley's iteration on `exp`, each
// step of which triples the digits.
inline double log(double x) {
  Word word = bits_of(x);
  double exponent = (double)((long long)(word >> 52 & 2047) - 1022);
  double mantissa = from_bits((word & ~(2047ULL << 52)) | 1022ULL << 52);  // in [0.5, 1)
  double y = fma(exponent, LN_2, mantissa - 1.0);
  for (int i = 0; i < 4; i++) {
    double power = exp(y);
    y += 2.0 * (x - power) / (x + power);
  }
  return y;
}
}  // namespace LEVEL
