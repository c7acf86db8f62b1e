// The tasks. A task is a struct with the names of its memory, and functions for the start of an episode, the reward at the
// end of an agent step, and its entries of the observation. The memory's last fields are the numbers that an episode
// draws.
#pragma once
#include "tasks/goal.hpp"
#include "tasks/speed.hpp"
#include "tasks/velocity.hpp"

#define CAPSULE_TASKS(TASK) TASK(Speed) TASK(Goal) TASK(Velocity)
