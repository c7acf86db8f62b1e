// What the tasks share.
#pragma once
#include "../numbers/elementary.hpp"

namespace LEVEL {
constexpr double TIME_TOLERANCE = 1e-9;  // tolerance of times, s, which are sums of the agent's steps
}  // namespace LEVEL
