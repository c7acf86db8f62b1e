// A gait without a clock: the torque is a polynomial of the state, and a guard keeps the contact.
#pragma once
#include "../estimator.hpp"
#include "law.hpp"

namespace LEVEL {
// phi_ijk is the coefficient of theta^i theta_dot^j x_dot^k, each divided by its scale; then the
// step in the direction of slip, the guard's gain in N m s^2, and the theta_dot^2 cos(theta),
// 1/s^2, from which the guard acts; and the torque in N m that the polynomial is scaled by and
// clipped to.
#define GAIT_CONSTANTS(ONE, MANY) \
  ONE(phi_000)                    \
  ONE(phi_001)                    \
  ONE(phi_002)                    \
  ONE(phi_003)                    \
  ONE(phi_010)                    \
  ONE(phi_011)                    \
  ONE(phi_012)                    \
  ONE(phi_020)                    \
  ONE(phi_021)                    \
  ONE(phi_030)                    \
  ONE(phi_100)                    \
  ONE(phi_101)                    \
  ONE(phi_102)                    \
  ONE(phi_110)                    \
  ONE(phi_111)                    \
  ONE(phi_120)                    \
  ONE(phi_200)                    \
  ONE(phi_201)                    \
  ONE(phi_210)                    \
  ONE(phi_300)                    \
  ONE(sign_x_dot)                 \
  ONE(guard_gain)                 \
  ONE(guard_from)                 \
  ONE(torque_limit)
// Scales in rad, rad/s and m/s that make the polynomial's coefficients comparable.
constexpr double THETA_SCALE = 1.0, THETA_DOT_SCALE = 5.0, X_DOT_SCALE = 0.3;

// The cubic polynomial of the state plus a step in the direction of slip.
template <class T, class P> INLINE T cubic(T theta, T theta_dot, T x_dot, const P& p) {
  T a = theta / THETA_SCALE, b = theta_dot / THETA_DOT_SCALE, c = x_dot / X_DOT_SCALE;
  T aa = a * a, bb = b * b, cc = c * c;
  T torque = p.sign_x_dot * sign_of(x_dot) + p.phi_000 + p.phi_001 * c + p.phi_002 * cc +
             p.phi_003 * (cc * c);
  torque = torque + p.phi_010 * b + p.phi_011 * b * c + p.phi_012 * b * cc + p.phi_020 * bb +
           p.phi_021 * bb * c;
  torque = torque + p.phi_030 * (bb * b) + p.phi_100 * a + p.phi_101 * a * c + p.phi_102 * a * cc +
           p.phi_110 * a * b;
  torque =
      torque + p.phi_111 * a * b * c + p.phi_120 * a * bb + p.phi_200 * aa + p.phi_201 * aa * c;
  return torque + p.phi_210 * aa * b + p.phi_300 * (aa * a);
}

// The gait's torque within the limit, less the guard's, in N m; x_dot is 0.0 in stick.
//
// The normal force is N = (M + m) g - m l (theta_dot^2 cos(theta) + theta_dot_dot sin(theta)): a
// pendulum that is fast while it is upright lifts the platform, in either direction. The guard
// brakes it before it is too fast.
template <class T, class P, class F>
INLINE T guarded_torque(T theta, T theta_dot, T x_dot, const P& p, F guard_from, double limit) {
  T torque = clip(limit * cubic(theta, theta_dot, x_dot, p), T(limit));
  T brake = p.guard_gain * max(T(0.0), theta_dot * theta_dot * sincos(theta).cos - guard_from);
  return torque - select(theta_dot > 0.0, brake, -brake);
}

// The gait. Its guard estimates M while the platform slips and acts earlier on platforms lighter
// than `lightest` kg. Its memory is the estimator's.
struct Gait {
#define GUARDED_CONSTANTS(ONE, MANY) \
  GAIT_CONSTANTS(ONE, MANY) ONE(m)   \
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
    update_estimator(estimator, s.theta, s.theta_dot, s.x_dot, q);
    T share = 1.0 - CAUTION * (q.lightest - min(T(q.lightest), estimator.M)) / (q.lightest + q.m);
    return guarded_torque(s.theta, s.theta_dot, s.x_dot, q, share * q.guard_from, q.torque_limit);
  }
};
}  // namespace LEVEL
