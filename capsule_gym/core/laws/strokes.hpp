// Strokes, which move the platform to a goal on a smooth floor, by feedback linearisation of its motion.
//
// On a smooth floor friction changes the total momentum slowly, so the law moves the centre of mass to the goal and stops
// it there. In the phase CREEP the platform sticks, and the pendulum accelerates or brakes the centre of mass with most
// of the force that friction can take. If the pendulum has reached the front, or the goal is within reach, the platform
// makes a STROKE under the centre of mass, as far as the pendulum can swing. The centre of mass may still move on
// arrival: the platform already rests while the pendulum brakes.
//
// The numbers were chosen on 300 goals with seeds from 7000 on, on the paper's floor.
#pragma once
#include "../elementary.hpp"

namespace LEVEL {

namespace strokes {

constexpr double CREEP = 4.0, STROKE = 5.0;
// Share of the friction that the pendulum uses in CREEP, and share of its largest reach, sin(theta) = 1, to which it
// swings.
constexpr double GRIP = 0.85, REACH = 0.82;
// Duration of a stroke, s, for the distance that the centre of mass moves in it.
constexpr double STROKE_TIME = 0.22;
// Accelerations of the platform, m/s^2, its largest velocity relative to the centre of mass, m/s, beyond which light
// platforms lose contact, and the rate at which it comes to rest where that is slower, 1/s.
constexpr double SPEEDING_UP = 10.0, SLOWING_DOWN = 7.0, FASTEST = 0.65, ARRIVAL = 30.0;
// Time constants, s: of the velocity in a stroke, of the platform's stop in CREEP, and of the stop at the end.
constexpr double VELOCITY_TIME = 0.006, REST_TIME = 0.002, END_TIME = 0.005;
// Error that is not corrected, m.
constexpr double NEAR = 0.0018;
// Largest angle of the pendulum, rad; decelerations above GUARD, rad/s^2, give priority to this limit.
constexpr double OUTERMOST = 1.25, GUARD = 100.0;

// The torque in N m that gives the pendulum an acceleration while the platform sticks, but keeps it from falling: if
// stopping the pendulum at OUTERMOST requires a deceleration above `grip`, rad/s^2, the stop has priority.
template <class Q> double held_back(double theta, double theta_dot, double acceleration, double grip, const Q& q) {
  double side = theta_dot > 0.0 ? 1.0 : -1.0;
  double needed = theta_dot * theta_dot / (2.0 * max(0.02, OUTERMOST - side * theta));
  if (needed > grip) acceleration = -1.05 * side * needed;
  return q.k * theta + q.c * theta_dot - q.m * q.l * q.g * sincos(theta).sin + q.m * q.l * q.l * acceleration;
}

// The velocity in m/s from which the platform stops within `way` metres.
inline double arriving(double way) {
  way = max(0.0, way);
  return min(sqrt(2.0 * SLOWING_DOWN * way), ARRIVAL * way);
}

// The torque in N m and, in `phase`, the next phase, CREEP or STROKE, for a goal that lies `way` metres ahead. For a goal
// behind the platform the state is mirrored. x_dot is exactly 0.0 in stick.
template <class Q>
double stroke_torque(double theta, double theta_dot, double x_dot, double way, double M, double mu, double& phase,
                     const Q& q) {
  auto [sin, cos] = sincos(theta);
  double weight = (M + q.m) * q.g, shift = q.m * q.l / (M + q.m);
  // The centre of mass, relative to the platform, and its velocity.
  double centre = -shift * sin, velocity = x_dot - shift * cos * theta_dot;
  double reach = centre + shift * REACH;
  bool within = way <= reach + STROKE_TIME * max(0.0, velocity);
  if (phase == CREEP && way > NEAR && (within || sin <= -REACH)) phase = STROKE;
  else if (phase == STROKE && (way < NEAR || (reach < NEAR && !within))) phase = CREEP;
  double normal = weight - q.m * q.l * theta_dot * theta_dot / cos;
  double acceleration = 0.0, force;
  if (phase == STROKE) {
    double wanted = min(min(arriving(way), velocity + arriving(reach)), max(0.0, velocity) + FASTEST);
    acceleration = min(SPEEDING_UP, max(-1.5 * SLOWING_DOWN, (wanted - x_dot) / VELOCITY_TIME));
    double inertial = (M + q.m) * acceleration;
    normal = (normal - sin / cos * inertial) / (1.0 + mu * sin / cos);
    force = inertial + mu * normal * (x_dot >= 0.0 ? 1.0 : -1.0);
  } else {
    double limit = GRIP * mu * normal;
    // The pendulum may swing to the front until the centre of mass is there.
    bool brakes =
        velocity * max(0.0, velocity) > 2.0 * GRIP * mu * q.g * max(0.0, way + shift * REACH - centre);
    force = way <= NEAR ? clip((M + q.m) * velocity / END_TIME, limit) : brakes ? limit : -mu * normal;
    force = force - (M + q.m) * x_dot / REST_TIME;
  }
  // The acceleration of the pendulum that exerts this force on the platform.
  double swing = (force / (q.m * q.l) + sin * theta_dot * theta_dot) / cos;
  return held_back(theta, theta_dot, swing, GUARD, q) - q.m * q.l * cos * acceleration;
}

}  // namespace strokes

}  // namespace LEVEL
