// A number type that records what is computed with it.
//
// A recording is a list of operations: the name of each, and the places of its operands in the
// list, or a constant's value. A branch, `when`, is always taken; assignments in it select between
// the new value and the old one.
#pragma once
#include "elementary.hpp"

namespace LEVEL {
struct Condition {
  long long place;
};

// The condition of the present branch; its place is -1 outside of branches.
inline Condition branch = {-1};

// Append to the list and return the place. Who keeps the list defines them:
// bindings/recorded_functions.hpp.
Condition append_constant(double value);
Condition append_row(const char* operation, int count, const long long* operands);

// Not inlined: the recorded functions are thousands of these calls.
template <class... Operands>
NOINLINE Condition append_operation(const char* operation, const Operands&... operands) {
  const long long places[3] = {operands.place...};
  return append_row(operation, sizeof...(operands), places);
}

struct Trace {
  long long place;
  Trace() = default;
  Trace(const Trace&) = default;
  Trace(double value) : Trace(append_constant(value)) {}
  explicit Trace(Condition recorded) : place(recorded.place) {}
  Trace& operator=(const Trace& value) {
    Condition taken = branch;
    place = taken.place < 0 ? value.place : append_operation("select", taken, value, *this).place;
    return *this;
  }
};

#define UNARY(R, T, function, name) \
  inline R function(T a) { return R(append_operation(#name, a)); }
#define BINARY(R, T, function, name) \
  inline R function(T a, T b) { return R(append_operation(#name, a, b)); }
BINARY(Trace, Trace, operator+, add)
BINARY(Trace, Trace, operator-, subtract)
BINARY(Trace, Trace, operator*, multiply)
BINARY(Trace, Trace, operator/, divide)
UNARY(Trace, Trace, operator-, negate)
BINARY(Condition, Trace, operator<, less)
BINARY(Condition, Trace, operator<=, less_equal)
BINARY(Condition, Trace, operator==, equal)
BINARY(Condition, Condition, operator&, both)
BINARY(Condition, Condition, operator|, either)
UNARY(Condition, Condition, operator!, inverse)
UNARY(Trace, Trace, abs, absolute)
UNARY(Trace, Trace, sqrt, square_root)
BINARY(Trace, Trace, copysign, copysign)
UNARY(Trace, Trace, power_of_two, power_of_two)
UNARY(Trace, Trace, exp, exp)
UNARY(Trace, Trace, tanh, tanh)
#undef UNARY
#undef BINARY
inline Condition operator>(Trace a, Trace b) { return b < a; }
inline Condition operator>=(Trace a, Trace b) { return b <= a; }
inline Condition operator!=(Trace a, Trace b) { return !(a == b); }
inline Trace fma(Trace a, Trace b, Trace c) { return Trace(append_operation("fma", a, b, c)); }
inline Trace select(Condition c, Trace a, Trace b) {
  return Trace(append_operation("select", c, a, b));
}
inline SinCos<Trace> sincos(Trace angle) {
  auto both = append_operation("sincos", angle);
  return {Trace(append_operation("sine", both)), Trace(append_operation("cosine", both))};
}

struct Taken {
  Condition before = branch;
  explicit Taken(Condition c) {
    branch = before.place < 0 ? c : append_operation("both", before, c);
  }
  Taken(const Taken&) = delete;
  ~Taken() { branch = before; }
  operator bool() const { return true; }
};
inline Taken when(Condition condition) { return Taken(condition); }
}  // namespace LEVEL
