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
inline long long draw_episodes(const Batch& b, long long count) {
  for (long long n = 0; n < count; n++) {
    long long i = b.rows[n];
    if (i < 0 || i >= b.num_envs) return n;
    for (long long k = 0; k < b.layout->draws; k++) {
      const Draw& line = b.draw_table[k];
      // Most lines are constants.
      bool varies = line.range != 0.0 || line.distribution == SIGNED;
      double share =
          varies ? draw(b.keys + 2 * i, (Word)line.stream, (Word)b.episodes[i], (int)line.place)
                 : 0.0;
      b.drawn[k * b.num_envs + n] = number_at(share, line.low, line.range, line.distribution);
    }
  }
  return -1;
}

// Writes the initial values of the next episodes of these environments, and deactivates the others
// for one step.
template <int N> void begin_episodes(const Batch& b, long long count) {
  for (long long at = 0; at < b.num_envs; at += N)
    for (int j = 0; j < N; j++) block_of<N>(b, at).active[j] = 0.0;
  for (long long n = 0; n < count; n++) {
    long long i = b.rows[n], j = i % N;
    auto& block = block_of<N>(b, i);
    double* lane = (double*)&block + j;
    // The constants of varied plants are derived when their episode begins.
    long long plant = (block.plant_m - (double*)&block) / N,
              readings = (block.readings - (double*)&block) / N;
    for (long long row = 0; row < plant; row++) lane[row * N] = 0.0;
    for (long long row = readings; row < b.layout->rows; row++) lane[row * N] = 0.0;
    for (long long cell = 0; cell < b.layout->memory_size(); cell++)
      lane[(b.layout->law_memory + cell) * N] = b.memory[cell];
    for (long long k = 0; k < b.layout->draws; k++)
      lane[(long long)b.draw_table[k].row * N] = b.drawn[k * b.num_envs + n];
    block.start_x[j] = block.x[j];
    block.smallest_normal_ratio[j] = INFINITE;
    block.largest_theta[j] = abs(block.theta[j]),
    block.largest_theta_dot[j] = abs(block.theta_dot[j]);
    block.normal_force[j] = (block.M[j] + b.settings->m) * b.settings->g;
    block.active[j] = 1.0;
    b.episodes[i]++;
  }
}
}  // namespace LEVEL
