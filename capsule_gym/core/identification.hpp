// The online filter that identifies M and mu from slip. It is part of a policy or a law, not of the environment.
#pragma once
#include "elementary.hpp"

namespace LEVEL {

// Prior of M in kg and log(mu): a little wider than `randomization="wide"`.
constexpr double PRIOR_M = 0.55, PRIOR_LOG_MU = -3.25, DEVIATION_M = 0.2, DEVIATION_LOG_MU = 1.5;
constexpr double VARIANCE_M = DEVIATION_M * DEVIATION_M, VARIANCE_LOG_MU = DEVIATION_LOG_MU * DEVIATION_LOG_MU;
// The estimates' range.
constexpr double LOW_M = 0.15, HIGH_M = 2.0, LOW_LOG_MU = -7.0, HIGH_LOG_MU = 0.0;

// The memory of the filter, all 0.0 at the start of an episode: 1.0 once begun; M in kg and log(mu) with their
// covariance; cos(theta) theta', sin(theta) theta' and x' of the last observation.
struct Identification {
  double begun, M, log_mu, P_MM, P_Mf, P_ff, across, along, x_dot;
};

// Updates the estimate of M and mu with one observation: theta (rad), theta_dot (rad/s) and x_dot (m/s), dt (s) after
// the last, of a pendulum with m (kg) and l (m) under g (m/s^2).
//
// While the platform slips in one direction, the balance of momentum between two observations is exact for any torque.
// With q = m l / (M + m) and s the sign of x',
//
//     d x' = q d(cos(theta) theta') - mu s (g dt - q d(sin(theta) theta'))
//
// where d is the difference of the two observations. An iterated extended Kalman filter estimates M and log(mu) with
// their covariance from such pairs of observations. It ignores pairs in which the platform sticks or changes its
// direction. The covariance grows a little with every pair and is reset where a pair contradicts the estimate, since M
// and mu can change during an episode. For a plant with another friction coefficient backwards, or with the paper's
// normal force, the balance is approximate.
inline void identify(Identification& memory, double theta, double theta_dot, double x_dot, double m, double l, double g,
                     double dt) {
  // Standard deviation of a velocity's difference, m/s: far above float32's rounding, so that the first pairs do not
  // overshoot.
  constexpr double NOISE = 1e-3;
  // Gauss-Newton steps for a pair, share of the information that remains after it, and deviations that contradict.
  constexpr int ITERATIONS = 3;
  constexpr double RETAINED = 0.95, DOUBT = 5.0;
  // m/s: below this speed the platform may have stuck in between.
  constexpr double SLOWEST = 0.02;
  auto [sin, cos] = sincos(theta);
  double across = cos * theta_dot, along = sin * theta_dot;
  auto [begun, M, log_mu, P_MM, P_Mf, P_ff, last_across, last_along, last_x_dot] = memory;
  if (begun == 0.0) {
    memory = {1.0, PRIOR_M, PRIOR_LOG_MU, VARIANCE_M, 0.0, VARIANCE_LOG_MU, across, along, x_dot};
    return;
  }
  if (x_dot * last_x_dot > 0.0 && min(abs(x_dot), abs(last_x_dot)) > SLOWEST) {
    double s = x_dot > 0.0 ? 1.0 : -1.0;
    double d_across = across - last_across, d_along = along - last_along, change = x_dot - last_x_dot;
    double before_M = M, before_log_mu = log_mu, gain_M = 0.0, gain_f = 0.0, to_M = 0.0, to_f = 0.0;
    for (int iteration = 0; iteration < ITERATIONS; iteration++) {
      // The change of x' by the balance of momentum, and its slopes over M and log(mu).
      double q = m * l / (M + m), mu = exp(log_mu);
      double friction = mu * s * (g * dt - q * d_along);
      double slope_M = -q / (M + m) * (d_across + mu * s * d_along), slope_f = -friction;
      double predicted = q * d_across - friction;
      double surprise = change - predicted - slope_M * (before_M - M) - slope_f * (before_log_mu - log_mu);
      to_M = P_MM * slope_M + P_Mf * slope_f, to_f = P_Mf * slope_M + P_ff * slope_f;
      double variance = slope_M * to_M + slope_f * to_f + NOISE * NOISE;
      if (iteration == 0 && surprise * surprise > DOUBT * DOUBT * variance) {
        P_MM = VARIANCE_M, P_Mf = 0.0, P_ff = VARIANCE_LOG_MU;
        to_M = P_MM * slope_M, to_f = P_ff * slope_f;
        variance = slope_M * to_M + slope_f * to_f + NOISE * NOISE;
      }
      gain_M = to_M / variance, gain_f = to_f / variance;
      M = min(HIGH_M, max(LOW_M, before_M + gain_M * surprise));
      log_mu = min(HIGH_LOG_MU, max(LOW_LOG_MU, before_log_mu + gain_f * surprise));
    }
    P_MM = P_MM - gain_M * to_M, P_Mf = P_Mf - gain_M * to_f, P_ff = P_ff - gain_f * to_f;
    // Never less certain than the prior.
    double fading = max(max(RETAINED, P_MM / VARIANCE_M), P_ff / VARIANCE_LOG_MU);
    P_MM = P_MM / fading, P_Mf = P_Mf / fading, P_ff = P_ff / fading;
  }
  memory = {begun, M, log_mu, P_MM, P_Mf, P_ff, across, along, x_dot};
}

// M in kg and log(mu) with their standard deviations.
struct Estimates {
  double M, log_mu, M_deviation, log_mu_deviation;
};

inline Estimates estimates(const Identification& memory) {
  return {memory.M, memory.log_mu, sqrt(max(0.0, memory.P_MM)), sqrt(max(0.0, memory.P_ff))};
}

}  // namespace LEVEL
