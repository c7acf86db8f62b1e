// Periodic motions: tracking of a trajectory that is a function of time, and an oscillator that the
// state entrains.
#pragma once
#include "law.hpp"

namespace LEVEL {
// Tracking of a periodic trajectory: feedforward in N m, and gains in N m/rad and N m s/rad.
struct Tracking {
  template <class T> struct Trajectory {
    T theta_d, theta_d_dot, feedforward, K_theta, K_theta_dot;
  };
  CAPSULE_LAW(Tracking, "tracking", T, NoMemory, Trajectory, NO_CONSTANTS)

  template <class T>
  INLINE T torque(const State<T>& s, NoMemory<T>&, const Trajectory<T>& r) const {
    return r.feedforward - r.K_theta * (s.theta - r.theta_d) -
           r.K_theta_dot * (s.theta_dot - r.theta_d_dot);
  }
};

// A Hopf oscillator z = a + i b, z' = (alpha (1 - |z|^2) + i omega) z + E (theta, theta_dot,
// x_dot), in Euler steps of dt. The torque in N m is a real polynomial of third degree in z, plus a
// spring and a damper.
struct Oscillator {
  template <class T> struct Memory {
    T a, b;
  };
#define OSCILLATOR_CONSTANTS(ONE, MANY) \
  ONE(omega)                            \
  ONE(alpha)                            \
  MANY(E_a, 3)                          \
  MANY(E_b, 3)                          \
  ONE(bias)                             \
  MANY(real, 3)                         \
  MANY(imaginary, 3)                    \
  ONE(K_theta)                          \
  ONE(K_theta_dot)                      \
  ONE(dt)
  CAPSULE_LAW(Oscillator, "oscillator", T, Memory, NoReference, OSCILLATOR_CONSTANTS)
  // A strong impulse must not make the Euler steps diverge.
  static constexpr double AMPLITUDE_LIMIT = 3.0;

  template <class T> INLINE T torque(const State<T>& s, Memory<T>& z, const NoReference<T>&) const {
    T growth = alpha * (1.0 - z.a * z.a - z.b * z.b);
    auto entrain = [&s](T rate, const double* E) {
      return rate + E[0] * s.theta + E[1] * s.theta_dot + E[2] * s.x_dot;
    };
    T a_dot = entrain(growth * z.a - omega * z.b, E_a);
    T b_dot = entrain(growth * z.b + omega * z.a, E_b);
    z = {clip(z.a + dt * a_dot, T(AMPLITUDE_LIMIT)), clip(z.b + dt * b_dot, T(AMPLITUDE_LIMIT))};
    T torque = bias - K_theta * s.theta - K_theta_dot * s.theta_dot;
    Memory<T> power = {1.0, 0.0};
    for (int n = 0; n < 3; n++) {
      power = {power.a * z.a - power.b * z.b, power.a * z.b + power.b * z.a};
      torque = torque + real[n] * power.a + imaginary[n] * power.b;
    }
    return torque;
  }
};
}  // namespace LEVEL
