// The control laws.
#pragma once
#include "plant.hpp"

namespace LEVEL {

// The direct-torque task: none, so that the residual torque is the whole torque.
struct NoLaw {
  static constexpr const char* NAME = "none";
  static constexpr const char* CONSTANTS = "";
  static constexpr int MEMORY = 1, COLUMNS = 2;
  static constexpr bool BRANCHES = false;
  explicit NoLaw(const double*) {}
  template <class T> INLINE T operator()(const State<T>&, T*, const T*) const { return T(0.0); }
};

}  // namespace LEVEL

#define CAPSULE_LAWS(LAW) LAW(NoLaw)
