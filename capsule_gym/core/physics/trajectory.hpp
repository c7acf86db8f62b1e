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
  CAPSULE_CONSTANTS(FIELD)        \
  FIELD(paper)                    \
  FIELD(theta)                    \
  FIELD(theta_dot)                \
  FIELD(x)                        \
  FIELD(x_dot)
template <class T> struct TrajectoryInputs {
  CAPSULE_TRAJECTORY(CAPSULE_NUMBER)
};

// The derivatives of a number: none of a double.
template <class T> constexpr int PARTIALS = sizeof(T) > sizeof(double) ? DIRECTIONS : 0;

// Number i of `values`, with its derivatives from row i of `partials`.
template <class T> T read_number(const double* values, const double* partials, long long i) {
  T number = values[i];
  if constexpr (PARTIALS<T> > 0)
    __builtin_memcpy(&number.d, partials + PARTIALS<T> * i, sizeof number.d);
  return number;
}

template <class T> void write_state(const State<T>& s, double* state, double* slopes) {
  for (int k = 0; k < WIDTH<State<double>>; k++) {
    const T& number = ((const T*)&s)[k];
    state[k] = value(number);
    if constexpr (PARTIALS<T> > 0)
      __builtin_memcpy(slopes + PARTIALS<T> * k, &number.d, sizeof number.d);
  }
}

// Takes `steps` integrator steps of h seconds, and counts the events. Returns whether the
// environment's episode would have gone on.
template <class T, class P>
bool take_interval(State<T>& s, T u, const P& p, long long steps, double h, double& events) {
  bool goes_on = true;
  for (long long step = 0; step < steps; step++) {
    // Most steps stay in one phase, and need less than `plant_step` computes.
    T slip = p.contact_phase(s, u);
    Stepped<T> r;
    bool lasts = slip == 0.0 ? smooth_step<true>(s, slip, u, p, T(h), r)
                             : smooth_step<false>(s, slip, u, p, T(h), r);
    double normal_force = value(r.first.normal);
    if (lasts) {
      s = r.end;
    } else {
      auto m = plant_step(s, u, p, T(h));
      s = m.end;
      normal_force = value(m.normal_force);
      events += value(m.events);
    }
    goes_on &= (abs(s.theta) < THETA_LIMIT) & (normal_force > 0.0);
  }
  return goes_on;
}

// Takes n intervals of `steps` integrator steps of h seconds. `values`: the inputs, then n torques
// in N m; `partials`, for dual numbers: their derivatives, one row each. Writes theta, theta_dot,
// x, x_dot and the number of events so far at every end of an interval, n + 1 rows of `states`, and
// the derivatives of the state, `slopes`. Returns the interval in which the environment's episode
// would have terminated, or -1.
template <class T>
long long trajectory(const double* values, const double* partials, long long n, long long steps,
                     double h, double* states, double* slopes) {
  constexpr int SIZE = WIDTH<TrajectoryInputs<double>>;
  TrajectoryInputs<T> in;
  for (int i = 0; i < SIZE; i++) ((T*)&in)[i] = read_number<T>(values, partials, i);
  auto p = derive((const Constants<T>&)in.m);
  p.M = in.M;
  p.mu = in.mu;
  p.mass_ratio = p.m / (p.M + p.m);
  p.pivot_torque_on_contact = value(in.paper);
  auto s = (const State<T>&)in.theta;
  double events = 0.0;
  long long ended = -1;
  for (long long i = 0; i <= n; i++) {
    double* row = states + 5 * i;
    write_state(s, row, slopes + 4 * PARTIALS<T> * i);
    row[4] = events;
    if (i == n) break;
    T u = read_number<T>(values, partials, SIZE + i);
    // A small velocity of a platform that would stick ends at once: the pendulum takes its
    // momentum.
    if (i == 0 && p.contact_phase(s, u) == 0.0) {
      s.theta_dot = s.theta_dot - sincos(s.theta).cos / p.l * s.x_dot;
      s.x_dot = 0.0;
    }
    bool goes_on = take_interval(s, u, p, steps, h, events);
    if (!goes_on && ended < 0) ended = i;
  }
  return ended;
}
}  // namespace LEVEL
