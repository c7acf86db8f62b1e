// The task `speed`: forwards as fast as possible.
#pragma once
#include "task.hpp"

namespace LEVEL {
struct Speed {
  static constexpr const char* NAME = "speed";
  // It has no memory, draws nothing, and adds neither entries to the observation nor metrics.
  static constexpr const char* FIELDS = "";
  static constexpr const char* SHOWN = "";
  static constexpr const char* TERM = "reward_progress";
  static constexpr int STEPS = 1650;
  template <class T> struct Memory {};

  static void draws(Range, auto) {}

  template <class T> static INLINE void begin(T, T, Memory<T>&) {}

  // Centimetres of forward progress.
  template <class T> static INLINE T reward(T, T, T moved, double, double, Memory<T>&) {
    return 100.0 * moved;
  }

  template <class T> static INLINE void observe(const Memory<T>&, auto) {}

  static void metrics(const Memory<double>&, double, auto) {}
};
}  // namespace LEVEL
