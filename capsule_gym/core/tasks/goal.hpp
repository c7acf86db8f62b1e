// The task `goal`: to move to a goal and to rest there, as soon as possible.
#pragma once
#include "task.hpp"

namespace LEVEL {
constexpr double ERROR_BOUND = 1.0;  // of the observed error, m
// The platform must rest within the tolerance for a while.
constexpr double TOLERANCE = 0.002;  // m
constexpr double HOLD = 1.0;         // s

struct Goal {
  static constexpr const char* NAME = "goal";
#define GOAL_MEMORY(FIELD)                                                  \
  FIELD(goal)         /* its position, m */                                 \
  FIELD(error)        /* that minus the platform's, m */                    \
  FIELD(time)         /* since the start, s */                              \
  FIELD(held)         /* time at rest within the tolerance, s */            \
  FIELD(reached)      /* time at which the goal was reached, s; 0 before */ \
  FIELD(displacement) /* of the goal, as drawn, m */
  static constexpr const char* FIELDS = GOAL_MEMORY(CAPSULE_NAME);
  static constexpr const char* SHOWN = "goal error held ";
  static constexpr const char* TERM = "reward_goal";
  static constexpr int STEPS = 750;
  template <class T> struct Memory {
    GOAL_MEMORY(CAPSULE_NUMBER)
  };

  // The displacement, m.
  static void draws(Range, auto put) { put("goal", 0.05, 0.5, SIGNED); }

  // Places the goal at the drawn displacement from the platform.
  template <class T> static INLINE void begin(T x, T observed_x, Memory<T>& memory) {
    T displacement = memory.displacement;
    memory = {x + displacement, displacement + (x - observed_x), 0.0, 0.0, 0.0, displacement};
  }

  // The reward per second for an error and, 1.0 or 0.0, rest.
  template <class T> static INLINE T rate(T error, T still) {
    T size = abs(error);
    T inside = select(size <= TOLERANCE, T(1.0), T(0.0));
    T approach = 0.5 * decay(size / 0.1) + 0.5 * decay(size / 0.02);
    T arrival = decay(size / 0.004) * (1.0 + still);
    return approach + (arrival + 2.0 * inside * still - size / 0.5);
  }

  // The reward for the distance to the goal and for rest there.
  template <class T>
  static INLINE T reward(T x, T x_dot, T moved, double dt, double rest, Memory<T>& memory) {
    auto& [goal, error, time, held, reached, displacement] = memory;
    time = time + dt;
    error = goal - x;
    auto still = abs(x_dot) <= rest;
    // In stick for the whole step. The noise of a measured position would hide it.
    auto sticks = (moved == 0.0) | (T(rest) > 0.0);
    auto holds = still & (abs(error) <= TOLERANCE) & sticks;
    held = select(holds, held + dt, T(0.0));
    reached = select((reached == 0.0) & (held >= HOLD - TIME_TOLERANCE), time, reached);
    return dt * rate(error, select(still, T(1.0), T(0.0)));
  }

  template <class T> static INLINE void observe(const Memory<T>& memory, auto put) {
    put("goal_error", -ERROR_BOUND, ERROR_BOUND, clip(memory.error, T(ERROR_BOUND)));
    put("near_goal_error", -1.0, 1.0, tanh(memory.error / 0.02));
    put("held", 0.0, HOLD, min(memory.held, T(HOLD)));
  }

  static void metrics(const Memory<double>& memory, double whole, auto put) {
    bool success = memory.reached > 0.0;
    put("success", "1 if the goal was reached, else 0", success ? 1.0 : 0.0);
    put("goal_time", "time to the goal, or without success the length of a whole episode, s",
        success ? memory.reached : whole);
  }
};
}  // namespace LEVEL
