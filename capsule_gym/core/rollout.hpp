// Whole episodes of a trained policy, without Python between the steps.
#pragma once
#include "network.hpp"
#include "step.hpp"

namespace LEVEL {

struct Rollout {
  const Batch& batch;
  const Network& network;
  Identification* memory;  // of every environment
  void* workspace;
  // Rows of environment, time (s), M (kg) and mu, those of an environment in order of time.
  const double* changes;
  long long num_changes, steps;
  double control_dt;  // s
};

// Steps the environments first..last-1, each until its episode ends; returns as `advance`.
template <class T, int N> long long run_blocks(const Rollout& r, long long first, long long last) {
  for (long long at = first; at < last; at += N) {
    auto& block = *(Block<N>*)(r.batch.world + at / N * block_size<N>(r.batch));
    int n = last - at < N ? (int)(last - at) : N;
    for (long long step = 0; step < r.steps; step++) {
      int going = 0;
      for (int j = 0; j < n; j++) going += (int)(block.active[j] = block.termination[j] == 0.0 ? 1.0 : 0.0);
      double actions[LANES];
      act<T>(r.network, r.batch.observations, r.batch.entries, at, n, r.memory, r.workspace, actions);
      // Rounded to float32 like an action of the environment.
      for (int j = 0; j < n; j++) block.action[j] = (float)actions[j];
      for (long long k = 0; k < r.num_changes; k++) {
        const double* change = r.changes + 4 * k;
        long long j = (long long)change[0] - at;
        if (0 <= j && j < n && change[1] <= block.steps[j] * r.control_dt + 1e-9)
          block.M[j] = change[2], block.mu[j] = change[3];
      }
      long long broken = advance(r.batch, at, at + n, false);
      if (broken >= 0) return broken;
      // One more step than needed, so that the final state is that of a loop in Python.
      if (going == 0) break;
    }
  }
  return -1;
}

inline long long run_episodes(const Rollout& r, long long first, long long last) {
  return r.batch.lanes == 1 ? run_blocks<Pack, 1>(r, first, last) : run_blocks<Pack, LANES>(r, first, last);
}

}  // namespace LEVEL
