// Trajectories of one plant under torques that are constant over equal intervals, and their derivatives.
#pragma once
#include "contact.hpp"
#include "dual.hpp"

namespace LEVEL {
constexpr int DIRECTIONS = 8;  // of one pass of forward differentiation

// The inputs of a trajectory before its torques: constants as in `Capsule`, 1.0 for the paper's normal force, state.
#define CAPSULE_TRAJECTORY(FIELD)                                                                                      \
  FIELD(M) FIELD(mu) CAPSULE_CONSTANTS(FIELD) FIELD(paper) FIELD(theta) FIELD(theta_dot) FIELD(x) FIELD(x_dot)
template <class T> struct TrajectoryInputs { CAPSULE_TRAJECTORY(CAPSULE_NUMBER) };

INLINE void read(double& number, double value, const double*) { number = value; }
INLINE void read(Dual<DIRECTIONS>& number, double value, const double* partials) {
  number.v = value;
  __builtin_memcpy(&number.d, partials, sizeof number.d);
}
INLINE double value_of(double number) { return number; }
INLINE double value_of(const Dual<DIRECTIONS>& number) { return number.v; }
INLINE void write(double, double*) {}
INLINE void write(const Dual<DIRECTIONS>& number, double* partials) {
  __builtin_memcpy(partials, &number.d, sizeof number.d);
}

// Takes n intervals of `steps` integrator steps of h seconds. `values`: the inputs, then n torques in N m; `partials`:
// their derivatives along the directions, one row each. Writes theta, theta_dot, x, x_dot and the number of events so
// far at every end of an interval, n + 1 rows of `states`, and the derivatives of the state, `slopes`. Returns the
// interval in which the environment's episode would have terminated, or -1.
template <class T>
long long trajectory(const double* values, const double* partials, long long n, long long steps, double h,
                     double* states, double* slopes) {
  constexpr int SIZE = sizeof(TrajectoryInputs<double>) / sizeof(double);
  TrajectoryInputs<T> in;
  for (int i = 0; i < SIZE; i++) read(((T*)&in)[i], values[i], partials + DIRECTIONS * i);
#define FIELD(name) in.name,
  auto p = derive(Constants<T>{CAPSULE_CONSTANTS(FIELD)});
#undef FIELD
  p.M = in.M, p.mu = in.mu, p.mass_ratio = in.m / (in.M + in.m), p.pivot_torque_on_contact = values[SIZE - 5];
  State<T> s = {in.theta, in.theta_dot, in.x, in.x_dot};
  double events = 0.0;
  long long ended = -1;
  for (long long i = 0;; i++, states += 5, slopes += 4 * DIRECTIONS) {
    states[4] = events;
    for (int k = 0; k < 4; k++) {
      const T& number = ((const T*)&s)[k];
      states[k] = value_of(number);
      write(number, slopes + DIRECTIONS * k);
    }
    if (i == n) return ended;
    T u;
    read(u, values[SIZE + i], partials + DIRECTIONS * (SIZE + i));
    for (long long step = 0; step < steps; step++) {
      auto m = plant_step(s, u, p, T(h));
      s = m.end;
      events += value_of(m.events);
      bool goes_on = (abs(s.theta) < THETA_LIMIT) & (m.normal_force > 0.0);
      if (!goes_on && ended < 0) ended = i;
    }
  }
}
}  // namespace LEVEL
