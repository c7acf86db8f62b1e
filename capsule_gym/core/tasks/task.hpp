// What the tasks share.
#pragma once
#include "../numbers/elementary.hpp"

namespace LEVEL {
constexpr double TIME_TOLERANCE =
    1e-9;  // tolerance of times, s, which are sums of the agent's steps

// The ends of a range; NaN where it is not given.
struct Range {
  double low, high;
};

// Distributions of a drawn number: uniform in [low, low + range]; the same with a random sign;
// uniform within range of low; or low e^z with z uniform in [0, range].
constexpr double UNIFORM = 0.0, SIGNED = 1.0, CENTRED = 2.0, LOGARITHMIC = 3.0;
}  // namespace LEVEL
