// Trajectories of one plant under torques that are constant over equal intervals, and their
// derivatives.
#pragma once
#include "../numbers/dual.hpp"
#include "events.hpp"

namespace LEVEL {
// The inputs of a trajectory before its torques: constants as in `Capsule`, 1.0 for the paper's
// normal force, state.
#define CAPSULE_TRAJECTORY(FIELD) \
  FIELD(M)                        \
  FIELD(mu)                       \
  CAPSULE_CONSTANTS(FIELD) FIELD(paper) FIELD(theta) FIELD(theta_dot) FIELD(x) FIELD(x_dot)
template <class T> struct TrajectoryInputs {
  CAPSULE_TRAJECTORY(CAPSULE_NUMBER)
};

// Takes n intervals of `steps` integrator steps of h seconds. `values`: the inputs, then n torques
// in N m; `partials`, for dual numbers: their derivatives, one row each. Writes theta, theta_dot,
// x, x_dot and the number of events so far at every end of an interval, n + 1 rows of `states`, and
// the derivatives of the state, `slopes`. Returns the interval in which the environment's episode
// would have terminated, or -1.
template <class T>
long long trajectory(const double* values, const double* partials, long long n, long long steps,
                     double h, double* states, double* slopes) {
  constexpr int SIZE = WIDTH<TrajectoryInputs<double>>,
                N = sizeof(T) > sizeof(double) ? DIRECTIONS : 0;
  auto input = [&](long long i) {
    T number = values[i];
    if constexpr (N > 0) __builtin_memcpy(&number.d, partials + N * i, sizeof number.d);
    return number;
  };
  TrajectoryInputs<T> in;
  for (int i = 0; i < SIZE; i++) ((T*)&in)[i] = input(i);
  auto p = derive((const Constants<T>&)in.m);
  p.M = in.M, p.mu = in.mu, p.mass_ratio = p.m / (p.M + p.m),
  p.pivot_torque_on_contact = value(in.paper);
  auto s = (const State<T>&)in.theta;
  double events = 0.0;
  long long ended = -1;
  for (long long i = 0;; i++, states += 5) {
    states[4] = events;
    for (int k = 0; k < 4; k++, slopes += N) {
      const T& number = ((const T*)&s)[k];
      states[k] = value(number);
      if constexpr (N > 0) __builtin_memcpy(slopes, &number.d, sizeof number.d);
    }
    if (i == n) return ended;
    T u = input(SIZE + i);
    // A small velocity of a platform that would stick ends at once: the pendulum takes its
    // momentum.
    if (i == 0 && p.contact_phase(s, u) == 0.0)
      s.theta_dot = s.theta_dot - sincos(s.theta).cos / p.l * s.x_dot, s.x_dot = 0.0;
    for (long long step = 0; step < steps; step++) {
      // Most steps stay in one phase, and need less than `plant_step` computes.
      T slip = p.contact_phase(s, u);
      Stepped<T> r;
      bool lasts = slip == 0.0 ? smooth_step<true>(s, slip, u, p, h, r)
                               : smooth_step<false>(s, slip, u, p, h, r);
      double normal_force = value(r.first.normal);
      if (lasts) {
        s = r.end;
      } else {
        auto m = plant_step(s, u, p, T(h));
        s = m.end, normal_force = value(m.normal_force), events += value(m.events);
      }
      bool goes_on = (abs(s.theta) < THETA_LIMIT) & (normal_force > 0.0);
      if (!goes_on && ended < 0) ended = i;
    }
  }
}
}  // namespace LEVEL
