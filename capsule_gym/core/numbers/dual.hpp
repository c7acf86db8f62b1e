// Forward differentiation: a number and its derivatives along several directions, under the
// operators of one environment. The values have the bits of a double; conditions depend on them
// alone.
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
  template <class F> INLINE Dual(double v, F partial) : v(v) {
    for (int i = 0; i < COUNT; i++) d[i] = partial(i);
  }
#define PARTIAL(derivative) [&](int i) __attribute__((always_inline)) { return derivative; }
  // Register by register: g++ copies structs through memory.
  INLINE Dual(const Dual& a) : Dual(a.v, PARTIAL(a.d[i])) {}
  INLINE Dual& operator=(const Dual& a) {
    v = a.v;
    for (int i = 0; i < COUNT; i++) d[i] = a.d[i];
    return *this;
  }
  friend INLINE Dual operator+(const Dual& a, const Dual& b) {
    return Dual(a.v + b.v, PARTIAL(a.d[i] + b.d[i]));
  }
  friend INLINE Dual operator-(const Dual& a, const Dual& b) {
    return Dual(a.v - b.v, PARTIAL(a.d[i] - b.d[i]));
  }
  friend INLINE Dual operator-(const Dual& a) { return Dual(-a.v, PARTIAL(-a.d[i])); }
  friend INLINE Dual operator*(const Dual& a, const Dual& b) {
    return Dual(a.v * b.v, PARTIAL(a.d[i] * b.v + b.d[i] * a.v));
  }
  friend INLINE Dual operator/(const Dual& a, const Dual& b) {
    double quotient = a.v / b.v;
    double reciprocal = 1.0 / b.v;
    return Dual(quotient, PARTIAL((a.d[i] - b.d[i] * quotient) * reciprocal));
  }
  friend INLINE Dual fma(const Dual& a, const Dual& b, const Dual& c) {
    return Dual(fma(a.v, b.v, c.v), PARTIAL(a.d[i] * b.v + b.d[i] * a.v + c.d[i]));
  }
  // The whole turns that the function of a double subtracts have no derivative.
  friend INLINE SinCos<Dual> sincos(const Dual& a) {
    auto value = sincos(a.v);
    return {Dual(value.sin, PARTIAL(a.d[i] * value.cos)),
            Dual(value.cos, PARTIAL(a.d[i] * -value.sin))};
  }
  friend INLINE Dual select(bool condition, const Dual& a, const Dual& b) {
    return Dual(condition ? a.v : b.v, PARTIAL(condition ? a.d[i] : b.d[i]));
  }
  friend INLINE Dual abs(const Dual& a) { return select(a.v < 0.0, -a, a); }
#undef PARTIAL

#define COMPARISON(symbol) \
  friend INLINE bool operator symbol(const Dual& a, const Dual& b) { return a.v symbol b.v; }
  COMPARISON(<)
  COMPARISON(>)
  COMPARISON(<=)
  COMPARISON(>=)
  COMPARISON(==)
#undef COMPARISON
  // A factor that is zero counts where it has a derivative.
  friend INLINE bool acts(const Dual& a) {
    bool any = a.v != 0.0;
    for (int i = 0; i < COUNT; i++) any |= acts(Pack(a.d[i]));
    return any;
  }
};
INLINE double value(double a) { return a; }
INLINE double value(const Dual& a) { return a.v; }
}  // namespace LEVEL
