// Feedback linearisation (35) of the paper along a profile.
#pragma once
#include "law.hpp"

namespace LEVEL {
struct FeedbackLinearising {
#define FEEDBACK_CONSTANTS(ONE, MANY) \
  NOMINAL_CONSTANTS(ONE)              \
  ONE(K_p) /* 1/s^2 */                \
  ONE(K_v) /* 1/s */
  CAPSULE_LAW(FeedbackLinearising, "feedback_linearising", T, NoMemory, Reference,
              FEEDBACK_CONSTANTS)

  template <class T> INLINE T torque(const State<T>& s, NoMemory<T>&, const Reference<T>& r) const {
    auto plant = nominal_plant<T, Kind::extended>(*this);
    T a = r.theta_d_ddot - K_v * (s.theta_dot - r.theta_d_dot) - K_p * (s.theta - r.theta_d);
    // The actual friction: mu N sign(x') in slip, the reaction in stick.
    T limit = mu * max(T(0.0), plant.normal_force(s.theta, s.theta_dot, a));
    T reaction = min(limit, max(-limit, plant.driving_force(s.theta, s.theta_dot, a)));
    T friction = select(s.x_dot > 0.0, limit, select(s.x_dot < 0.0, -limit, reaction));
    auto [sin, cos] = sincos(s.theta);
    double ml = m * l;
    double total = M + m;
    T inertia = ml * l * (1.0 - m * cos * cos / total);
    T coupling = ml * cos * (ml * sin * s.theta_dot * s.theta_dot + friction) / total;
    return inertia * a + coupling - ml * g * sin + k * s.theta + c * s.theta_dot;  // Eq. (35)
  }
};
}  // namespace LEVEL
