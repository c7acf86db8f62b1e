// The task `goal`: to move to a goal and to rest there, as soon as possible.
#pragma once
#include "task.hpp"

namespace LEVEL {
// Bound of the observed error, m; largest distance from the goal at which the platform must rest,
// m; and duration of the rest, s.
constexpr double ERROR_BOUND = 1.0, TOLERANCE = 0.002, HOLD = 1.0;

struct Goal {
  static constexpr const char* NAME = "goal";
  // Position of the goal, and that minus the platform's, m; times since the start, at rest within
  // the tolerance, and at which the goal was reached (0 before), s; the drawn displacement of the
  // goal, m.
#define GOAL_MEMORY(FIELD) \
  FIELD(goal) FIELD(error) FIELD(time) FIELD(held) FIELD(reached) FIELD(displacement)
  static constexpr const char *FIELDS = GOAL_MEMORY(CAPSULE_NAME), *SHOWN = "goal error held ",
                              *TERM = "reward_goal";
  static constexpr int STEPS = 750;
  template <class T> struct Memory {
    GOAL_MEMORY(CAPSULE_NUMBER)
  };

  // The displacement, m.
  template <class Put> static void draws(Range, Put put) { put("goal", 0.05, 0.5, SIGNED); }

  // Places the goal at the drawn displacement from the platform.
  template <class T> static INLINE void begin(T x, T observed_x, Memory<T>& memory) {
    T displacement = memory.displacement;
    memory = {x + displacement, displacement + (x - observed_x), 0.0, 0.0, 0.0, displacement};
  }

  // The reward per second for an error and, 1.0 or 0.0, rest.
  template <class T> static INLINE T rate(T error, T still) {
    T size = abs(error), inside = select(size <= TOLERANCE, T(1.0), T(0.0));
    T rate = 0.5 * decay(size / 0.1) + 0.5 * decay(size / 0.02);
    return rate + (decay(size / 0.004) * (1.0 + still) + 2.0 * inside * still - size / 0.5);
  }

  // The reward for the distance to the goal and for rest there.
  template <class T>
  static INLINE T reward(T x, T x_dot, T moved, double dt, double rest, Memory<T>& memory) {
    auto& [goal, error, time, held, reached, displacement] = memory;
    time = time + dt;
    error = goal - x;
    auto still = abs(x_dot) <= rest;
    // In stick for the whole step. The noise of a measured position would hide it.
    auto holds = still & (abs(error) <= TOLERANCE) & ((moved == 0.0) | (T(rest) > 0.0));
    held = select(holds, held + dt, T(0.0));
    reached = select((reached == 0.0) & (held >= HOLD - TIME_TOLERANCE), time, reached);
    return dt * rate(error, select(still, T(1.0), T(0.0)));
  }

  template <class T, class Put> static INLINE void observe(const Memory<T>& memory, Put put) {
    put("goal_error", -ERROR_BOUND, ERROR_BOUND, clip(memory.error, T(ERROR_BOUND)));
    put("near_goal_error", -1.0, 1.0, tanh(memory.error / 0.02));
    put("held", 0.0, HOLD, min(memory.held, T(HOLD)));
  }

  template <class Put> static void metrics(const Memory<double>& memory, double whole, Put put) {
    bool success = memory.reached > 0.0;
    put("success", "1 if the goal was reached, else 0", success ? 1.0 : 0.0);
    put("goal_time", "time to the goal, or without success the length of a whole episode, s",
        success ? memory.reached : whole);
  }
};
}  // namespace LEVEL
