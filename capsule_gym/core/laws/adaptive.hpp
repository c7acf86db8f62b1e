// The adaptive variable-structure law (37) to (39) of the paper, with its misprints corrected.
//
// Symbols are those of the paper. h and g are the estimates of alpha_theta and alpha_x. With r for
// the (2n + 1)-th root of eta, (39d) is r' = r^2 delta_theta^2 (..) / ((2n + 1) (delta_theta^2 +
// beta)), which needs no power function.
#pragma once
#include "law.hpp"

namespace LEVEL {
// The estimates, the root of eta, and the start of x_d in m.
template <class T> struct AdaptiveMemory {
  T h[5], g[4], root, anchor;
};

// The nominal plant, for the normal force in Y_x; the gains; and what the paper leaves open: beta,
// n, the half width in rad/s of the saturation that replaces sgn (0.0 for sgn itself), bounds of
// root and estimates, 1.0 if x_d starts from the platform at every cycle, the distance that x_d
// covers in a cycle in m, and the period in s.
#define ADAPTIVE_CONSTANTS(ONE, MANY) \
  NOMINAL_CONSTANTS(ONE)              \
  ONE(Lambda_theta)                   \
  ONE(Lambda_x)                       \
  ONE(K1)                             \
  ONE(K2)                             \
  ONE(K3)                             \
  ONE(Gamma_1)                        \
  ONE(Gamma_2)                        \
  ONE(beta)                           \
  ONE(n)                              \
  ONE(saturation_width)               \
  ONE(root_bound)                     \
  ONE(anchored)                       \
  ONE(cycle_advance)                  \
  ONE(dt)                             \
  MANY(lowest, 9)                     \
  MANY(highest, 9)

struct Adaptive {
  CAPSULE_LAW(Adaptive, "adaptive", T, AdaptiveMemory, Reference, ADAPTIVE_CONSTANTS)

  // The torque (39a). (39d) and (39e) advance the memory by one Euler step of the law's period.
  template <class T>
  INLINE T torque(const State<T>& s, AdaptiveMemory<T>& memory, const Reference<T>& r) const {
    auto& [h, g, root, anchor] = memory;
    const auto& [theta_d, theta_d_dot, theta_d_ddot, x_d, x_d_dot, x_d_ddot, cycle_start] = r;
    anchor = select(cycle_start > 0.0, q.anchored != 0.0 ? s.x : anchor + q.cycle_advance, anchor);
    T e = s.theta - theta_d, e_dot = s.theta_dot - theta_d_dot;
    T e_x = s.x - (anchor + x_d), e_x_dot = s.x_dot - x_d_dot;
    T rho_theta =
        theta_d_dot -
        q.Lambda_theta * e;  // Eq. (37a), which is printed without the tilde of the errors
    T rho_theta_dot = theta_d_ddot - q.Lambda_theta * e_dot,
      rho_x_dot = x_d_ddot - q.Lambda_x * e_x_dot;
    T delta_theta = e_dot + q.Lambda_theta * e, delta_x = e_x_dot + q.Lambda_x * e_x;  // Eq. (37b)

    // Y_theta and Y_x of Eq. (38), with the sign that makes N = -Y alpha. The normal force contains
    // theta'', which a law cannot know before its torque acts; theta_d'' replaces it.
    auto [sin, cos] = sincos(s.theta);
    auto p = nominal_plant<T, Kind::extended>(q);
    T normal = max(T(0.0), p.normal_force(s.theta, s.theta_dot, theta_d_ddot));
    T y[5] = {rho_theta_dot, -cos * rho_x_dot, s.theta, s.theta_dot, -sin};
    T z[4] = {-cos * rho_theta_dot, rho_x_dot, normal * sign_of(s.x_dot),
              sin * s.theta_dot * rho_theta};

    T T_c = y[0] * h[0] + y[1] * h[1] + y[2] * h[2] + y[3] * h[3] + y[4] * h[4] -
            q.K1 * delta_theta;  // Eq. (39b)
    T power = delta_x * (z[0] * g[0] + z[1] * g[1] + z[2] * g[2] + z[3] * g[3]);
    T eta = root;
    for (int i = 0; i < (int)q.n; i++) eta = eta * (root * root);
    T sgn = select(abs(delta_theta) < q.saturation_width, delta_theta / q.saturation_width,
                   sign_of(delta_theta));
    T share = delta_theta / (delta_theta * delta_theta + q.beta);
    T drift = q.K3 * delta_x * delta_x;
    T load = abs(power);  // the norm encloses alpha^_x, as (41) needs it
    // Eq. (39c)
    T T_n = -sgn * abs(delta_x) * (abs(eta) + q.K2) - (eta + 1.0) * share * drift -
            (eta - 1.0) * share * load;
    T root_rate = root * root * delta_theta * share * (drift + load) /
                  (2.0 * q.n + 1.0);  // Eq. (39d), with the norm

    auto clamp = [](T value, double low, double high) { return min(T(high), max(T(low), value)); };
    T s_1 = -q.dt * q.Gamma_1 * delta_theta, s_2 = -q.dt * q.Gamma_2 * delta_x;
    for (int i = 0; i < 5; i++)
      h[i] = clamp(h[i] + s_1 * y[i], q.lowest[i], q.highest[i]);  // Eq. (39e)
    for (int i = 0; i < 4; i++) g[i] = clamp(g[i] + s_2 * z[i], q.lowest[5 + i], q.highest[5 + i]);
    root = clamp(root + q.dt * root_rate, 0.0, q.root_bound);
    return T_c + T_n;
  }
};
}  // namespace LEVEL
