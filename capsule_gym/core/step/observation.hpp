// The observation: its entries in order, the estimates of M and mu in it, and the stack of
// observations.
#pragma once
#include "../tasks/tasks.hpp"
#include "layout.hpp"

namespace LEVEL {
// What an observation shows of the environment.
#define OBSERVED(FIELD)                             \
  FIELD(theta)                                      \
  FIELD(theta_dot)                                  \
  FIELD(x_dot)                                      \
  FIELD(action)                                     \
  FIELD(theta_d)                                    \
  FIELD(theta_d_dot)                                \
  FIELD(phase) /* share of the reference's cycle */ \
  FIELD(law_torque)                                 \
  FIELD(M)                                          \
  FIELD(mu)
template <class T> struct Observed {
  OBSERVED(CAPSULE_NUMBER)
};

// What the estimator of M and mu assumes.
struct Pendulum {
  double m, l, g, dt;
};
INLINE Pendulum assumed_pendulum(const Settings& settings) {
  return {settings.m, settings.l, settings.g, settings.control_dt()};
}

// Puts the entries in their order, each as put(name, low, high, value) with the bounds to which it
// is clipped. `estimate` returns the estimator of M and mu after this observation.
template <class Task, class T>
INLINE void put_entries(const Settings& settings, const Observed<T>& o,
                        const typename Task::template Memory<T>& memory, auto put, auto estimate) {
  // Clipped to +-limit.
  auto put_clipped = [&](const char* name, double limit, T value) __attribute__((always_inline)) {
    put(name, -limit, limit, clip(value, T(limit)));
  };
  put_clipped("theta", THETA_LIMIT, o.theta);
  put_clipped("theta_dot", THETA_DOT_BOUND, o.theta_dot);
  put_clipped("x_dot", X_DOT_BOUND, o.x_dot);
  double rest = settings.agent_reads != 0.0 ? settings.stick_threshold : 0.0;
  put("stick", 0.0, 1.0, select(abs(o.x_dot) <= rest, T(1.0), T(0.0)));
  put("last_action", -1.0, 1.0, o.action);
  if (settings.with_reference != 0.0) {
    put_clipped("theta_d", THETA_LIMIT, o.theta_d);
    put_clipped("theta_d_dot", THETA_DOT_BOUND, o.theta_d_dot);
    auto [sin, cos] = sincos(2.0 * PI * o.phase);
    put("sin_phase", -1.0, 1.0, sin);
    put("cos_phase", -1.0, 1.0, cos);
    put("law_torque", -settings.torque_limit, settings.torque_limit, o.law_torque);
  }
  if (settings.with_parameters != 0.0) {
    put("M", 0.0, settings.M_bound, o.M);
    put("mu", 0.0, settings.mu_bound, o.mu);
  }
  if (settings.with_estimates != 0.0) {
    using E = Estimator<double>;
    Estimator<T> e = estimate();
    put("M_estimate", E::LOW_M, E::HIGH_M, e.M);
    put("log_mu_estimate", E::LOW_LOG_MU, E::HIGH_LOG_MU, e.log_mu);
    put("M_deviation", 0.0, E::DEVIATION_M, deviation(e.P_MM));
    put("log_mu_deviation", 0.0, E::DEVIATION_LOG_MU, deviation(e.P_ff));
  }
  if (settings.with_task != 0.0) Task::observe(memory, put);
}

// Writes the observations of the first n environments of a block. `line`: that of the reference;
// `task`: the task's memory with the values that the agent observes; `estimators`: the rows of the
// estimators of M and mu.
template <class Task, int N>
NOINLINE void observe(const Batch& batch, const Block<N>& b, int n, const double* line,
                      const double* task, double* estimators, float* observations, bool begin) {
  const Settings& settings = *batch.settings;
  int all = (int)batch.layout->entries;
  int entries = all / (int)settings.stack_size;
  bool reads = settings.agent_reads != 0.0;
  for (int j = 0; j < n; j++) {
    if (b.active[j] == 0.0) continue;
    float* out = observations + j * all;
    // Shifts the stacked observations; at the start of an episode all of them are the first.
    for (int entry = all - 1; entry >= entries; entry--) out[entry] = out[entry - entries];
    Observed<double> seen = {
        .theta = reads ? b.read_theta[j] : b.theta[j],
        .theta_dot = reads ? b.read_theta_dot[j] : b.theta_dot[j],
        .x_dot = reads ? b.read_x_dot[j] : b.x_dot[j],
        .action = begin ? 0.0 : b.action[j],
        .theta_d = line[j],
        .theta_d_dot = line[N + j],
        .phase = b.clock[j] / (double)batch.reference_rows,
        .law_torque = b.law_torque[j],
        .M = b.M[j],
        .mu = b.mu[j],
    };
    auto memory = load_record<typename Task::template Memory<double>, double, N>(task, j);
    float* next = out;
    auto write = [&](const char*, double, double, double entry)
                     __attribute__((always_inline)) { *next++ = (float)entry; };
    auto estimate = [&]() __attribute__((noinline)) {
      auto e = load_record<Estimator<double>, double, N>(estimators, j);
      update_estimator<double>(e, out[0], out[1], out[2], assumed_pendulum(settings));
      store_record<double, N>(estimators, j, e);
      return e;
    };
    put_entries<Task>(settings, seen, memory, write, estimate);
    if (begin)
      for (int entry = entries; entry < all; entry++) out[entry] = out[entry - entries];
  }
}
}  // namespace LEVEL
