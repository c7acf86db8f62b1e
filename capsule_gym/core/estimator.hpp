// Online estimates of the platform's mass M and of the friction coefficient mu.
//
// While the platform slips in one direction, the balance of momentum between two observations is
// exact for any torque. With their differences d, q = m l / (M + m) and s the sign of x',
//
//     d x' = q d(cos(theta) theta') - mu s (g dt - q d(sin(theta) theta')).
//
// An iterated extended Kalman filter estimates M and log(mu) with their covariance from such pairs
// of observations. The covariance grows a little with every pair and is reset where a pair
// contradicts the estimate, since M and mu can change during an episode. For a capsule with another
// friction coefficient backwards, or with the paper's normal force, the balance is approximate. The
// estimator is part of a law, or of an environment that shows the estimates.
#pragma once
#include "numbers/elementary.hpp"

namespace LEVEL {
// The memory, 0.0 at the start of an episode: 1.0 once begun; M in kg, log(mu) and their
// covariance; cos(theta) theta', sin(theta) theta' and x' of the last observation.
template <class T> struct Estimator {
  T begun, M, log_mu, P_MM, P_Mf, P_ff, across, along, x_dot;

  // Prior of M in kg and log(mu): a little wider than `randomization="wide"`.
  static constexpr double PRIOR_M = 0.55, PRIOR_LOG_MU = -3.25, DEVIATION_M = 0.2,
                          DEVIATION_LOG_MU = 1.5;
  static constexpr double LOW_M = 0.15, HIGH_M = 2.0, LOW_LOG_MU = -7.0,
                          HIGH_LOG_MU = 0.0;  // the estimates' range
  // Standard deviation of a velocity's difference, m/s: far above float32's rounding, so that the
  // first pairs do not overshoot.
  static constexpr double NOISE = 1e-3;
  // Gauss-Newton steps for a pair, share of the information that remains after it, and deviations
  // that contradict.
  static constexpr int ITERATIONS = 3;
  static constexpr double RETAINED = 0.95, DOUBT = 5.0;
  static constexpr double SLOWEST =
      0.02;  // m/s: below this speed the platform may have stuck in between
};

// Updates the estimates with an observation, c.dt seconds after the last, on a pendulum of mass c.m
// and length c.l.
template <class T, class C>
inline void update_estimator(Estimator<T>& e, T theta, T theta_dot, T x_dot, const C& c) {
  using E = Estimator<double>;
  constexpr double VARIANCE_M = E::DEVIATION_M * E::DEVIATION_M;
  constexpr double VARIANCE_LOG_MU = E::DEVIATION_LOG_MU * E::DEVIATION_LOG_MU;
  auto [sin, cos] = sincos(theta);
  T across = cos * theta_dot, along = sin * theta_dot;
  auto begins = e.begun == 0.0;
  auto slips = (x_dot * e.x_dot > 0.0) & (min(abs(x_dot), abs(e.x_dot)) > E::SLOWEST) & !begins;
  if (auto taken = when(begins))
    e = {1.0, E::PRIOR_M, E::PRIOR_LOG_MU, VARIANCE_M, 0.0, VARIANCE_LOG_MU, across, along, x_dot};
  if (auto taken = when(slips)) {
    T s = select(x_dot > 0.0, T(1.0), T(-1.0));
    T d_across = across - e.across, d_along = along - e.along, change = x_dot - e.x_dot;
    T before_M = e.M, before_log_mu = e.log_mu;
    T gain_M = 0.0, gain_f = 0.0, to_M = 0.0, to_f = 0.0;
    for (int i = 0; i < E::ITERATIONS; i++) {
      // The change of x' by the balance of momentum, and its slopes over M and log(mu).
      T q = c.m * c.l / (e.M + c.m), mu = exp(e.log_mu);
      T friction = mu * s * (c.g * c.dt - q * d_along);
      T slope_M = -q / (e.M + c.m) * (d_across + mu * s * d_along), slope_f = -friction;
      T predicted = q * d_across - friction;
      T surprise =
          change - predicted - slope_M * (before_M - e.M) - slope_f * (before_log_mu - e.log_mu);
      to_M = e.P_MM * slope_M + e.P_Mf * slope_f, to_f = e.P_Mf * slope_M + e.P_ff * slope_f;
      T variance = slope_M * to_M + slope_f * to_f + E::NOISE * E::NOISE;
      auto contradicts = surprise * surprise > E::DOUBT * E::DOUBT * variance;
      if (auto taken = when(contradicts); taken && i == 0) {
        e.P_MM = VARIANCE_M, e.P_Mf = 0.0, e.P_ff = VARIANCE_LOG_MU;
        to_M = e.P_MM * slope_M, to_f = e.P_ff * slope_f;
        variance = slope_M * to_M + slope_f * to_f + E::NOISE * E::NOISE;
      }
      gain_M = to_M / variance, gain_f = to_f / variance;
      e.M = min(T(E::HIGH_M), max(T(E::LOW_M), before_M + gain_M * surprise));
      e.log_mu = min(T(E::HIGH_LOG_MU), max(T(E::LOW_LOG_MU), before_log_mu + gain_f * surprise));
    }
    e.P_MM = e.P_MM - gain_M * to_M, e.P_Mf = e.P_Mf - gain_M * to_f,
    e.P_ff = e.P_ff - gain_f * to_f;
    // Never less certain than the prior.
    T fading = max(max(T(E::RETAINED), e.P_MM / VARIANCE_M), e.P_ff / VARIANCE_LOG_MU);
    e.P_MM = e.P_MM / fading, e.P_Mf = e.P_Mf / fading, e.P_ff = e.P_ff / fading;
  }
  e.across = across, e.along = along, e.x_dot = x_dot;
}

// The standard deviation of an estimate from its variance, which rounding may have made negative.
template <class T> INLINE T deviation(T variance) { return sqrt(max(T(0.0), variance)); }
}  // namespace LEVEL
