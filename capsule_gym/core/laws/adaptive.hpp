// The adaptive variable-structure law (37) to (39) of the paper, with its misprints corrected.
//
// Symbols are those of the paper. With r for the (2n + 1)-th root of eta, (39d) is
// r' = r^2 delta_theta^2 (..) / ((2n + 1) (delta_theta^2 + beta)), which needs no power function.
#pragma once
#include "law.hpp"

namespace LEVEL {
constexpr double MOST_N = 1000.0;  // the largest n of the exponent in (39d)

// The estimates, the root of eta, and the start of x_d in m.
template <class T> struct AdaptiveMemory {
  T alpha_theta[5];
  T alpha_x[4];
  T root;
  T anchor;
};

// The nominal plant is that of the normal force in Y_x. The paper leaves open what follows the
// gains.
#define ADAPTIVE_CONSTANTS(ONE, MANY)                                                \
  NOMINAL_CONSTANTS(ONE)                                                             \
  ONE(Lambda_theta)                                                                  \
  ONE(Lambda_x)                                                                      \
  ONE(K1)                                                                            \
  ONE(K2)                                                                            \
  ONE(K3)                                                                            \
  ONE(Gamma_1)                                                                       \
  ONE(Gamma_2)                                                                       \
  ONE(beta)                                                                          \
  ONE(n)                                                                             \
  ONE(saturation_width) /* half width of what replaces sgn, rad/s; 0.0: sgn */       \
  ONE(root_bound)                                                                    \
  ONE(anchored)      /* 1.0 if x_d starts from the platform at every cycle */        \
  ONE(cycle_advance) /* distance that x_d covers in a cycle, m */                    \
  ONE(dt)            /* the law's period, s */                                       \
  MANY(lowest, 9)    /* bounds of the estimates: those of alpha_theta, of alpha_x */ \
  MANY(highest, 9)

struct Adaptive {
  CAPSULE_LAW(Adaptive, "adaptive", T, AdaptiveMemory, Reference, ADAPTIVE_CONSTANTS)

  // The torque (39a). (39d) and (39e) advance the memory by one Euler step of the law's period.
  template <class T>
  INLINE T torque(const State<T>& s, AdaptiveMemory<T>& memory, const Reference<T>& r) const {
    auto& [alpha_theta, alpha_x, root, anchor] = memory;
    T restart = anchored != 0.0 ? s.x : anchor + cycle_advance;
    anchor = select(r.cycle_start > 0.0, restart, anchor);
    T e = s.theta - r.theta_d;
    T e_dot = s.theta_dot - r.theta_d_dot;
    T e_x = s.x - (anchor + r.x_d);
    T e_x_dot = s.x_dot - r.x_d_dot;
    // Eq. (37a), which is printed without the tilde of the errors
    T rho_theta = r.theta_d_dot - Lambda_theta * e;
    T rho_theta_dot = r.theta_d_ddot - Lambda_theta * e_dot;
    T rho_x_dot = r.x_d_ddot - Lambda_x * e_x_dot;
    // Eq. (37b)
    T delta_theta = e_dot + Lambda_theta * e;
    T delta_x = e_x_dot + Lambda_x * e_x;

    // Eq. (38), with the sign that makes N = -Y alpha. The normal force contains theta'', which a
    // law cannot know before its torque acts; theta_d'' replaces it.
    auto [sin, cos] = sincos(s.theta);
    auto plant = nominal_plant<T, Kind::extended>(*this);
    T normal = max(T(0.0), plant.normal_force(s.theta, s.theta_dot, r.theta_d_ddot));
    T Y_theta[5] = {rho_theta_dot, -cos * rho_x_dot, s.theta, s.theta_dot, -sin};
    T Y_x[4] = {-cos * rho_theta_dot, rho_x_dot, normal * sign_of(s.x_dot),
                sin * s.theta_dot * rho_theta};

    T T_c = dot(Y_theta, alpha_theta) - K1 * delta_theta;  // Eq. (39b)
    T T_n = robust_torque(delta_theta, delta_x, dot(Y_x, alpha_x), root);
    adapt(alpha_theta, -dt * Gamma_1 * delta_theta, Y_theta, lowest, highest);
    adapt(alpha_x, -dt * Gamma_2 * delta_x, Y_x, lowest + 5, highest + 5);
    return T_c + T_n;
  }

 private:
  template <class T> static INLINE T clamp(T value, double low, double high) {
    return min(T(high), max(T(low), value));
  }

  template <class T, int size> static INLINE T dot(const T (&a)[size], const T (&b)[size]) {
    T sum = a[0] * b[0];
    for (int i = 1; i < size; i++) sum = sum + a[i] * b[i];
    return sum;
  }

  // T_n of Eq. (39c), from Y_x alpha_x; advances the root of eta.
  template <class T> INLINE T robust_torque(T delta_theta, T delta_x, T load, T& root) const {
    T eta = root;
    // `CoreLaw` accepts any number.
    for (double i = 0.0; i < n && i < MOST_N; i += 1.0) eta = eta * (root * root);
    T sgn = select(abs(delta_theta) < saturation_width, delta_theta / saturation_width,
                   sign_of(delta_theta));
    T share = delta_theta / (delta_theta * delta_theta + beta);
    T drift = K3 * delta_x * delta_x;
    T power = abs(delta_x * load);  // the norm encloses alpha^_x, as (41) needs it
    // Eq. (39d), with the norm
    T root_rate = root * root * delta_theta * share * (drift + power) / (2.0 * n + 1.0);
    root = clamp(root + dt * root_rate, 0.0, root_bound);
    T switching = -sgn * abs(delta_x) * (abs(eta) + K2);
    return switching - (eta + 1.0) * share * drift - (eta - 1.0) * share * power;
  }

  // An Euler step of Eq. (39e).
  template <class T, int size>
  static INLINE void adapt(T (&alpha)[size], T step, const T (&Y)[size], const double* low,
                           const double* high) {
    for (int i = 0; i < size; i++) alpha[i] = clamp(alpha[i] + step * Y[i], low[i], high[i]);
  }
};
}  // namespace LEVEL
