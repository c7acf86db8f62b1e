// Strokes move the platform to a goal on a smooth floor by feedback linearisation of its motion.
//
// There friction changes the total momentum slowly, so the law moves the centre of mass to the goal
// and stops it there. In the phase CREEP the platform sticks, and the pendulum accelerates or
// brakes the centre of mass with most of the force that friction can take. If the pendulum has
// reached the front, or the goal is within reach, the platform makes a STROKE under the centre of
// mass, as far as the pendulum can swing. The centre of mass may still move on arrival: the
// platform already rests while the pendulum brakes. The numbers were chosen on 300 goals on the
// paper's floor.
#pragma once
#include "law.hpp"

namespace LEVEL {
namespace strokes {
// Phases, behind those of pulses.
constexpr double CREEP = 4.0;
constexpr double STROKE = 5.0;

constexpr double NEAR = 0.0018;       // error that is not corrected, m
constexpr double CREEP_SHARE = 0.85;  // of the friction, that the pendulum uses in CREEP
constexpr double REACH = 0.82;        // sin(theta) to which the pendulum swings
constexpr double OUTERMOST = 1.25;    // largest angle of the pendulum, rad
constexpr double LEAST_ROOM = 0.02;   // in which the pendulum is assumed to stop at least, rad
constexpr double OVERSHOOT = 1.05;    // factor of the deceleration that stops it
constexpr double GUARD = 100.0;       // deceleration from which the stop has priority, rad/s^2
// Duration of a stroke, for the distance that the centre of mass moves in it.
constexpr double STROKE_TIME = 0.22;  // s
// Accelerations of the platform, m/s^2; while it brakes, the control may exceed the planned one.
constexpr double SPEEDING_UP = 10.0;
constexpr double SLOWING_DOWN = 7.0;
constexpr double LARGEST_BRAKE = 1.5 * SLOWING_DOWN;
// Beyond this velocity relative to the centre of mass light platforms lose contact.
constexpr double LARGEST_LEAD = 0.65;  // m/s
constexpr double ARRIVAL = 30.0;       // rate of coming to rest where that is slower, 1/s
// Time constants, s.
constexpr double VELOCITY_TIME = 0.006;  // of the velocity in a stroke
constexpr double REST_TIME = 0.002;      // of the platform's stop in CREEP
constexpr double END_TIME = 0.005;       // of the stop at the end

// The torque in N m that gives the pendulum an acceleration while the platform sticks, but keeps it
// from falling: if stopping the pendulum at OUTERMOST requires a deceleration above `grip`,
// rad/s^2, the stop has priority.
template <class T> T held_back(T theta, T theta_dot, T acceleration, T grip, const auto& law) {
  T side = select(theta_dot > 0.0, T(1.0), T(-1.0));
  T needed = theta_dot * theta_dot / (2.0 * max(T(LEAST_ROOM), OUTERMOST - side * theta));
  acceleration = select(needed > grip, -OVERSHOOT * side * needed, acceleration);
  T gravity = law.m * law.l * law.g * sincos(theta).sin;
  return law.k * theta + law.c * theta_dot - gravity + law.m * law.l * law.l * acceleration;
}

// The velocity in m/s from which the platform stops within `way` metres.
template <class T> inline T arriving(T way) {
  way = max(T(0.0), way);
  return min(sqrt(2.0 * SLOWING_DOWN * way), ARRIVAL * way);
}

// The motion towards a goal `way` metres ahead; for a goal behind the platform it is mirrored.
// x_dot is exactly 0.0 in stick.
template <class T> struct Approach {
  T theta, theta_dot, x_dot, way;
};

// The phase that follows. `reach`: how far ahead of the platform its centre of mass comes when the
// pendulum swings to the front; `velocity`: that of the centre of mass.
template <class T> INLINE T next_phase(T phase, T way, T reach, T velocity, T sin) {
  auto within = way <= reach + STROKE_TIME * max(T(0.0), velocity);
  auto at_front = sin <= -REACH;
  auto starts = (phase == CREEP) & (way > NEAR) & (within | at_front);
  auto used_up = (reach < NEAR) & !within;
  auto ends = (phase == STROKE) & ((way < NEAR) | used_up);
  return select(starts, T(STROKE), select(ends, T(CREEP), phase));
}

// The acceleration of the platform in a stroke, m/s^2.
template <class T> INLINE T stroke_acceleration(T x_dot, T way, T reach, T velocity) {
  T arrival = min(arriving(way), velocity + arriving(reach));
  T wanted = min(arrival, max(T(0.0), velocity) + LARGEST_LEAD);
  return min(T(SPEEDING_UP), max(T(-LARGEST_BRAKE), (wanted - x_dot) / VELOCITY_TIME));
}

// The torque in N m and, in `phase`, the next phase, CREEP or STROKE.
template <class T> T torque(const Approach<T>& s, T M, T mu, T& phase, const auto& law) {
  const auto& [theta, theta_dot, x_dot, way] = s;
  auto [sin, cos] = sincos(theta);
  T total = M + law.m;
  // The centre of mass, relative to the platform, and its velocity.
  T shift = law.m * law.l / total;
  T centre = -shift * sin;
  T velocity = x_dot - shift * cos * theta_dot;
  T reach = centre + shift * REACH;
  phase = next_phase(phase, way, reach, velocity, sin);
  T normal = total * law.g - law.m * law.l * theta_dot * theta_dot / cos;
  T acceleration = 0.0;
  T force = 0.0;
  auto strokes = phase == STROKE;
  if (auto taken = when(strokes)) {
    acceleration = stroke_acceleration(x_dot, way, reach, velocity);
    T inertial = total * acceleration;
    normal = (normal - sin / cos * inertial) / (1.0 + mu * sin / cos);
    force = inertial + mu * normal * select(x_dot >= 0.0, T(1.0), T(-1.0));
  }
  if (auto taken = when(!strokes)) {
    T limit = CREEP_SHARE * mu * normal;
    // The pendulum may swing to the front until the centre of mass is there.
    T before = max(T(0.0), way + shift * REACH - centre);
    auto brakes = velocity * max(T(0.0), velocity) > 2.0 * CREEP_SHARE * mu * law.g * before;
    T moving = select(brakes, limit, -mu * normal);
    T stopping = clip(total * velocity / END_TIME, limit);
    force = select(way <= NEAR, stopping, moving) - total * x_dot / REST_TIME;
  }
  // The acceleration of the pendulum that exerts this force on the platform.
  T swing = (force / (law.m * law.l) + sin * theta_dot * theta_dot) / cos;
  return held_back(theta, theta_dot, swing, T(GUARD), law) - law.m * law.l * cos * acceleration;
}
}  // namespace strokes
}  // namespace LEVEL
