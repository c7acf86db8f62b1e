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
  static constexpr double LARGEST = 3.0;

  template <class T> INLINE T torque(const State<T>& s, Memory<T>& z, const NoReference<T>&) const {
    T rate = q.alpha * (1.0 - z.a * z.a - z.b * z.b);
    T a_dot = rate * z.a - q.omega * z.b + q.E_a[0] * s.theta + q.E_a[1] * s.theta_dot +
              q.E_a[2] * s.x_dot;
    T b_dot = rate * z.b + q.omega * z.a + q.E_b[0] * s.theta + q.E_b[1] * s.theta_dot +
              q.E_b[2] * s.x_dot;
    z = {clip(z.a + q.dt * a_dot, T(LARGEST)), clip(z.b + q.dt * b_dot, T(LARGEST))};
    T u = q.bias - q.K_theta * s.theta - q.K_theta_dot * s.theta_dot, a = 1.0, b = 0.0;
    for (int n = 0; n < 3; n++) {
      T next = a * z.a - b * z.b;
      b = a * z.b + b * z.a, a = next;
      u = u + q.real[n] * a + q.imaginary[n] * b;
    }
    return u;
  }
};
}  // namespace LEVEL
