// What the control laws share.
#pragma once
#include "../physics/plant.hpp"

namespace LEVEL {
// The members of a law besides its function `torque`. The number type is T, or `double` for a law
// with branches. Memory and Row are the structs of its memory, and of the row of its reference with
// the memory of the task behind it. LIST(ONE, MANY) names the constants, numbers and arrays: C++
// takes the law's fields from it, Python their order.
#define CAPSULE_LAW(Law, name, number, Memory, Row, LIST)                    \
  template <class T> using Number = number;                                  \
  template <class T> using Cells = Memory<T>;                                \
  template <class T> using Line = Row<T>;                                    \
  static constexpr const char* NAME = name;                                  \
  static constexpr const char* CONSTANTS = "" LIST(CAPSULE_NAME, LAW_NAMES); \
  static constexpr int MEMORY = WIDTH<Memory<double>>;                       \
  static constexpr int COLUMNS = WIDTH<Row<double>>;                         \
  LIST(CAPSULE_DOUBLE, LAW_FIELDS)                                           \
  explicit Law(const double* constants) : Law(*(const Law*)constants) {}
#define LAW_NAMES(name, count) #name ":" #count " "
#define LAW_FIELDS(name, count) double name[count];

// For a law without constants, without memory, and without a reference.
#define NO_CONSTANTS(ONE, MANY)
template <class T> struct NoMemory {
  T unused;
};
template <class T> struct NoReference {
  T theta_d, theta_d_dot;
};

// A row of the reference table: rad and m with their derivatives, and 1.0 where a cycle begins.
template <class T> struct Reference {
  T theta_d, theta_d_dot, theta_d_ddot, x_d, x_d_dot, x_d_ddot, cycle_start;
};

// The constants of a nominal plant.
#define NOMINAL_CONSTANTS(ONE) \
  ONE(M)                       \
  ONE(mu)                      \
  ONE(mass_ratio)              \
  ONE(pivot_torque_on_contact) \
  CAPSULE_PLANT(ONE)
template <class T, Kind kind> INLINE Plant<T, kind> nominal_plant(const auto& law) {
#define FIELD(name) law.name,
  return {NOMINAL_CONSTANTS(FIELD)};
#undef FIELD
}
}  // namespace LEVEL
