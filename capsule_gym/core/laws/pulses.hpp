// Laws for the tasks `goal` and `velocity`: a gait towards the goal, then pulses whose size adapts
// to the floor, or strokes on smooth floors. They read the positions of the goal and of the
// platform.
#pragma once
#include "../tasks/goal.hpp"
#include "../tasks/velocity.hpp"
#include "gait.hpp"
#include "strokes.hpp"

namespace LEVEL {
// The gait's parameters, the nominal pendulum, and the law's period.
#define PULSES_CONSTANTS(ONE, MANY) \
  GAIT_CONSTANTS(ONE, MANY)         \
  ONE(m)                            \
  ONE(l)                            \
  ONE(g)                            \
  ONE(k)                            \
  ONE(c)                            \
  ONE(dt)

// Far from the goal the torque is the gait's, mirrored if the goal lies behind the platform. Near
// the goal the law repeats three phases: it returns the pendulum to the start of a pulse, slowly
// enough for the platform to stick; it accelerates the pendulum with full torque to the rate w that
// should move the platform by the error; and it brakes the pendulum slowly. A pulse moves the
// platform by about gain w^2 / mu; every pulse corrects the gain. M and mu, which limit the
// acceleration in stick, are estimated online. The numbers were chosen by hand on 300 plants of the
// tasks' own distribution.
namespace pulses {
// Phases.
constexpr double RUN = 0.0;
constexpr double RETURN = 1.0;
constexpr double PULSE = 2.0;
constexpr double BRAKE = 3.0;

// A run starts with the pendulum well behind the platform and slow. It ends before the goal by a
// share of the sliding distance, or, on the roughest floors, in an equilibrium.
constexpr double FAR = 0.05;         // distance from the goal beyond which the platform runs, m
constexpr double RUN_ANGLE = -0.5;   // largest angle at the start, rad
constexpr double RUN_RATE = 3.0;     // largest rate at the start, rad/s
constexpr double SLIDE = 0.15;       // share of the sliding distance x'^2 / (2 mu g)
constexpr double STALL_RATE = 1e-3;  // rate in an equilibrium, rad/s
// While the platform must stick, the pendulum uses a share of the friction.
constexpr double FRICTION_SHARE = 0.9;
constexpr double LEAST_GRIP = 0.5;  // bounds of its acceleration, rad/s^2
constexpr double LARGEST_GRIP = 80.0;
constexpr double RUN_GRIP = 40.0;  // before a run the platform may move, rad/s^2
// The estimate of mu is used when it is certain enough, and clipped.
constexpr double UNKNOWN_MU = 0.15;    // mu until then
constexpr double LARGEST_DOUBT = 0.5;  // standard deviation of log(mu)
constexpr double LEAST_MU = 0.01;
constexpr double LARGEST_MU = 0.7;
// A pulse corrects a share of the gain's error, within factors.
constexpr double LEARNING = 0.4;
constexpr double LEAST_FACTOR = 0.6;
constexpr double LARGEST_FACTOR = 3.0;
// The rate w that a pulse reaches, rad/s, and the acceleration of its torque, rad/s^2.
constexpr double LEAST_RATE = 0.6;
constexpr double LARGEST_RATE = 9.0;
constexpr double PULSE_ACCELERATION = 240.0;
// Angles, rad, positive in the direction of the pulse. A pulse starts at -HOME, on rough floors
// nearer to the upright, where full torque moves the platform.
constexpr double HOME = 0.9;
constexpr double LEAST_HOME = 0.2;
constexpr double ROUGH_MU = 0.1;   // above it, home is nearer
constexpr double ROUGHNESS = 2.2;  // rad per mu
constexpr double EARLIEST = 0.1;   // a pulse starts at most this before home,
constexpr double START_END = 0.3;  // and below this angle
constexpr double AT_HOME = 0.1;    // this near to home it starts even if it will be too fast
constexpr double PULSE_END = 0.8;  // largest angle of a pulse
constexpr double BRAKED = 0.9;     // the pendulum should stop before
// A pulse starts from a rate below START_RATE + START_SHARE w, rad/s.
constexpr double START_RATE = 0.5;
constexpr double START_SHARE = 0.1;
// The brake has ended when the platform rests, after a while, and the pendulum is slow.
constexpr double BRAKE_TIME = 0.005;  // s
constexpr double BRAKED_RATE = 2.0;   // rad/s
constexpr double BRAKING = 20.0;      // deceleration per rate, 1/s
// A return to an angle: a parabola, near its end a line.
constexpr double RETURN_SHARE = 1.6;  // twice the share of the grip that decelerates
constexpr double RETURN_RATE = 8.0;   // rate per angle, 1/s
constexpr double RETURN_GAIN = 40.0;  // acceleration per error of the rate, 1/s

// The memory: what the law knows of the present or last pulse.
template <class T> struct Memory {
  Estimator<T> estimator;
  T phase;
  T side;     // direction: 1.0 or -1.0
  T rate;     // w, rad/s
  T start_x;  // m
  T gain;     // m s^2
  T timer;    // time since the pulse has ended, s
};

// The acceleration, rad/s^2, that takes the pendulum to an angle and stops it there, within +-grip.
template <class T> inline T approach(T theta, T theta_dot, T aim, T grip) {
  T way = aim - theta;
  T rate = min(sqrt(RETURN_SHARE * grip * abs(way)), RETURN_RATE * abs(way));
  return clip(RETURN_GAIN * (select(way > 0.0, rate, -rate) - theta_dot), grip);
}

// The friction coefficient that the law relies on.
template <class T> INLINE T trusted_friction(const Estimator<T>& estimator) {
  T mu = min(T(LARGEST_MU), max(T(LEAST_MU), exp(estimator.log_mu)));
  return select(deviation(estimator.P_ff) > LARGEST_DOUBT, T(UNKNOWN_MU), mu);
}

// Ends a run that stalls, or whose platform slides to less than `stop` before the goal.
template <class T>
INLINE void end_run(const State<T>& s, Memory<T>& memory, T mu, T error, double stop,
                    const auto& law) {
  T sliding = SLIDE * s.x_dot * s.x_dot / (2.0 * mu * law.g);
  T slide = select(s.x_dot * memory.side > 0.0, sliding, T(0.0));
  auto slow = abs(s.theta_dot) < STALL_RATE;
  auto ahead = memory.side * s.theta > 0.0;
  auto stalls = (s.x_dot == 0.0) & slow & ahead;
  auto arrives = error * memory.side < stop + slide;
  if (auto taken = when(stalls | arrives)) {
    memory.phase = BRAKE;
    memory.timer = 0.0;
    memory.rate = 0.0;
  }
}

// Corrects the gain by the displacement of the pulse that has ended; after a run there was none.
template <class T> INLINE void learn_gain(T x, T mu, Memory<T>& memory) {
  auto& gain = memory.gain;
  if (auto taken = when(memory.rate > 0.0)) {
    T moved = max(T(0.0), memory.side * (x - memory.start_x));
    T observed = moved * mu / (memory.rate * memory.rate);
    T learned = gain + LEARNING * (observed - gain);
    gain = max(LEAST_FACTOR * gain, min(LARGEST_FACTOR * gain, learned));
  }
}

// Where the pendulum returns to, rad, and its largest acceleration, rad/s^2.
template <class T> struct Return {
  T home, grip;
};

// Plans the next pulse towards a goal that lies `error` metres ahead; starts it, or a run, when the
// pendulum is there.
template <class T>
INLINE Return<T> aim(const State<T>& s, Memory<T>& memory, T mu, T error, T grip) {
  auto& [estimator, phase, side, rate, start_x, gain, timer] = memory;
  auto far = abs(error) > FAR;
  side = select(error > 0.0, T(1.0), T(-1.0));
  rate = min(T(LARGEST_RATE), max(T(LEAST_RATE), sqrt(abs(error) * mu / gain)));
  T nearer = select(far, T(0.0), ROUGHNESS * (mu - ROUGH_MU));
  T home = -side * min(T(HOME), max(T(LEAST_HOME), HOME - nearer));
  // The fastest pulse from here after which the pendulum stops in time.
  T braking_angle = BRAKED - side * s.theta - rate * rate / PULSE_ACCELERATION;
  T fastest = sqrt(2.0 * grip * max(T(0.0), braking_angle));

  auto behind = side * s.theta < RUN_ANGLE;
  auto slow_for_run = abs(s.theta_dot) < RUN_RATE;
  phase = select(far & behind & slow_for_run, T(RUN), phase);

  auto slow = abs(s.theta_dot) < START_RATE + START_SHARE * rate;
  auto not_early = -EARLIEST < side * (s.theta - home);
  auto not_late = side * s.theta < START_END;
  auto stops_in_time = rate <= fastest;
  auto at_home = abs(s.theta - home) < AT_HOME;
  auto starts = slow & not_early & not_late & (stops_in_time | at_home) & !far;
  if (auto taken = when(starts)) {
    phase = PULSE;
    rate = max(T(LEAST_RATE), min(rate, fastest));
    start_x = s.x;
  }
  return {home, select(far, max(grip, T(RUN_GRIP)), grip)};
}

// The torque for a goal that lies `error` metres ahead; an error up to `near` is not corrected, at
// `stop` a run ends.
template <class T>
T torque(const State<T>& s, Memory<T>& memory, T error, double near, double stop, const auto& law) {
  auto& [estimator, phase, side, rate, start_x, gain, timer] = memory;
  const auto& [theta, theta_dot, x, x_dot] = s;
  update_estimator(estimator, theta, theta_dot, x_dot, law);
  T mu = trusted_friction(estimator);
  T friction = FRICTION_SHARE * mu * (estimator.M + law.m) * law.g;
  T grip = min(T(LARGEST_GRIP), max(T(LEAST_GRIP), friction / (law.m * law.l)));
  timer = timer + law.dt;
  auto rests = x_dot == 0.0;
  auto braked = (phase == BRAKE) & rests & (abs(theta_dot) < BRAKED_RATE) & (timer > BRAKE_TIME);
  if (auto taken = when(phase == RUN)) end_run(s, memory, mu, error, stop, law);
  if (auto taken = when(braked)) {
    learn_gain(x, mu, memory);
    phase = RETURN;
  }
  auto may_move = rests | (abs(error) > FAR);
  auto aims = (phase == RETURN) & (abs(error) > near) & may_move;
  Return<T> way = {0.0, grip};
  if (auto taken = when(aims)) way = aim(s, memory, mu, error, grip);
  auto swung = (side * theta_dot >= rate) | (side * theta > PULSE_END);
  if (auto taken = when((phase == PULSE) & swung)) {
    phase = BRAKE;
    timer = 0.0;
  }
  T found = side * law.torque_limit;
  auto runs = phase == RUN;
  if (auto taken = when(runs))
    found =
        side * guarded_torque(side * theta, side * theta_dot, side * x_dot, law, law.guard_from);
  if (auto taken = when((phase != PULSE) & !runs)) {
    T returning = approach(theta, theta_dot, way.home, way.grip);
    T braking = clip(-BRAKING * theta_dot, way.grip);
    T wanted = select((phase == RETURN) & aims, returning, braking);
    found = strokes::held_back(theta, theta_dot, wanted, way.grip, law);
  }
  return found;
}
}  // namespace pulses

template <class T, class Task> struct TaskRow {
  NoReference<T> reference;
  typename Task::template Memory<T> task;
};

// The law of the task `goal`: the gait and pulses, or strokes on smooth floors.
struct GoalPulses {
  template <class T> using Row = TaskRow<T, Goal>;
  CAPSULE_LAW(GoalPulses, "goal_pulses", double, pulses::Memory, Row, PULSES_CONSTANTS)
  // The platform moves by strokes if mu is below the first number, until mu is above the second.
  static constexpr double SMOOTH_MU = 0.035;
  static constexpr double LEAVE_MU = 0.06;
  static constexpr double STOP = 0.025;  // error at which a run ends, m

