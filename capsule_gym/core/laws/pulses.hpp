// Laws for the tasks `goal` and `velocity`: a gait towards the goal, then pulses whose size adapts to the floor.
//
// Far from the goal the torque is the gait's, mirrored if the goal lies behind the platform. Near the goal the law
// repeats three phases: it returns the pendulum to the start of a pulse, slowly enough for the platform to stick; it
// accelerates the pendulum with full torque to the rate w that should move the platform by the error; and it brakes the
// pendulum slowly. A pulse moves the platform by about gain w^2 / mu; every pulse corrects the gain. M and mu, which
// limit the acceleration in stick, are identified online.
//
// The numbers were chosen by hand on 300 plants of the tasks' own distribution, with seeds from 1000 on. A law reads the
// goal's position, which follows its reference, and the exact position of the platform.
#pragma once
#include "../tasks/velocity.hpp"
#include "gait.hpp"
#include "strokes.hpp"

namespace LEVEL {

namespace pulses {

constexpr double RUN = 0.0, RETURN = 1.0, PULSE = 2.0, BRAKE = 3.0;
// Distance from the goal beyond which the platform runs, m.
constexpr double FAR = 0.05;
// The run ends earlier by this share of the sliding distance, x'^2 / (2 mu g).
constexpr double SLIDE = 0.15;
// Rate of the pendulum, rad/s, below which a run on the roughest floors has ended in an equilibrium.
constexpr double STALL = 1e-3;
// Share of the friction that the pendulum uses while the platform must stick, and its least and largest acceleration;
// the acceleration of a return before a run, when the platform may move, rad/s^2.
constexpr double GRIP = 0.9, LEAST_GRIP = 0.5, LARGEST_GRIP = 80.0, FAST = 40.0;
// mu while the standard deviation of log(mu) is above DOUBT; and the range to which the estimate is clipped.
constexpr double UNKNOWN_MU = 0.15, DOUBT = 0.5, LEAST_MU = 0.01, LARGEST_MU = 0.7;
// The share of the gain's error that a pulse corrects, and the smallest and largest factor of a correction.
constexpr double LEARNING = 0.4, LESS = 0.6, MORE = 3.0;
// Least and largest rate w of a pulse, rad/s, and the acceleration of its torque, rad/s^2.
constexpr double SLOWEST = 0.6, FASTEST = 9.0, ACCELERATION = 240.0;
// Angles, rad, positive in the direction of the pulse. A pulse starts at -HOME, on rough floors nearer to the upright,
// where full torque moves the platform; at most EARLIEST before this angle, and before START_END. It ends at PULSE_END;
// the pendulum should stop before BRAKED.
constexpr double HOME = 0.9, LEAST_HOME = 0.2, ROUGHNESS = 2.2, EARLIEST = 0.1, START_END = 0.3, PULSE_END = 0.8,
                 BRAKED = 0.9;

// The memory: that of the filter, the phase, and of the pulse the direction, the rate in rad/s, the start in m, the gain
// in m s^2 and the time since its end in s.
struct Memory {
  Identification filter;
  double phase, side, rate, start_x, gain, timer;
};

// The gait's parameters, the nominal pendulum, and the law's period.
#define PULSES_CONSTANTS(ONE, MANY) GAIT_CONSTANTS(ONE, MANY) ONE(m) ONE(l) ONE(g) ONE(k) ONE(c) ONE(dt)

// The acceleration, rad/s^2, that takes the pendulum to an angle and stops it there, within +-grip.
inline double approach(double theta, double theta_dot, double aim, double grip) {
  double way = aim - theta;
  double rate = min(sqrt(1.6 * grip * abs(way)), 8.0 * abs(way));
  return clip(40.0 * ((way > 0.0 ? rate : -rate) - theta_dot), grip);
}

// The torque for a goal that lies `error` metres ahead; an error up to `near` is not corrected, at `stop` a run ends.
template <class Q>
double torque(const State<double>& s, Memory& memory, double error, double near, double stop, const Q& q) {
  auto& [filter, phase, side, rate, start_x, gain, timer] = memory;
  const auto& [theta, theta_dot, x, x_dot] = s;
  identify(filter, theta, theta_dot, x_dot, q.m, q.l, q.g, q.dt);
  Estimates known = estimates(filter);
  double mu = known.log_mu_deviation > DOUBT ? UNKNOWN_MU : min(LARGEST_MU, max(LEAST_MU, exp(known.log_mu)));
  double size = abs(error);
  bool rests = x_dot == 0.0;
  double grip = min(LARGEST_GRIP, max(LEAST_GRIP, GRIP * mu * (known.M + q.m) * q.g / (q.m * q.l)));
  double home = 0.0;
  bool aims = false;
  timer = timer + q.dt;
  if (phase == RUN) {
    double slide = x_dot * side > 0.0 ? SLIDE * x_dot * x_dot / (2.0 * mu * q.g) : 0.0;
    bool stalls = rests && abs(theta_dot) < STALL && side * theta > 0.0;
    if (stalls || error * side < stop + slide) phase = BRAKE, timer = 0.0, rate = 0.0;
  } else if (phase == BRAKE && rests && abs(theta_dot) < 2.0 && timer > 0.005) {
    if (rate > 0.0) {
      double observed = max(0.0, side * (x - start_x)) * mu / (rate * rate);
      gain = max(LESS * gain, min(MORE * gain, gain + LEARNING * (observed - gain)));
    }
    phase = RETURN;
  }
  if (phase == RETURN && size > near && (rests || size > FAR)) {
    side = error > 0.0 ? 1.0 : -1.0;
    rate = min(FASTEST, max(SLOWEST, sqrt(size * mu / gain)));
    double nearer = size > FAR ? 0.0 : ROUGHNESS * (mu - 0.1);
    home = -side * min(HOME, max(LEAST_HOME, HOME - nearer)), aims = true;
    // The fastest pulse from here after which the pendulum stops in time.
    double room = max(0.0, BRAKED - side * theta - rate * rate / ACCELERATION);
    double fastest = sqrt(2.0 * grip * room);
    if (size > FAR) {
      grip = max(grip, FAST);
      if (side * theta < -0.5 && abs(theta_dot) < 3.0) phase = RUN;
    } else if (abs(theta_dot) < 0.5 + 0.1 * rate && -EARLIEST < side * (theta - home) && side * theta < START_END) {
      if (rate <= fastest || abs(theta - home) < 0.1)
        phase = PULSE, rate = max(SLOWEST, min(rate, fastest)), start_x = x;
    }
  }
  if (phase == PULSE && (side * theta_dot >= rate || side * theta > PULSE_END)) phase = BRAKE, timer = 0.0;
  if (phase == RUN)
    return side * guarded_torque(side * theta, side * theta_dot, side * x_dot, q, q.guard_from, q.torque_limit);
  if (phase == PULSE) return side * q.torque_limit;
  bool returns = phase == RETURN && aims;
  double wanted = returns ? approach(theta, theta_dot, home, grip) : clip(-20.0 * theta_dot, grip);
  return strokes::held_back(theta, theta_dot, wanted, grip, q);
}

}  // namespace pulses

// The law of the task `goal`: the gait and torque pulses, or strokes on smooth floors.
struct GoalPulses {
  static constexpr const char* NAME = "goal_pulses";
  static constexpr int MEMORY = WIDTH<pulses::Memory>, COLUMNS = 2, TASK_ROWS = Goal::ROWS;
  static constexpr bool BRANCHES = true;
  CAPSULE_LAW(GoalPulses, PULSES_CONSTANTS)
  // The platform moves by strokes if mu is below the first number, until mu is above the second.
  static constexpr double SMOOTH = 0.035, LEAVE = 0.06;

