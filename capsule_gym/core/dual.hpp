// Forward differentiation: a number and its derivatives along several directions, under the operators of one
// environment. The values have the bits of a double; conditions depend on them alone.
#pragma once
#include "elementary.hpp"

namespace LEVEL {
constexpr int DIRECTIONS = 8;

struct Dual {
  static constexpr int COUNT = DIRECTIONS / PACK;
  double v;
  // As many registers as they need: compilers spill vectors that are wider than a register.
  Doubles d[COUNT];
  Dual() = default;
  INLINE Dual(double v) : v(v), d{} {}

  // The number with this value, and with partial(i) in register i of the derivatives.
  template <class F> static INLINE Dual make(double v, F partial) {
    Dual number;
    number.v = v;
    for (int i = 0; i < COUNT; i++) number.d[i] = partial(i);
    return number;
  }
#define PARTIAL(derivative) [&](int i) __attribute__((always_inline)) { return derivative; }
  friend INLINE Dual operator+(const Dual& a, const Dual& b) { return make(a.v + b.v, PARTIAL(a.d[i] + b.d[i])); }
  friend INLINE Dual operator-(const Dual& a, const Dual& b) { return make(a.v - b.v, PARTIAL(a.d[i] - b.d[i])); }
  friend INLINE Dual operator-(const Dual& a) { return make(-a.v, PARTIAL(-a.d[i])); }
  friend INLINE Dual operator*(const Dual& a, const Dual& b) {
    return make(a.v * b.v, PARTIAL(a.d[i] * b.v + b.d[i] * a.v));
  }
  friend INLINE Dual operator/(const Dual& a, const Dual& b) {
    double quotient = a.v / b.v, reciprocal = 1.0 / b.v;
    return make(quotient, PARTIAL((a.d[i] - b.d[i] * quotient) * reciprocal));
  }
  friend INLINE Dual fma(const Dual& a, const Dual& b, const Dual& c) {
    return make(fma(a.v, b.v, c.v), PARTIAL(a.d[i] * b.v + b.d[i] * a.v + c.d[i]));
  }
  // The whole turns that the function of a double subtracts have no derivative.
  friend INLINE SinCos<Dual> sincos(const Dual& a) {
    auto value = sincos(a.v);
    return {make(value.sin, PARTIAL(a.d[i] * value.cos)), make(value.cos, PARTIAL(a.d[i] * -value.sin))};
  }
#undef PARTIAL

#define COMPARISON(symbol) \
  friend INLINE bool operator symbol(const Dual& a, const Dual& b) { return a.v symbol b.v; }
  COMPARISON(<) COMPARISON(>) COMPARISON(<=) COMPARISON(>=) COMPARISON(==)
#undef COMPARISON
  friend INLINE Dual select(bool condition, const Dual& a, const Dual& b) { return condition ? a : b; }
  friend INLINE Dual abs(const Dual& a) { return a.v < 0.0 ? -a : a; }
  // A factor that is zero counts where it has a derivative.
  friend INLINE bool acts(const Dual& a) {
    bool any = a.v != 0.0;
    for (int i = 0; i < DIRECTIONS; i++) any |= ((const double*)&a.d)[i] != 0.0;
    return any;
  }
};
INLINE double value(double a) { return a; }
INLINE double value(const Dual& a) { return a.v; }
}  // namespace LEVEL