  template <class T>
  T torque(const State<T>& s, pulses::Memory<T>& memory, const Row<T>& row) const {
    auto& [estimator, phase, side, rate, start_x, gain, timer] = memory;
    T M = estimator.M;
    T mu = exp(estimator.log_mu);
    T error = row.task.goal - s.x;
    T found = 0.0;
    auto creeps = phase >= strokes::CREEP;
    auto rough = (mu > select(creeps, T(LEAVE_MU), T(SMOOTH_MU))) | (estimator.begun == 0.0);
    if (auto taken = when(rough)) {
      if (auto also = when(creeps)) {
        phase = pulses::BRAKE;
        rate = 0.0;
      }
      found = pulses::torque(s, memory, error, strokes::NEAR, STOP, *this);
    }
    if (auto taken = when(!rough)) {
      update_estimator(estimator, s.theta, s.theta_dot, s.x_dot, *this);
      auto moves = s.x_dot * side > 0.0;
      phase = select(creeps, phase, select(moves, T(strokes::STROKE), T(strokes::CREEP)));
      auto turns = (phase == strokes::CREEP) & (s.x_dot == 0.0) & (abs(error) > strokes::NEAR);
      side = select(turns, select(error > 0.0, T(1.0), T(-1.0)), side);
      strokes::Approach<T> ahead = {side * s.theta, side * s.theta_dot, side * s.x_dot,
                                    side * error};
      found = side * strokes::torque(ahead, M, mu, phase, *this);
    }
    return found;
  }
};

// The law of the task `velocity`: the gait and pulses towards the position of the target a little
// later.
struct VelocityPulses {
  template <class T> using Row = TaskRow<T, Velocity>;
  CAPSULE_LAW(VelocityPulses, "velocity_pulses", double, pulses::Memory, Row, PULSES_CONSTANTS)
  static constexpr double LOOK_AHEAD = 0.3;  // s
  static constexpr double CLOSE = 0.004;     // error that is not corrected, m

  template <class T>
  T torque(const State<T>& s, pulses::Memory<T>& memory, const Row<T>& row) const {
    T error = row.task.target + LOOK_AHEAD * row.task.command - s.x;
    return pulses::torque(s, memory, error, CLOSE, 0.0, *this);
  }
};
}  // namespace LEVEL
