// The start of an episode: random draws and initial values.
#pragma once
#include "../numbers/random.hpp"
#include "../tasks/task.hpp"
#include "layout.hpp"

namespace LEVEL {
// The number at a share, in [0, 1), of the range of a draw.
inline double number_at(double share, double low, double range, double distribution) {
  double twice = 2.0 * share - 1.0;
  if (distribution == CENTRED) return low + range * twice;
  if (distribution == LOGARITHMIC) return low * exp(range * share);
  // Each half of [0, 1) stands for one sign.
  if (distribution == SIGNED) return copysign(low + range * abs(twice), twice);
  return low + range * share;
}

// Draws the numbers with which the next episodes of the first `count` environments in `rows` begin.
// Returns the place of a row that names no environment, or -1.
inline long long draw_episodes(const Batch& batch, long long count) {
  for (long long n = 0; n < count; n++) {
    long long i = batch.rows[n];
    if (i < 0 || i >= batch.num_envs) return n;
    const Word* key = batch.keys + 2 * i;
    for (long long k = 0; k < batch.layout->draws; k++) {
      const Draw& line = batch.draw_table[k];
      // Most lines are constants.
      bool varies = line.range != 0.0 || line.distribution == SIGNED;
      double share = 0.0;
      if (varies) share = draw(key, (Word)line.stream, (Word)batch.episodes[i], (int)line.place);
      batch.drawn[k * batch.num_envs + n] =
          number_at(share, line.low, line.range, line.distribution);
    }
  }
  return -1;
}

// Writes the initial values of the next episodes of these environments, and deactivates the others
// for one step.
template <int N> void begin_episodes(const Batch& batch, long long count) {
  const Layout& layout = *batch.layout;
  for (long long at = 0; at < batch.num_envs; at += N)
    for (int j = 0; j < N; j++) block_of<N>(batch, at).active[j] = 0.0;
  for (long long n = 0; n < count; n++) {
    long long i = batch.rows[n];
    long long j = i % N;
    auto& b = block_of<N>(batch, i);
    double* lane = (double*)&b + j;
    // The constants of varied plants are derived when their episode begins.
    for (long long row = 0; row < ROW_OF(plant_m); row++) lane[row * N] = 0.0;
    for (long long row = ROW_OF(readings); row < layout.rows; row++) lane[row * N] = 0.0;
    for (long long cell = 0; cell < layout.memory_size(); cell++)
      lane[(layout.law_memory + cell) * N] = batch.memory[cell];
    for (long long k = 0; k < layout.draws; k++)
      lane[(long long)batch.draw_table[k].row * N] = batch.drawn[k * batch.num_envs + n];
    b.start_x[j] = b.x[j];
    b.smallest_normal_ratio[j] = INFINITE;
    b.largest_theta[j] = abs(b.theta[j]);
    b.largest_theta_dot[j] = abs(b.theta_dot[j]);
    b.normal_force[j] = (b.M[j] + batch.settings->m) * batch.settings->g;
    b.active[j] = 1.0;
    batch.episodes[i]++;
  }
}
}  // namespace LEVEL
