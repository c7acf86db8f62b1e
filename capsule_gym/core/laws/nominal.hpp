// The constants of a law: one list of names, from which C++ takes the fields and Python their order.
#pragma once
#include "../plant.hpp"

namespace LEVEL {

#define LAW_FIELD(name) double name;
#define LAW_FIELDS(name, count) double name[count];
#define LAW_NAME(name) #name " "
#define LAW_NAMES(name, count) #name ":" #count " "

// The constants `q` of a law from its list of names, where ONE declares a number and MANY an array.
#define CAPSULE_LAW(Law, LIST)                                                                                         \
  static constexpr const char* CONSTANTS = LIST(LAW_NAME, LAW_NAMES);                                                  \
  struct Constants {                                                                                                   \
    LIST(LAW_FIELD, LAW_FIELDS)                                                                                        \
  } q;                                                                                                                 \
  explicit Law(const double* constants) : q(load<Constants>(constants)) {}

// The nominal plant of a law.
#define NOMINAL_CONSTANTS(ONE) ONE(M) ONE(mu) ONE(mass_ratio) ONE(pivot_torque_on_contact) CAPSULE_PLANT(ONE)

template <class T, Kind kind, class Q> INLINE Plant<T, kind> nominal_plant(const Q& q) {
#define FIELD(name) q.name,
  return {q.M, q.mu, q.mass_ratio, CAPSULE_PLANT(FIELD) q.pivot_torque_on_contact};
#undef FIELD
}

}  // namespace LEVEL
