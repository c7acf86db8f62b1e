// The tasks. A task is a struct with
//
// - the names of itself, of the fields of its memory, of those that `info` shows, and of its term
//   of the reward; the agent steps of a whole episode;
// - `draws`: the numbers that an episode draws, the last fields of the memory, each with the name
//   of its reset option; the given range may replace that of the task;
// - `begin`: the start of an episode, from x, true and as the memory observes it;
// - `reward`: at the end of an agent step, from x, x_dot, the displacement in the step, the step,
//   and the largest |x_dot| at rest;
// - `observe`: its entries of the observation, each with its name and bounds;
// - `metrics`: those of an episode besides the metrics of all tasks, from the memory and the length
//   of a whole episode, s.
#pragma once
#include "goal.hpp"
#include "speed.hpp"
#include "velocity.hpp"

namespace LEVEL {
using Tasks = List<Speed, Goal, Velocity>;
}  // namespace LEVEL
