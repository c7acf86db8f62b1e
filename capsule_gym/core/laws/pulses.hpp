// Laws for the tasks `goal` and `velocity`: a gait towards the goal, then pulses whose size adapts
// to the floor, or strokes on smooth floors. They read the positions of the goal and of the
// platform.
#pragma once
#include "../tasks/goal.hpp"
#include "../tasks/velocity.hpp"
#include "gait.hpp"

namespace LEVEL {
// The gait's parameters, the nominal pendulum, and the law's period.
#define PULSES_CONSTANTS(ONE, MANY) \
  GAIT_CONSTANTS(ONE, MANY) ONE(m)  \
  ONE(l)                            \
  ONE(g)                            \
  ONE(k)                            \
  ONE(c)                            \
  ONE(dt)

// Strokes move the platform to a goal on a smooth floor by feedback linearisation of its motion.
//
// There friction changes the total momentum slowly, so the law moves the centre of mass to the goal
// and stops it there. In the phase CREEP the platform sticks, and the pendulum accelerates or
// brakes the centre of mass with most of the force that friction can take. If the pendulum has
// reached the front, or the goal is within reach, the platform makes a STROKE under the centre of
// mass, as far as the pendulum can swing. The centre of mass may still move on arrival: the
// platform already rests while the pendulum brakes. The numbers were chosen on 300 goals on the
// paper's floor.
namespace strokes {
constexpr double CREEP = 4.0, STROKE = 5.0;
// Shares of the friction that the pendulum uses in CREEP, and of its largest reach, sin(theta) = 1,
// to which it swings.
constexpr double GRIP = 0.85, REACH = 0.82;
constexpr double STROKE_TIME =
    0.22;  // duration of a stroke, s, for the distance that the centre of mass moves in it
// Accelerations of the platform, m/s^2, its largest velocity relative to the centre of mass, m/s,
// beyond which light platforms lose contact, and the rate at which it comes to rest where that is
// slower, 1/s.
constexpr double SPEEDING_UP = 10.0, SLOWING_DOWN = 7.0, FASTEST = 0.65, ARRIVAL = 30.0;
// Time constants, s: of the velocity in a stroke, of the platform's stop in CREEP, and of the stop
// at the end.
constexpr double VELOCITY_TIME = 0.006, REST_TIME = 0.002, END_TIME = 0.005;
constexpr double NEAR = 0.0018;  // error that is not corrected, m
// Largest angle of the pendulum, rad; decelerations above GUARD, rad/s^2, give priority to this
// limit.
constexpr double OUTERMOST = 1.25, GUARD = 100.0;

// The torque in N m that gives the pendulum an acceleration while the platform sticks, but keeps it
// from falling: if stopping the pendulum at OUTERMOST requires a deceleration above `grip`,
// rad/s^2, the stop has priority.
template <class T, class Q> T held_back(T theta, T theta_dot, T acceleration, T grip, const Q& q) {
  T side = select(theta_dot > 0.0, T(1.0), T(-1.0));
  T needed = theta_dot * theta_dot / (2.0 * max(T(0.02), OUTERMOST - side * theta));
  acceleration = select(needed > grip, -1.05 * side * needed, acceleration);
  return q.k * theta + q.c * theta_dot - q.m * q.l * q.g * sincos(theta).sin +
         q.m * q.l * q.l * acceleration;
}

// The velocity in m/s from which the platform stops within `way` metres.
template <class T> inline T arriving(T way) {
  way = max(T(0.0), way);
  return min(sqrt(2.0 * SLOWING_DOWN * way), ARRIVAL * way);
}

// The torque in N m and, in `phase`, the next phase, CREEP or STROKE, for a goal that lies `way`
// metres ahead. For a goal behind the platform the state is mirrored. x_dot is exactly 0.0 in
// stick.
template <class T, class Q>
T torque(T theta, T theta_dot, T x_dot, T way, T M, T mu, T& phase, const Q& q) {
  auto [sin, cos] = sincos(theta);
  T weight = (M + q.m) * q.g, shift = q.m * q.l / (M + q.m);
  // The centre of mass, relative to the platform, and its velocity.
  T centre = -shift * sin, velocity = x_dot - shift * cos * theta_dot;
  T reach = centre + shift * REACH;
  auto within = way <= reach + STROKE_TIME * max(T(0.0), velocity);
  auto starts = (phase == CREEP) & (way > NEAR) & (within | (sin <= -REACH));
  auto ends = (phase == STROKE) & ((way < NEAR) | ((reach < NEAR) & !within));
  phase = select(starts, T(STROKE), select(ends, T(CREEP), phase));
  T normal = weight - q.m * q.l * theta_dot * theta_dot / cos, acceleration = 0.0, force = 0.0;
  auto strokes = phase == STROKE;
  if (auto taken = when(strokes)) {
    T wanted = min(min(arriving(way), velocity + arriving(reach)), max(T(0.0), velocity) + FASTEST);
    acceleration =
        min(T(SPEEDING_UP), max(T(-1.5 * SLOWING_DOWN), (wanted - x_dot) / VELOCITY_TIME));
    T inertial = (M + q.m) * acceleration;
    normal = (normal - sin / cos * inertial) / (1.0 + mu * sin / cos);
    force = inertial + mu * normal * select(x_dot >= 0.0, T(1.0), T(-1.0));
  }
  if (auto taken = when(!strokes)) {
    T limit = GRIP * mu * normal;
    // The pendulum may swing to the front until the centre of mass is there.
    T before = max(T(0.0), way + shift * REACH - centre);
    auto brakes = velocity * max(T(0.0), velocity) > 2.0 * GRIP * mu * q.g * before;
    T stop = clip((M + q.m) * velocity / END_TIME, limit);
    force = select(way <= NEAR, stop, select(brakes, limit, -mu * normal)) -
            (M + q.m) * x_dot / REST_TIME;
  }
  // The acceleration of the pendulum that exerts this force on the platform.
  T swing = (force / (q.m * q.l) + sin * theta_dot * theta_dot) / cos;
  return held_back(theta, theta_dot, swing, T(GUARD), q) - q.m * q.l * cos * acceleration;
}
}  // namespace strokes

// Far from the goal the torque is the gait's, mirrored if the goal lies behind the platform. Near
// the goal the law repeats three phases: it returns the pendulum to the start of a pulse, slowly
// enough for the platform to stick; it accelerates the pendulum with full torque to the rate w that
// should move the platform by the error; and it brakes the pendulum slowly. A pulse moves the
// platform by about gain w^2 / mu; every pulse corrects the gain. M and mu, which limit the
// acceleration in stick, are estimated online. The numbers were chosen by hand on 300 plants of the
// tasks' own distribution.
namespace pulses {
constexpr double RUN = 0.0, RETURN = 1.0, PULSE = 2.0, BRAKE = 3.0;
constexpr double FAR = 0.05;  // distance from the goal beyond which the platform runs, m
constexpr double SLIDE =
    0.15;  // the run ends earlier by this share of the sliding distance, x'^2 / (2 mu g)
// Rate of the pendulum, rad/s, below which a run on the roughest floors has ended in an
// equilibrium.
constexpr double STALL = 1e-3;
// Share of the friction that the pendulum uses while the platform must stick, and its least and
// largest acceleration; the acceleration of a return before a run, when the platform may move,
// rad/s^2.
constexpr double GRIP = 0.9, LEAST_GRIP = 0.5, LARGEST_GRIP = 80.0, FAST = 40.0;
// mu while the standard deviation of log(mu) is above DOUBT; and the range to which the estimate is
// clipped.
constexpr double UNKNOWN_MU = 0.15, DOUBT = 0.5, LEAST_MU = 0.01, LARGEST_MU = 0.7;
// The share of the gain's error that a pulse corrects, and the smallest and largest factor of a
// correction.
constexpr double LEARNING = 0.4, LESS = 0.6, MORE = 3.0;
// Least and largest rate w of a pulse, rad/s, and the acceleration of its torque, rad/s^2.
constexpr double SLOWEST = 0.6, FASTEST = 9.0, ACCELERATION = 240.0;
// Angles, rad, positive in the direction of the pulse. A pulse starts at -HOME, on rough floors
// nearer to the upright, where full torque moves the platform; at most EARLIEST before this angle,
// and before START_END. It ends at PULSE_END; the pendulum should stop before BRAKED.
constexpr double HOME = 0.9, LEAST_HOME = 0.2, ROUGHNESS = 2.2, EARLIEST = 0.1, START_END = 0.3,
                 PULSE_END = 0.8;
constexpr double BRAKED = 0.9;

// The phase, and of the pulse the direction, the rate in rad/s, the start in m, the gain in m s^2
// and the time since its end in s.
template <class T> struct Memory {
  Estimator<T> estimator;
  T phase, side, rate, start_x, gain, timer;
};

// The acceleration, rad/s^2, that takes the pendulum to an angle and stops it there, within +-grip.
template <class T> inline T approach(T theta, T theta_dot, T aim, T grip) {
  T way = aim - theta;
  T rate = min(sqrt(1.6 * grip * abs(way)), 8.0 * abs(way));
  return clip(40.0 * (select(way > 0.0, rate, -rate) - theta_dot), grip);
}

// The torque for a goal that lies `error` metres ahead; an error up to `near` is not corrected, at
// `stop` a run ends.
template <class T, class Q>
T torque(const State<T>& s, Memory<T>& memory, T error, double near, double stop, const Q& q) {
  auto& [estimator, phase, side, rate, start_x, gain, timer] = memory;
  const auto& [theta, theta_dot, x, x_dot] = s;
  update_estimator(estimator, theta, theta_dot, x_dot, q);
  T mu = min(T(LARGEST_MU), max(T(LEAST_MU), exp(estimator.log_mu)));
  mu = select(deviation(estimator.P_ff) > DOUBT, T(UNKNOWN_MU), mu);
  T grip =
      min(T(LARGEST_GRIP), max(T(LEAST_GRIP), GRIP * mu * (estimator.M + q.m) * q.g / (q.m * q.l)));
  T size = abs(error), home = 0.0;
  auto rests = x_dot == 0.0, far = size > FAR;
  timer = timer + q.dt;
  auto stopped = (phase == BRAKE) & rests & (abs(theta_dot) < 2.0) & (timer > 0.005);
  if (auto taken = when(phase == RUN)) {
    T slide = select(x_dot * side > 0.0, SLIDE * x_dot * x_dot / (2.0 * mu * q.g), T(0.0));
    auto stalls = rests & (abs(theta_dot) < STALL) & (side * theta > 0.0);
    if (auto also = when(stalls | (error * side < stop + slide)))
      phase = BRAKE, timer = 0.0, rate = 0.0;
  }
  if (auto taken = when(stopped)) {
    if (auto also = when(rate > 0.0)) {
      T observed = max(T(0.0), side * (x - start_x)) * mu / (rate * rate);
      gain = max(LESS * gain, min(MORE * gain, gain + LEARNING * (observed - gain)));
    }
    phase = RETURN;
  }
  auto aims = (phase == RETURN) & (size > near) & (rests | far);
  if (auto taken = when(aims)) {
    side = select(error > 0.0, T(1.0), T(-1.0));
    rate = min(T(FASTEST), max(T(SLOWEST), sqrt(size * mu / gain)));
    T nearer = select(far, T(0.0), ROUGHNESS * (mu - 0.1));
    home = -side * min(T(HOME), max(T(LEAST_HOME), HOME - nearer));
    // The fastest pulse from here after which the pendulum stops in time.
    T fastest = sqrt(2.0 * grip * max(T(0.0), BRAKED - side * theta - rate * rate / ACCELERATION));
    grip = select(far, max(grip, T(FAST)), grip);
    phase = select(far & (side * theta < -0.5) & (abs(theta_dot) < 3.0), T(RUN), phase);
    auto starts = (abs(theta_dot) < 0.5 + 0.1 * rate) & (-EARLIEST < side * (theta - home)) &
                  (side * theta < START_END) & ((rate <= fastest) | (abs(theta - home) < 0.1)) &
                  !far;
    if (auto also = when(starts))
      phase = PULSE, rate = max(T(SLOWEST), min(rate, fastest)), start_x = x;
  }
  auto ends = (phase == PULSE) & ((side * theta_dot >= rate) | (side * theta > PULSE_END));
  if (auto taken = when(ends)) phase = BRAKE, timer = 0.0;
  T found = side * q.torque_limit;
  auto runs = phase == RUN;
  auto brakes = (phase != PULSE) & !runs;
  if (auto taken = when(runs))
    found = side * guarded_torque(side * theta, side * theta_dot, side * x_dot, q, q.guard_from,
                                  q.torque_limit);
  if (auto taken = when(brakes)) {
    T wanted = select((phase == RETURN) & aims, approach(theta, theta_dot, home, grip),
                      clip(-20.0 * theta_dot, grip));
    found = strokes::held_back(theta, theta_dot, wanted, grip, q);
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
  static constexpr double SMOOTH = 0.035, LEAVE = 0.06;

  template <class T>
  T torque(const State<T>& s, pulses::Memory<T>& memory, const Row<T>& row) const {
    auto& [estimator, phase, side, rate, start_x, gain, timer] = memory;
    T M = estimator.M, mu = exp(estimator.log_mu), error = row.task.goal - s.x, found = 0.0;
    auto creeps = phase >= strokes::CREEP;
    auto rough = (mu > select(creeps, T(LEAVE), T(SMOOTH))) | (estimator.begun == 0.0);
    if (auto taken = when(rough)) {
      if (auto also = when(creeps)) phase = pulses::BRAKE, rate = 0.0;
      found = pulses::torque(s, memory, error, strokes::NEAR, 0.025, q);
    }
    if (auto taken = when(!rough)) {
      update_estimator(estimator, s.theta, s.theta_dot, s.x_dot, q);
      phase = select(creeps, phase,
                     select(s.x_dot * side > 0.0, T(strokes::STROKE), T(strokes::CREEP)));
      auto turns = (phase == strokes::CREEP) & (s.x_dot == 0.0) & (abs(error) > strokes::NEAR);
      side = select(turns, select(error > 0.0, T(1.0), T(-1.0)), side);
      found = side * strokes::torque(side * s.theta, side * s.theta_dot, side * s.x_dot,
                                     side * error, M, mu, phase, q);
    }
    return found;
  }
};

// The law of the task `velocity`: the gait and pulses towards the position of the target 0.3 s
// later.
struct VelocityPulses {
  template <class T> using Row = TaskRow<T, Velocity>;
  CAPSULE_LAW(VelocityPulses, "velocity_pulses", double, pulses::Memory, Row, PULSES_CONSTANTS)

  template <class T>
  T torque(const State<T>& s, pulses::Memory<T>& memory, const Row<T>& row) const {
    return pulses::torque(s, memory, row.task.target + 0.3 * row.task.command - s.x, 0.004, 0.0, q);
  }
};
}  // namespace LEVEL
