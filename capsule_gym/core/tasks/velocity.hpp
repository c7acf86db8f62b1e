// The task `velocity`: to follow a commanded mean velocity, which changes during the episode.
#pragma once
#include "task.hpp"

namespace LEVEL {
constexpr double LEAD = 0.3;         // largest distance of the target, m
constexpr double FILTER = 0.25;      // time constant of the observed velocity, s
constexpr double SPEED_BOUND = 2.0;  // of the observed velocity, m/s
// The metrics leave out the time after a change, and commands that are measured too shortly.
constexpr double SETTLING = 1.5;  // s
constexpr double MEASURED = 1.0;  // s
constexpr double SETTLED = 0.02;  // distance from the target within which a command is settled, m
constexpr int COMMANDS = 8;
constexpr double LARGEST_COMMAND = 0.2;   // accepted, m/s
constexpr double DRAWN_COMMAND = 0.1;     // largest drawn, m/s
constexpr double SHORTEST_COMMAND = 4.0;  // drawn, s
constexpr double LONGEST_COMMAND = 8.0;   // drawn, s

struct Velocity {
  static constexpr const char* NAME = "velocity";
#define VELOCITY_MEMORY(FIELD)                                       \
  FIELD(command) /* m/s */                                           \
  FIELD(target)  /* its position, m */                               \
  FIELD(error)   /* that minus the platform's, m */                  \
  FIELD(speed)   /* filtered velocity, m/s */                        \
  FIELD(since)   /* time since the change of the command, s */       \
  FIELD(lasts)   /* duration of the command, s */                    \
  /* Of the present command. */                                      \
  FIELD(measured_from) /* time at the start of its measurement, s */ \
  FIELD(measured_x)    /* position there, m */                       \
  FIELD(settled)       /* 1.0 once settled */                        \
  /* Sums over the previous commands. */                             \
  FIELD(missed)    /* distance, m */                                 \
  FIELD(commanded) /* distance, m */                                 \
  FIELD(measured)  /* number of measured commands */                 \
  FIELD(unsettled) /* number of unsettled commands */
  static constexpr const char* FIELDS = VELOCITY_MEMORY(CAPSULE_NAME)
      "v_0 v_1 v_2 v_3 v_4 v_5 v_6 v_7 "
      "lasts_0 lasts_1 lasts_2 lasts_3 lasts_4 lasts_5 lasts_6 lasts_7";
  static constexpr const char* SHOWN = "command target error ";
  static constexpr const char* TERM = "reward_tracking";
  static constexpr int STEPS = 1000;
  template <class T> struct Memory {
    VELOCITY_MEMORY(CAPSULE_NUMBER)
    // The present and the next commands, and their durations.
    T v[COMMANDS];
    T lasts_for[COMMANDS];
  };

  // The velocities, and how long each lasts.
  static void draws(Range given, auto put) {
    Range velocities = given.low == given.low ? given : Range{-DRAWN_COMMAND, DRAWN_COMMAND};
    for (int i = 0; i < COMMANDS; i++) put("commands", velocities.low, velocities.high, UNIFORM);
    for (int i = 0; i < COMMANDS; i++) put("commands", SHORTEST_COMMAND, LONGEST_COMMAND, UNIFORM);
  }

  // Sets the first command, with the target at the platform.
  template <class T> static INLINE void begin(T, T observed_x, Memory<T>& m) {
    m.command = m.v[0];
    m.target = observed_x;
    m.error = 0.0;
    m.speed = 0.0;
    m.since = 0.0;
    m.lasts = m.lasts_for[0];
    m.measured_from = 0.0;
    m.measured_x = 0.0;
    m.settled = 0.0;
    m.missed = 0.0;
    m.commanded = 0.0;
    m.measured = 0.0;
    m.unsettled = 0.0;
  }

  // The reward for the distance to the target; moves the target, and changes the command when that
  // is due.
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
    add_command(x, ends, m);
    change_command(x, ends, m);
    return gain;
  }

  // Adds the present command to the sums where it ends and was measured for long enough.
  template <class T> static INLINE void add_command(T x, auto ends, Memory<T>& m) {
    T duration = m.since - m.measured_from;
    auto long_enough = duration >= MEASURED - TIME_TOLERANCE;
    auto counts = ends & (m.measured_from > 0.0) & long_enough;
    T missed = abs(x - m.measured_x - m.command * duration);
    m.missed = m.missed + select(counts, missed, T(0.0));
    m.commanded = m.commanded + select(counts, abs(m.command) * duration, T(0.0));
    m.measured = m.measured + select(counts, T(1.0), T(0.0));
    m.unsettled = m.unsettled + select(counts, 1.0 - m.settled, T(0.0));
  }

  // Replaces the command by the next one where it ends, with the target at the platform.
  template <class T> static INLINE void change_command(T x, auto ends, Memory<T>& m) {
    constexpr int LAST = COMMANDS - 1;
    for (int i = 0; i < LAST; i++) {
      m.v[i] = select(ends, m.v[i + 1], m.v[i]);
      m.lasts_for[i] = select(ends, m.lasts_for[i + 1], m.lasts_for[i]);
    }
    // The last command stays.
    m.lasts_for[LAST] = select(ends, T(INFINITE), m.lasts_for[LAST]);
    m.command = select(ends, m.v[0], m.command);
    m.lasts = select(ends, m.lasts_for[0], m.lasts);
    m.target = select(ends, x, m.target);
    m.error = select(ends, T(0.0), m.error);
    m.since = select(ends, T(0.0), m.since);
    m.measured_from = select(ends, T(0.0), m.measured_from);
    m.measured_x = select(ends, T(0.0), m.measured_x);
    m.settled = select(ends, T(0.0), m.settled);
  }

  template <class T> static INLINE void observe(const Memory<T>& memory, auto put) {
    put("command", -LARGEST_COMMAND, LARGEST_COMMAND, memory.command);
    put("near_error", -1.0, 1.0, tanh(memory.error / 0.05));
    put("far_error", -1.0, 1.0, tanh(memory.error / 0.2));
    put("mean_x_dot", -SPEED_BOUND, SPEED_BOUND, clip(memory.speed, T(SPEED_BOUND)));
  }

  // The sums over the previous commands, with the present one where it has been measured for long
  // enough.
  static void metrics(const Memory<double>& m, double, auto put) {
    double duration = m.measured_from > 0.0 ? m.since - m.measured_from : 0.0;
    bool counts = duration >= MEASURED - TIME_TOLERANCE;
    double moved = m.target - m.error - m.measured_x;
    double missed = m.missed + (counts ? abs(moved - m.command * duration) : 0.0);
    double commanded = m.commanded + (counts ? abs(m.command) * duration : 0.0);
    double measured = m.measured + (counts ? 1.0 : 0.0);
    double unsettled = m.unsettled + (counts ? 1.0 - m.settled : 0.0);
    double error = commanded > 0.0 ? missed / commanded : 1.0;
    put("velocity_error",
        "error of the mean velocity, percent of the commands; 100 without a measured command",
        100.0 * error);
    put("unsettled",
        "share of the measured commands that were never settled; 1 without a measured command",
        measured > 0.0 ? unsettled / measured : 1.0);
  }
};
}  // namespace LEVEL
