// The observation: its entries in order, the estimates of M and mu in it, and the stack of observations.
#pragma once
#include "../tasks/tasks.hpp"
#include "layout.hpp"

namespace LEVEL {
// What an observation shows of the environment: `phase` is the share of the reference's cycle.
#define OBSERVED(FIELD)                                                                                    \
  FIELD(theta) FIELD(theta_dot) FIELD(x_dot) FIELD(action) FIELD(theta_d) FIELD(theta_d_dot) FIELD(phase)  \
  FIELD(law_torque) FIELD(M) FIELD(mu)
template <class T> struct Observed { OBSERVED(CAPSULE_NUMBER) };

// What the estimator of M and mu assumes.
struct Pendulum { double m, l, g, dt; };
INLINE Pendulum assumed_pendulum(const Settings& q) { return {q.m, q.l, q.g, q.control_dt()}; }

// Puts the entries in the order of `observation_entries`; `estimate` returns the estimator of M and mu after this
// observation.
template <class Task, class T, class Put, class Estimate>
INLINE void put_entries(const Settings& q, const Observed<T>& o, const typename Task::template Memory<T>& memory,
                        Put put, Estimate estimate) {
  put(clip(o.theta, T(THETA_LIMIT))), put(clip(o.theta_dot, T(THETA_DOT_BOUND))), put(clip(o.x_dot, T(X_DOT_BOUND)));
  double rest = q.agent_reads != 0.0 ? q.stick_threshold : 0.0;
  put(select(abs(o.x_dot) <= rest, T(1.0), T(0.0))), put(o.action);
  if (q.with_reference != 0.0) {
    auto [sin, cos] = sincos(2.0 * PI * o.phase);
    put(clip(o.theta_d, T(THETA_LIMIT))), put(clip(o.theta_d_dot, T(THETA_DOT_BOUND)));
    put(sin), put(cos), put(o.law_torque);
  }
  if (q.with_parameters != 0.0) put(o.M), put(o.mu);
  if (q.with_estimates != 0.0) {
    Estimator<T> e = estimate();
    put(e.M), put(e.log_mu), put(deviation(e.P_MM)), put(deviation(e.P_ff));
  }
  if (q.with_task != 0.0) Task::observe(memory, put);
}

// Writes the observations of the first n environments of a block. `line`: that of the reference; `task`: the task's
// memory with the values that the agent observes; `estimators`: the rows of the estimators of M and mu.
template <class Task, int N>
NOINLINE void observe(const Batch& batch, const Block<N>& b, int n, const double* line, const double* task,
                      double* estimators, float* observations, bool begin) {
  const Settings& q = *batch.settings;
  int entries = (int)batch.entries / (int)q.stack_size, all = (int)batch.entries;
  bool reads = q.agent_reads != 0.0;
  for (int j = 0; j < n; j++) {
    if (b.active[j] == 0.0) continue;
    float* out = observations + j * batch.entries;
    // Shifts the stacked observations; at the start of an episode all of them are the first.
    for (int entry = all - 1; entry >= entries; entry--) out[entry] = out[entry - entries];
    Observed<double> seen = {reads ? b.read_theta[j] : b.theta[j], reads ? b.read_theta_dot[j] : b.theta_dot[j],
                             reads ? b.read_x_dot[j] : b.x_dot[j], begin ? 0.0 : b.action[j], line[j], line[N + j],
                             b.clock[j] / (double)batch.reference_rows, b.law_torque[j], b.M[j], b.mu[j]};
    float* next = out;
    put_entries<Task>(
        q, seen, load_record<typename Task::template Memory<double>, double, N>(task, j),
        [&](double entry) { *next++ = (float)entry; },
        [&]() __attribute__((noinline)) {
          auto e = load_record<Estimator<double>, double, N>(estimators, j);
          update_estimator<double>(e, out[0], out[1], out[2], assumed_pendulum(q));
          store_record<double, N>(estimators, j, e);
          return e;
        });
    if (begin)
      for (int entry = entries; entry < all; entry++) out[entry] = out[entry - entries];
  }
}
}  // namespace LEVEL
