// The tasks. A task is a struct with the names of its memory, and functions for the start of an episode, the reward at
// the end of an agent step, and its entries of the observation. The memory's last fields are the numbers that an
// episode draws. The start takes x, true and as the memory observes it; the reward takes x, x_dot, the displacement in
// the step, the step, and the largest |x_dot| at rest.
#pragma once
#include "goal.hpp"
#include "speed.hpp"
#include "velocity.hpp"

namespace LEVEL {
using Tasks = List<Speed, Goal, Velocity>;
}  // namespace LEVEL
