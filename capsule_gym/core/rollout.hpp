// Whole episodes of a trained policy, without Python between the steps.
#pragma once
#include "network.hpp"
#include "step.hpp"

namespace LEVEL {
// Steps the environments first..last-1 of `batch`, each until its episode ends, and returns as `advance`. `memory` is
// that of every environment.
template <int N>
long long run_episodes(const Batch& batch, long long first, long long last, long long steps, const Network& network,
                       Identification* memory) {
  for (long long at = first; at < last; at += N) {
    auto& block = *(Block<N>*)(batch.world + at / N * block_size<N>(batch));
    int n = last - at < N ? (int)(last - at) : N, going = n;
    // One more step than needed, so that the final state is that of a loop in Python.
    for (long long step = 0; step < steps && going > 0; step++) {
      going = 0;
      for (int j = 0; j < n; j++) going += (int)(block.active[j] = block.termination[j] == 0.0 ? 1.0 : 0.0);
      float actions[N];
      act(network, batch.observations + at * batch.entries, batch.entries, n, memory + at, actions);
      for (int j = 0; j < n; j++) block.action[j] = actions[j];
      long long broken = advance(batch, at, at + n, false);
      if (broken >= 0) return broken;
    }
  }
  return -1;
}
}  // namespace LEVEL
