// Online estimates of the platform's mass M and of the friction coefficient mu.
//
// While the platform slips in one direction, the balance of momentum between two observations is
// exact for any torque. With their differences d, r = m l / (M + m) and s the sign of x',
//
//     d x' = r d(cos(theta) theta') - mu s (g dt - r d(sin(theta) theta')).
//
// An iterated extended Kalman filter estimates M and log(mu) with their covariance from such pairs
// of observations. The covariance grows a little with every pair and is reset where a pair
// contradicts the estimate, since M and mu can change during an episode. For a capsule with another
// friction coefficient backwards, or with the paper's normal force, the balance is approximate. The
// estimator is part of a law, or of an environment that shows the estimates.
#pragma once
#include "numbers/elementary.hpp"

namespace LEVEL {
// The memory, 0.0 at the start of an episode.
template <class T> struct Estimator {
  T begun;             // 1.0 after the first observation
  T M, log_mu;         // kg, 1
  T P_MM, P_Mf, P_ff;  // their covariance
  T across, along;     // cos(theta) theta' and sin(theta) theta' of the last observation
  T x_dot;             // of the last observation

  // Prior: a little wider than `randomization="wide"`.
  static constexpr double PRIOR_M = 0.55;  // kg
  static constexpr double PRIOR_LOG_MU = -3.25;
  static constexpr double DEVIATION_M = 0.2;  // kg
  static constexpr double DEVIATION_LOG_MU = 1.5;
  static constexpr double VARIANCE_M = DEVIATION_M * DEVIATION_M;
  static constexpr double VARIANCE_LOG_MU = DEVIATION_LOG_MU * DEVIATION_LOG_MU;
  // Range of the estimates.
  static constexpr double LOW_M = 0.15;  // kg
  static constexpr double HIGH_M = 2.0;  // kg
  static constexpr double LOW_LOG_MU = -7.0;
  static constexpr double HIGH_LOG_MU = 0.0;
  // Standard deviation of a velocity's difference, m/s: far above float32's rounding, so that the
  // first pairs do not overshoot.
  static constexpr double NOISE = 1e-3;
  static constexpr int GAUSS_NEWTON_STEPS = 3;
  static constexpr double RETAINED = 0.95;  // share of the information that remains after a pair
  static constexpr double CONTRADICTION = 5.0;  // standard deviations
  static constexpr double LEAST_SPEED = 0.02;  // m/s: below, the platform may have stuck in between
};

// The change of x' by the balance of momentum, and its slopes over M and log(mu).
template <class T> struct Balance {
  T change, slope_M, slope_f;
};
template <class T>
INLINE Balance<T> momentum_balance(T M, T log_mu, T d_across, T d_along, T direction,
                                   const auto& pendulum) {
  T ratio = pendulum.m * pendulum.l / (M + pendulum.m);
  T mu = exp(log_mu);
  T friction = mu * direction * (pendulum.g * pendulum.dt - ratio * d_along);
  T slope_M = -ratio / (M + pendulum.m) * (d_across + mu * direction * d_along);
  return {ratio * d_across - friction, slope_M, -friction};
}

// Corrects the estimates by the changes between two observations in slip.
template <class T>
INLINE void correct(Estimator<T>& e, T d_across, T d_along, T d_x_dot, T direction,
                    const auto& pendulum) {
  using E = Estimator<double>;
  T prior_M = e.M;
  T prior_log_mu = e.log_mu;
  // Covariances of M and of log(mu) with the change of x', and these over its variance.
  T to_M = 0.0;
  T to_f = 0.0;
  T gain_M = 0.0;
  T gain_f = 0.0;
  for (int i = 0; i < E::GAUSS_NEWTON_STEPS; i++) {
    auto [predicted, slope_M, slope_f] =
        momentum_balance(e.M, e.log_mu, d_across, d_along, direction, pendulum);
    T surprise =
        d_x_dot - predicted - slope_M * (prior_M - e.M) - slope_f * (prior_log_mu - e.log_mu);
    to_M = e.P_MM * slope_M + e.P_Mf * slope_f;
    to_f = e.P_Mf * slope_M + e.P_ff * slope_f;
    T variance = slope_M * to_M + slope_f * to_f + E::NOISE * E::NOISE;
    auto contradicts = surprise * surprise > E::CONTRADICTION * E::CONTRADICTION * variance;
    if (auto taken = when(contradicts); taken && i == 0) {
      e.P_MM = E::VARIANCE_M;
      e.P_Mf = 0.0;
      e.P_ff = E::VARIANCE_LOG_MU;
      to_M = e.P_MM * slope_M;
      to_f = e.P_ff * slope_f;
      variance = slope_M * to_M + slope_f * to_f + E::NOISE * E::NOISE;
    }
    gain_M = to_M / variance;
    gain_f = to_f / variance;
    e.M = min(T(E::HIGH_M), max(T(E::LOW_M), prior_M + gain_M * surprise));
    e.log_mu = min(T(E::HIGH_LOG_MU), max(T(E::LOW_LOG_MU), prior_log_mu + gain_f * surprise));
  }
  e.P_MM = e.P_MM - gain_M * to_M;
  e.P_Mf = e.P_Mf - gain_M * to_f;
  e.P_ff = e.P_ff - gain_f * to_f;
  // Never less certain than the prior.
  T fading = max(max(T(E::RETAINED), e.P_MM / E::VARIANCE_M), e.P_ff / E::VARIANCE_LOG_MU);
  e.P_MM = e.P_MM / fading;
  e.P_Mf = e.P_Mf / fading;
  e.P_ff = e.P_ff / fading;
}

// Updates the estimates with an observation, `dt` seconds after the last, of a pendulum of mass `m`
// and length `l` under gravity `g`.
template <class T>
inline void update_estimator(Estimator<T>& e, T theta, T theta_dot, T x_dot, const auto& pendulum) {
  using E = Estimator<double>;
  auto [sin, cos] = sincos(theta);
  T across = cos * theta_dot;
  T along = sin * theta_dot;
  auto begins = e.begun == 0.0;
  auto one_direction = x_dot * e.x_dot > 0.0;
  auto fast = min(abs(x_dot), abs(e.x_dot)) > E::LEAST_SPEED;
  auto slips = one_direction & fast & !begins;
  if (auto taken = when(begins))
    e = {.begun = 1.0,
         .M = E::PRIOR_M,
         .log_mu = E::PRIOR_LOG_MU,
         .P_MM = E::VARIANCE_M,
         .P_Mf = 0.0,
         .P_ff = E::VARIANCE_LOG_MU,
         .across = across,
         .along = along,
         .x_dot = x_dot};
  if (auto taken = when(slips)) {
    T direction = select(x_dot > 0.0, T(1.0), T(-1.0));
    correct(e, across - e.across, along - e.along, x_dot - e.x_dot, direction, pendulum);
  }
  e.across = across;
  e.along = along;
  e.x_dot = x_dot;
}

// The standard deviation of an estimate from its variance, which rounding may have made negative.
template <class T> INLINE T deviation(T variance) { return sqrt(max(T(0.0), variance)); }
}  // namespace LEVEL