  double operator()(const State<double>& s, double* cells, const double* row) const {
    auto memory = load<pulses::Memory>(cells);
    auto& [filter, phase, side, rate, start_x, gain, timer] = memory;
    double M = filter.M, mu = exp(filter.log_mu), torque;
    double error = load<Goal::Memory<double>>(row + COLUMNS).goal - s.x;
    bool creeps = phase >= strokes::CREEP;
    if (mu > (creeps ? LEAVE : SMOOTH) || filter.begun == 0.0) {
      if (creeps) phase = pulses::BRAKE, rate = 0.0;
      torque = pulses::torque(s, memory, error, strokes::NEAR, 0.025, q);
    } else {
      identify(filter, s.theta, s.theta_dot, s.x_dot, q.m, q.l, q.g, q.dt);
      if (!creeps) phase = s.x_dot * side > 0.0 ? strokes::STROKE : strokes::CREEP;
      if (phase == strokes::CREEP && s.x_dot == 0.0 && abs(error) > strokes::NEAR) side = error > 0.0 ? 1.0 : -1.0;
      double way = side * error;
      torque = side * strokes::stroke_torque(side * s.theta, side * s.theta_dot, side * s.x_dot, way, M, mu, phase, q);
    }
    store(cells, memory);
    return torque;
  }
};

// The law of the task `velocity`: the gait and torque pulses towards the position of the target 0.3 s later.
struct VelocityPulses {
  static constexpr const char* NAME = "velocity_pulses";
  static constexpr int MEMORY = WIDTH<pulses::Memory>, COLUMNS = 2, TASK_ROWS = Velocity::ROWS;
  static constexpr bool BRANCHES = true;
  CAPSULE_LAW(VelocityPulses, PULSES_CONSTANTS)

  double operator()(const State<double>& s, double* cells, const double* row) const {
    auto memory = load<pulses::Memory>(cells);
    auto task = load<Velocity::Memory<double>>(row + COLUMNS);
    double torque = pulses::torque(s, memory, task.target + 0.3 * task.command - s.x, 0.004, 0.0, q);
    store(cells, memory);
    return torque;
  }
};

}  // namespace LEVEL
