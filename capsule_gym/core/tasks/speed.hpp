// The speed task: forwards as fast as possible.
#pragma once
#include "../elementary.hpp"

namespace LEVEL {

struct Speed {
  static constexpr const char* NAME = "speed";
  // It has no memory and adds no entries to the observation.
  static constexpr const char* FIELDS = "";
  static constexpr int ROWS = 0, ENTRIES = 0;
  template <class T> struct Memory {};

  template <class T> static INLINE void begin(T, Memory<T>&) {}

  // Centimetres of forward progress.
  template <class T> static INLINE T reward(T, T, T moved, double, Memory<T>&) { return 100.0 * moved; }

  static INLINE void observe(float*, const Memory<double>&) {}
};

}  // namespace LEVEL
