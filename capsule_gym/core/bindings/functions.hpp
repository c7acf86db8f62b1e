// Functions over arrays and over whole episodes: for Python.
#pragma once
#include "../network.hpp"
#include "../step/resets.hpp"
#include "../step/contract.hpp"
#include "../step/step.hpp"
#include "levels.hpp"

namespace LEVEL {
// The most general plant: one compiled function serves all.
using AnyPlant = Plant<double, Kind::extended>;
constexpr int MOST_RESULTS = WIDTH<AnyPlant>;  // of a function that `evaluate` knows

// Evaluates f(a, p) with the arguments a[0], a[1], .. and the plant p at n places: `in`, shape (n, arguments), begins
// with M and mu where a plant is given; `out` has the shape (results, n). Returns the number of results.
template <class F>
long long evaluate_each(const double* in, long long arguments, double* out, long long n, const AnyPlant* plant, F f) {
  using Results = decltype(f(in, *plant));
  static_assert(WIDTH<Results> <= MOST_RESULTS);
  for (long long i = 0; i < n; i++) {
    const double* a = in + i * arguments;
    AnyPlant p = {};
    if (plant) p = *plant, p.M = *a++, p.mu = *a++, p.mass_ratio = p.m / (p.M + p.m);
    Results found = f(a, p);
    for (int k = 0; k < WIDTH<Results>; k++) out[k * n + i] = ((const double*)&found)[k];
  }
  return WIDTH<Results>;
}

// Evaluates a function by its name; returns UNKNOWN if there is none.
inline long long evaluate(const char* name, const double* in, long long arguments, double* out, long long n,
                          const AnyPlant* plant) {
#define FUNCTION(function, call)                                                                                 \
  if (!__builtin_strcmp(name, #function))                                                                        \
    return evaluate_each(in, arguments, out, n, plant, []([[maybe_unused]] const double* a,                      \
                                                          [[maybe_unused]] const AnyPlant& p) { return call; });
  FUNCTION(accelerations, p.accelerations(a[0], a[1], a[2], a[3], a[4]))
  FUNCTION(normal_force, p.normal_force(a[0], a[1], a[2]))
  FUNCTION(driving_force, p.driving_force(a[0], a[1], a[2]))
  FUNCTION(friction_force, p.friction_force(a[0], a[1], a[2]))
  FUNCTION(stick_margin, p.stick_margin(a[0], a[1], a[2]))
  FUNCTION(contact_phase, p.contact_phase(State<double>{a[0], a[1], 0.0, a[2]}, a[3]))
  FUNCTION(step, plant_step(State<double>{a[0], a[1], a[2], a[3]}, a[4], p, a[5]))
  FUNCTION(sincos, sincos(a[0]))
  FUNCTION(exp, exp(a[0]))
  FUNCTION(tanh, tanh(a[0]))
  FUNCTION(log, log(a[0]))
  FUNCTION(derive, derive(*(const Constants<double>*)a))
  FUNCTION(normals, normals(scramble(bits_of(a[0]))))
  FUNCTION(number_at, number_at(a[0], a[1], a[2], a[3]))
  FUNCTION(goal_rate, Goal::rate(a[0], a[1]))
#undef FUNCTION
  return UNKNOWN;
}

// The torques of n calls of a law of the core, from arrays of shape (n, numbers): the state, the memory, which is
// replaced, and the row of the reference with the task's memory.
inline void law_torques(long long number, const double* constants, const State<double>* states, double* memory,
                        const double* rows, double* torques, long long n) {
  with_type(Laws(), number, [=]<class Law>() {
    Law law(constants);
    auto* cells = (typename Law::template Cells<double>*)memory;
    auto* lines = (const typename Law::template Line<double>*)rows;
    for (long long i = 0; i < n; i++) torques[i] = law.torque(states[i], cells[i], lines[i]);
  });
}

// The motion of the platform while the pendulum follows a prescribed motion: the second row of Eq. (1). The pendulum's
// angle, velocity and acceleration are given at every h seconds, n times. Writes x, x' and x'', shape (3, n), from rest
// at x = 0; x' is exactly 0.0 in stick.
//
// The step is not used, only its functions for the forces: with theta'' given, nothing is left to solve. The forces are
// constant over an interval; viscous friction and the Stribeck curve, which depend on x', are left out.
inline void platform_motion(const double* angle, const double* velocity, const double* acceleration, long long n,
                            double h, const AnyPlant& plant, double* motion) {
  AnyPlant p = plant;
  p.stribeck_excess = 0.0;  // without the Stribeck curve
  double x = 0.0, x_dot = 0.0;
  for (long long i = 0; i < n; i++) {
    double force = p.driving_force(angle[i], velocity[i], acceleration[i]), remaining = h;
    double normal = max(0.0, p.normal_force(angle[i], velocity[i], acceleration[i]));
    motion[i] = x, motion[n + i] = x_dot, motion[2 * n + i] = 0.0;
    // At most two parts: the slide until the platform stops, and the motion from rest.
    for (int part = 0; part < 2; part++) {
      if (x_dot == 0.0 && abs(force) <= p.static_friction_limit(force, normal)) break;
      double direction = x_dot == 0.0 ? force : x_dot;
      double slip = direction > 0.0 ? 1.0 : -1.0;
      double x_ddot = (force - p.friction_force(slip, x_dot, normal)) / (p.M + p.m);
      if (part == 0) motion[2 * n + i] = x_ddot;
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
  }
}

// Steps the environments first..last-1 of `batch` with a trained policy, each until its episode ends, without Python
// between the steps, and returns as `advance`.
template <int N>
long long run_episodes(const Batch& batch, long long first, long long last, long long steps, const double* network) {
  for (long long at = first; at < last; at += N) {
    auto& block = block_of<N>(batch, at);
    int n = last - at < N ? (int)(last - at) : N, going = n;
    // One more step than needed, so that the final state is that of a loop in Python.
    for (long long step = 0; step < steps && going > 0; step++) {
      going = 0;
      for (int j = 0; j < n; j++) going += (int)(block.active[j] = block.termination[j] == 0.0 ? 1.0 : 0.0);
      float actions[N];
      act(network, batch.observations + at * batch.layout->entries, n, actions);
      for (int j = 0; j < n; j++) block.action[j] = actions[j];
      long long broken = advance(batch, at, at + n, false);
      if (broken >= 0) return broken;
    }
  }
  return -1;
}
}  // namespace LEVEL
