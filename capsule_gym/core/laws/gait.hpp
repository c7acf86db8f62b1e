// A gait without a clock: the torque is a polynomial of the state, and a guard keeps the contact.
#pragma once
#include "../estimator.hpp"
#include "law.hpp"

namespace LEVEL {
// phi_ijk is the coefficient of theta^i theta_dot^j x_dot^k, each divided by its scale.
#define GAIT_CONSTANTS(ONE, MANY)                                                 \
  ONE(phi_000)                                                                    \
  ONE(phi_001)                                                                    \
  ONE(phi_002)                                                                    \
  ONE(phi_003)                                                                    \
  ONE(phi_010)                                                                    \
  ONE(phi_011)                                                                    \
  ONE(phi_012)                                                                    \
  ONE(phi_020)                                                                    \
  ONE(phi_021)                                                                    \
  ONE(phi_030)                                                                    \
  ONE(phi_100)                                                                    \
  ONE(phi_101)                                                                    \
  ONE(phi_102)                                                                    \
  ONE(phi_110)                                                                    \
  ONE(phi_111)                                                                    \
  ONE(phi_120)                                                                    \
  ONE(phi_200)                                                                    \
  ONE(phi_201)                                                                    \
  ONE(phi_210)                                                                    \
  ONE(phi_300)                                                                    \
  ONE(sign_x_dot)   /* the step in the direction of slip */                       \
  ONE(guard_gain)   /* N m s^2 */                                                 \
  ONE(guard_from)   /* theta_dot^2 cos(theta) from which the guard acts, 1/s^2 */ \
  ONE(torque_limit) /* N m: the polynomial is scaled by it, and clipped to it */
// Scales that make the polynomial's coefficients comparable.
constexpr double THETA_SCALE = 1.0;      // rad
constexpr double THETA_DOT_SCALE = 5.0;  // rad/s
constexpr double X_DOT_SCALE = 0.3;      // m/s

// The cubic polynomial of the state plus a step in the direction of slip.
template <class T> INLINE T gait_polynomial(T theta, T theta_dot, T x_dot, const auto& law) {
  T a = theta / THETA_SCALE;
  T b = theta_dot / THETA_DOT_SCALE;
  T c = x_dot / X_DOT_SCALE;
  T aa = a * a;
  T bb = b * b;
  T cc = c * c;
  T torque = law.sign_x_dot * sign_of(x_dot) + law.phi_000 + law.phi_001 * c + law.phi_002 * cc +
             law.phi_003 * (cc * c);
  torque = torque + law.phi_010 * b + law.phi_011 * b * c + law.phi_012 * b * cc +
           law.phi_020 * bb + law.phi_021 * bb * c + law.phi_030 * (bb * b);
  torque = torque + law.phi_100 * a + law.phi_101 * a * c + law.phi_102 * a * cc +
           law.phi_110 * a * b + law.phi_111 * a * b * c + law.phi_120 * a * bb;
  return torque + law.phi_200 * aa + law.phi_201 * aa * c + law.phi_210 * aa * b +
         law.phi_300 * (aa * a);
}

// The gait's torque within the limit, less the guard's, in N m; x_dot is 0.0 in stick.
//
// The normal force is N = (M + m) g - m l (theta_dot^2 cos(theta) + theta_dot_dot sin(theta)): a
// pendulum that is fast while it is upright lifts the platform, in either direction. The guard
// brakes it before it is too fast.
template <class T>
INLINE T guarded_torque(T theta, T theta_dot, T x_dot, const auto& law, auto guard_from) {
  T torque =
      clip(law.torque_limit * gait_polynomial(theta, theta_dot, x_dot, law), T(law.torque_limit));
  T excess = theta_dot * theta_dot * sincos(theta).cos - guard_from;
  T brake = law.guard_gain * max(T(0.0), excess);
  return torque - select(theta_dot > 0.0, brake, -brake);
}

// The gait. Its guard estimates M while the platform slips and acts earlier on platforms lighter
// than `lightest` kg. Its memory is the estimator's.
struct Gait {
#define GUARDED_CONSTANTS(ONE, MANY) \
  GAIT_CONSTANTS(ONE, MANY)          \
  ONE(m)                             \
  ONE(l)                             \
  ONE(g)                             \
  ONE(lightest)                      \
  ONE(dt)
  CAPSULE_LAW(Gait, "gait", double, Estimator, NoReference, GUARDED_CONSTANTS)
  // Factor by which the guard's threshold falls faster than the weight of a lighter platform:
  // of 1.0, 1.2, 1.3 and 1.5 the first without a failure in 1000 episodes from the distribution of
  // `extrapolation`.
  static constexpr double CAUTION = 1.3;

  template <class T>
  INLINE T torque(const State<T>& s, Estimator<T>& estimator, const NoReference<T>&) const {
    update_estimator(estimator, s.theta, s.theta_dot, s.x_dot, *this);
    T missing = lightest - min(T(lightest), estimator.M);
    T share = 1.0 - CAUTION * missing / (lightest + m);
    return guarded_torque(s.theta, s.theta_dot, s.x_dot, *this, share * guard_from);
  }
};
}  // namespace LEVEL
