// The reference that the laws track: a cycle of the pendulum, and the motion of the nominal platform along it.
#pragma once
#include "../plant.hpp"

namespace LEVEL {

// A row of the reference table: rad and m with their derivatives, and 1.0 where a cycle begins.
template <class T> struct Reference {
  T theta_d, theta_d_dot, theta_d_ddot, x_d, x_d_dot, x_d_ddot, cycle_start;
};

// Moves a platform of total mass M + m for h seconds under a constant force in N, through a stop within this time, and
// returns x'' at the start in m/s^2. `forwards` and `backwards` are the kinetic friction in the two directions, N;
// x_dot is exactly 0.0 in stick.
inline double slide(double force, double forwards, double backwards, double static_ratio, double total, double& x,
                    double& x_dot, double h) {
  double initial = 0.0, remaining = h;
  // At most two parts: the slide until the platform stops, and the motion from rest.
  for (int part = 0; part < 2; part++) {
    bool at_rest = x_dot == 0.0, forward = at_rest ? force > 0.0 : x_dot > 0.0;
    double friction = forward ? forwards : backwards;
    if (at_rest && abs(force) <= static_ratio * friction) break;
    double x_ddot = (forward ? force - friction : force + friction) / total;
    if (part == 0) initial = x_ddot;
    double after = x_dot + remaining * x_ddot;
    if (x_dot * after >= 0.0) {
      x = x + remaining * (x_dot + 0.5 * remaining * x_ddot);
      x_dot = after;
      break;
    }
    x = x - 0.5 * x_dot * x_dot / x_ddot;
    remaining = remaining + x_dot / x_ddot;
    x_dot = 0.0;
  }
  return initial;
}

// The motion of the platform while the pendulum follows a prescribed motion: the second row of Eq. (1). The pendulum's
// angle, velocity and acceleration are given at every h seconds, n times. Writes x, x' and x'', shape (3, n), from rest
// at x = 0.
inline void platform_motion(const double* angle, const double* velocity, const double* acceleration, long long n,
                            double h, const double* plant, double* motion) {
  auto p = load<Plant<double, Kind::extended>>(plant);
  double x = 0.0, x_dot = 0.0;
  for (long long i = 0; i < n; i++) {
    double force = driving_force(angle[i], velocity[i], acceleration[i], p);
    double normal = max(0.0, normal_force(angle[i], velocity[i], acceleration[i], p));
    motion[i] = x, motion[n + i] = x_dot;
    motion[2 * n + i] = slide(force, kinetic_friction(1.0, p) * normal, kinetic_friction(-1.0, p) * normal,
                              p.static_ratio, p.M + p.m, x, x_dot, h);
  }
}

}  // namespace LEVEL
