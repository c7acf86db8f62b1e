// The observation of the speed task's entries; other tasks add theirs behind.
#pragma once
#include "elementary.hpp"

namespace LEVEL {

// rad: the ball meets the platform.
constexpr double THETA_LIMIT = PI / 2.0;
// Bounds of the observation, which is clipped to them. Full torque switched in the worst phase gives 13 rad/s and 1.2 m/s
// on the capsule of the paper; the rest is room for other capsules.
constexpr double THETA_DOT_BOUND = 20.0, X_DOT_BOUND = 2.0;

struct Observed {
  double theta, theta_dot, x_dot;  // rad, rad/s, m/s
  double stick_threshold;          // largest |x_dot| that counts as stick, m/s
  double last_action;              // in [-1, 1]
};

struct ObservedLaw {
  double theta_d, theta_d_dot, phase;  // of the reference: rad, rad/s, and the share of the cycle in [0, 1)
  double torque;                       // of the law at this instant, clipped to the torque limit, N m
};

// Each writes entries in the order of `observation_names` and returns the place behind them.
inline float* write_state(float* out, const Observed& s) {
  out[0] = (float)clip(s.theta, THETA_LIMIT);
  out[1] = (float)clip(s.theta_dot, THETA_DOT_BOUND);
  out[2] = (float)clip(s.x_dot, X_DOT_BOUND);
  out[3] = abs(s.x_dot) <= s.stick_threshold ? 1.0f : 0.0f;
  out[4] = (float)s.last_action;
  return out + 5;
}

inline float* write_law(float* out, const ObservedLaw& law) {
  auto [sin, cos] = sincos(2.0 * PI * law.phase);
  out[0] = (float)clip(law.theta_d, THETA_LIMIT);
  out[1] = (float)clip(law.theta_d_dot, THETA_DOT_BOUND);
  out[2] = (float)sin, out[3] = (float)cos;
  out[4] = (float)law.torque;
  return out + 5;
}

inline float* write_parameters(float* out, double M, double mu) {
  out[0] = (float)M, out[1] = (float)mu;
  return out + 2;
}

}  // namespace LEVEL
