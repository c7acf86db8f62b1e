// What the tasks share.
#pragma once
#include "../numbers/elementary.hpp"

namespace LEVEL {
// Tolerance of times, s, which are sums of the agent's steps.
constexpr double TIME_TOLERANCE = 1e-9;

// The ends of a range; NaN where it is not given.
struct Range {
  double low, high;
};

// Distributions of a drawn number.
constexpr double UNIFORM = 0.0;      // in [low, low + range]
constexpr double SIGNED = 1.0;       // the same with a random sign
constexpr double CENTRED = 2.0;      // uniform within range of low
constexpr double LOGARITHMIC = 3.0;  // low e^z with z uniform in [0, range]
}  // namespace LEVEL
