// The task `speed`: forwards as fast as possible.
#pragma once
#include "task.hpp"

namespace LEVEL {
struct Speed {
  static constexpr const char* NAME = "speed";
  // It has no memory, draws nothing, and adds neither entries to the observation nor metrics.
  static constexpr const char *FIELDS = "", *SHOWN = "", *TERM = "reward_progress";
  static constexpr int STEPS = 1650;
  template <class T> struct Memory {};

  template <class Put> static void draws(Range, Put) {}

  template <class T> static INLINE void begin(T, T, Memory<T>&) {}

  // Centimetres of forward progress.
  template <class T> static INLINE T reward(T, T, T moved, double, double, Memory<T>&) {
    return 100.0 * moved;
  }

  template <class T, class Put> static INLINE void observe(const Memory<T>&, Put) {}

  template <class Put> static void metrics(const Memory<double>&, double, Put) {}
};
}  // namespace LEVEL
