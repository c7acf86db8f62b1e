// The tasks. A task is a struct with the names of its memory, and functions for the start of an episode, the reward at
// the end of an agent step, and its entries of the observation. The memory's last fields are the numbers that an
// episode draws. The start takes x, true and as the memory observes it; the reward takes x, x_dot, the displacement in
// the step, the step, and the largest |x_dot| at rest.
#pragma once
#include "numbers/elementary.hpp"

namespace LEVEL {
constexpr double TIME_TOLERANCE = 1e-9;  // tolerance of times, s, which are sums of the agent's steps

// Forwards as fast as possible.
struct Speed {
  static constexpr const char* NAME = "speed";
  // It has no memory and adds no entries to the observation.
  static constexpr const char* FIELDS = "";
  template <class T> struct Memory {};

  template <class T> static INLINE void begin(T, T, Memory<T>&) {}

  // Centimetres of forward progress.
  template <class T> static INLINE T reward(T, T, T moved, double, double, Memory<T>&) { return 100.0 * moved; }

  template <class T, class Put> static INLINE void observe(const Memory<T>&, Put) {}
};

// Bound of the observed error, m; largest distance from the goal at which the platform must rest, m; and duration of
// the rest, s.
constexpr double ERROR_BOUND = 1.0, TOLERANCE = 0.002, HOLD = 1.0;

// To move to a goal and to rest there, as soon as possible.
struct Goal {
  static constexpr const char* NAME = "goal";
  // Position of the goal, and that minus the platform's, m; times since the start, at rest within the tolerance, and at
  // which the goal was reached (0 before), s; the drawn displacement of the goal, m.
#define GOAL_MEMORY(FIELD) FIELD(goal) FIELD(error) FIELD(time) FIELD(held) FIELD(reached) FIELD(displacement)
  static constexpr const char* FIELDS = GOAL_MEMORY(CAPSULE_NAME);
  template <class T> struct Memory { GOAL_MEMORY(CAPSULE_NUMBER) };

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
  template <class T> static INLINE T reward(T x, T x_dot, T moved, double dt, double rest, Memory<T>& memory) {
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
    put(clip(memory.error, T(ERROR_BOUND)));
    put(tanh(memory.error / 0.02));
    put(min(memory.held, T(HOLD)));
  }
};

// Largest distance of the target, m; time constant of the observed velocity, s, and its bound, m/s.
constexpr double LEAD = 0.3, FILTER = 0.25, SPEED_BOUND = 2.0;
// Time that the metrics leave out after a change, and the shortest measured time of a command that counts, s; distance
// from the target within which a command is settled, m.
constexpr double SETTLING = 1.5, MEASURED = 1.0, SETTLED = 0.02;
constexpr int COMMANDS = 8;

// To follow a commanded mean velocity, which changes during the episode.
struct Velocity {
  static constexpr const char* NAME = "velocity";
  // The command, m/s; position of the target, and that minus the platform's, m; filtered velocity, m/s; time since the
  // change of the command, and its duration, s. Of the present command: time and position at the start of its
  // measurement, and 1.0 once settled. Sums over the previous commands: missed and commanded distance, m, number of
  // measured and of unsettled commands. The present and the next commands, and their durations.
#define VELOCITY_MEMORY(FIELD)                                                                                         \
  FIELD(command) FIELD(target) FIELD(error) FIELD(speed) FIELD(since) FIELD(lasts)                                     \
  FIELD(measured_from) FIELD(measured_x) FIELD(settled) FIELD(missed) FIELD(commanded) FIELD(measured)                 \
  FIELD(unsettled)
  static constexpr const char* FIELDS = VELOCITY_MEMORY(CAPSULE_NAME)
      "v_0 v_1 v_2 v_3 v_4 v_5 v_6 v_7 lasts_0 lasts_1 lasts_2 lasts_3 lasts_4 lasts_5 lasts_6 lasts_7";
  template <class T> struct Memory {
    VELOCITY_MEMORY(CAPSULE_NUMBER)
    T v[COMMANDS], lasts_for[COMMANDS];
  };

  // Sets the first command, with the target at the platform.
  template <class T> static INLINE void begin(T, T observed_x, Memory<T>& m) {
    m.command = m.v[0], m.target = observed_x, m.lasts = m.lasts_for[0];
    m.error = m.speed = m.since = m.measured_from = m.measured_x = m.settled = 0.0;
    m.missed = m.commanded = m.measured = m.unsettled = 0.0;
  }

  // The reward for the distance to the target; moves the target, and changes the command when that is due.
  template <class T> static INLINE T reward(T x, T, T moved, double dt, double, Memory<T>& m) {
    m.target = x + clip(m.target + m.command * dt - x, T(LEAD));
    m.error = m.target - x;
    T size = abs(m.error);
    T gain = dt * (exp(-size / 0.02) + 0.5 * exp(-size / 0.1) - 0.5 * size);
    m.speed = m.speed + (moved / dt - m.speed) * (dt / (FILTER + dt));
    m.since = m.since + dt;
    auto measures = m.since >= SETTLING - TIME_TOLERANCE;
    auto begins = measures & (m.measured_from == 0.0);
    m.measured_from = select(begins, m.since, m.measured_from);
    m.measured_x = select(begins, x, m.measured_x);
    m.settled = select(measures & (size <= SETTLED), T(1.0), m.settled);
    auto ends = m.since >= m.lasts - TIME_TOLERANCE;
    T duration = m.since - m.measured_from;
    auto counts = ends & (m.measured_from > 0.0) & (duration >= MEASURED - TIME_TOLERANCE);
    m.missed = m.missed + select(counts, abs(x - m.measured_x - m.command * duration), T(0.0));
    m.commanded = m.commanded + select(counts, abs(m.command) * duration, T(0.0));
    m.measured = m.measured + select(counts, T(1.0), T(0.0));
    m.unsettled = m.unsettled + select(counts, 1.0 - m.settled, T(0.0));
    // The last command stays.
    for (int i = 0; i < COMMANDS; i++) {
      bool last = i == COMMANDS - 1;
      m.v[i] = select(ends, m.v[last ? i : i + 1], m.v[i]);
      m.lasts_for[i] = select(ends, last ? T(INFINITE) : m.lasts_for[i + 1], m.lasts_for[i]);
    }
    m.command = select(ends, m.v[0], m.command), m.lasts = select(ends, m.lasts_for[0], m.lasts);
    m.target = select(ends, x, m.target);
    m.error = select(ends, T(0.0), m.error), m.since = select(ends, T(0.0), m.since);
    m.measured_from = select(ends, T(0.0), m.measured_from), m.measured_x = select(ends, T(0.0), m.measured_x);
    m.settled = select(ends, T(0.0), m.settled);
    return gain;
  }

  template <class T, class Put> static INLINE void observe(const Memory<T>& memory, Put put) {
    put(memory.command);
    put(tanh(memory.error / 0.05));
    put(tanh(memory.error / 0.2));
    put(clip(memory.speed, T(SPEED_BOUND)));
  }
};

using Tasks = List<Speed, Goal, Velocity>;
}  // namespace LEVEL
