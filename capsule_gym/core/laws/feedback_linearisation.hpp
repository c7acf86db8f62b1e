// Feedback linearisation (35) of the paper along a profile.
#pragma once
#include "law.hpp"

namespace LEVEL {
struct FeedbackLinearising {
  // K_p in 1/s^2, K_v in 1/s.
#define FEEDBACK_CONSTANTS(ONE, MANY) \
  NOMINAL_CONSTANTS(ONE) ONE(K_p)     \
  ONE(K_v)
  CAPSULE_LAW(FeedbackLinearising, "feedback_linearising", T, NoMemory, Reference,
              FEEDBACK_CONSTANTS)

  // With f the actual friction force: mu N sign(x') in slip, the reaction in stick.
  template <class T> INLINE T torque(const State<T>& s, NoMemory<T>&, const Reference<T>& r) const {
    auto p = nominal_plant<T, Kind::extended>(q);
    T a = r.theta_d_ddot - q.K_v * (s.theta_dot - r.theta_d_dot) - q.K_p * (s.theta - r.theta_d);
    auto [sin, cos] = sincos(s.theta);
    T force = p.driving_force(s.theta, s.theta_dot, a);
    T limit = q.mu * max(T(0.0), p.normal_force(s.theta, s.theta_dot, a));
    T reaction = min(limit, max(-limit, force));
    T f = select(s.x_dot > 0.0, limit, select(s.x_dot < 0.0, -limit, reaction));
    double ml = q.m * q.l, total = q.M + q.m;
    T inertia = ml * q.l * (1.0 - q.m * cos * cos / total);
    T coupling = ml * cos * (ml * sin * s.theta_dot * s.theta_dot + f) / total;
    return inertia * a + coupling - ml * q.g * sin + q.k * s.theta + q.c * s.theta_dot;  // Eq. (35)
  }
};
}  // namespace LEVEL
