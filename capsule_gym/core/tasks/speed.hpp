// The task `speed`: forwards as fast as possible.
#pragma once
#include "task.hpp"

namespace LEVEL {
struct Speed {
  static constexpr const char* NAME = "speed";
  // It has no memory and adds no entries to the observation.
  static constexpr const char* FIELDS = "";
  template <class T> struct Memory {};

  template <class T> static INLINE void begin(T, T, Memory<T>&) {}

  // Centimetres of forward progress.
  template <class T> static INLINE T reward(T, T, T moved, double, double, Memory<T>&) { return 100.0 * moved; }

  template <class T, class Put> static INLINE void observe(const Memory<T>&, Put) {}
};
}  // namespace LEVEL
