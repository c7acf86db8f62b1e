// Whole episodes of a trained policy, without Python between the steps.
#pragma once
#include "network.hpp"
#include "step.hpp"

namespace LEVEL {
// Steps the environments first..last-1 of `batch`, each until its episode ends, and returns as `advance`. `memory` is
// that of every environment; `changes` are rows of environment, time (s), M (kg) and mu, those of an environment in
// order of time.
template <int N>
long long run_blocks(const Batch& batch, long long first, long long last, long long steps, double control_dt,
                     const Network& network, Identification* memory, const double* changes, long long num_changes,
                     void* workspace) {
  for (long long at = first; at < last; at += N) {
    auto& block = *(Block<N>*)(batch.world + at / N * block_size<N>(batch));
    int n = last - at < N ? (int)(last - at) : N, going = n;
    // One more step than needed, so that the final state is that of a loop in Python.
    for (long long step = 0; step < steps && going > 0; step++) {
      going = 0;
      for (int j = 0; j < n; j++) going += (int)(block.active[j] = block.termination[j] == 0.0 ? 1.0 : 0.0);
      double actions[LANES];
      act(network, batch.observations, batch.entries, at, n, memory, workspace, actions);
      // Rounded to float32 like an action of the environment.
      for (int j = 0; j < n; j++) block.action[j] = (float)actions[j];
      for (long long k = 0; k < num_changes; k++) {
        const double* change = changes + 4 * k;
        long long j = (long long)change[0] - at;
        if (0 <= j && j < n && change[1] <= block.steps[j] * control_dt + 1e-9)
          block.M[j] = change[2], block.mu[j] = change[3];
      }
      long long broken = advance(batch, at, at + n, false);
      if (broken >= 0) return broken;
    }
  }
  return -1;
}

inline long long run_episodes(const Batch& batch, long long first, long long last, long long steps, double control_dt,
                              const double* packed, Identification* memory, const double* changes,
                              long long num_changes) {
  Network network(packed);
  void* workspace = __builtin_malloc(workspace_size(network, LANES));
  if (!workspace) return NO_MEMORY;
  auto run = batch.lanes == 1 ? run_blocks<1> : run_blocks<LANES>;
  long long broken = run(batch, first, last, steps, control_dt, network, memory, changes, num_changes, workspace);
  __builtin_free(workspace);
  return broken;
}
}  // namespace LEVEL
