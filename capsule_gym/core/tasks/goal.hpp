// The task to move to a goal and to rest there, as soon as possible.
#pragma once
#include "../elementary.hpp"

namespace LEVEL {

// Bound of the observed error, m; largest distance from the goal at which the platform must rest, m; and duration of the
// rest, s.
constexpr double ERROR_BOUND = 1.0, TOLERANCE = 0.002, HOLD = 1.0;
// Tolerance of times, s, which are sums of the agent's steps.
constexpr double TIME_TOLERANCE = 1e-9;

struct Goal {
  static constexpr const char* NAME = "goal";
  // Position of the goal, and that minus the platform's, m; times since the start, at rest within the tolerance, and at
  // which the goal was reached (0 before), s; the drawn displacement of the goal, m.
#define GOAL_MEMORY(FIELD) FIELD(goal) FIELD(error) FIELD(time) FIELD(held) FIELD(reached) FIELD(displacement)
  static constexpr const char* FIELDS = GOAL_MEMORY(CAPSULE_NAME);
  template <class T> struct Memory {
    GOAL_MEMORY(CAPSULE_NUMBER)
  };
  static constexpr int ROWS = WIDTH<Memory<double>>, ENTRIES = 3;

  // Places the goal at the drawn displacement from the platform.
  template <class T> static INLINE void begin(T x, Memory<T>& memory) {
    T displacement = memory.displacement;
    memory = {x + displacement, displacement, 0.0, 0.0, 0.0, displacement};
  }

  // The reward for the distance to the goal and for rest there.
  template <class T> static INLINE T reward(T x, T x_dot, T moved, double dt, Memory<T>& memory) {
    auto& [goal, error, time, held, reached, displacement] = memory;
    time = time + dt;
    error = goal - x;
    T size = abs(error);
    T still = select(x_dot == 0.0, T(1.0), T(0.0)), inside = select(size <= TOLERANCE, T(1.0), T(0.0));
    T rate = 0.5 * decay(size / 0.1) + 0.5 * decay(size / 0.02);
    rate = rate + (decay(size / 0.004) * (1.0 + still) + 2.0 * inside * still - size / 0.5);
    // In stick for the whole step.
    held = select((inside * still > 0.0) & (moved == 0.0), held + dt, T(0.0));
    reached = select((reached == 0.0) & (held >= HOLD - TIME_TOLERANCE), time, reached);
    return dt * rate;
  }

  static INLINE void observe(float* out, const Memory<double>& memory) {
    out[0] = (float)clip(memory.error, ERROR_BOUND);
    out[1] = (float)tanh(memory.error / 0.02);
    out[2] = (float)min(memory.held, HOLD);
  }
};

}  // namespace LEVEL
