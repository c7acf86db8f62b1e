// The start of an episode: random draws and initial values.
#pragma once
#include "layout.hpp"
#include "random.hpp"

namespace LEVEL {
// How a number of the draw table follows from its share in [0, 1).
constexpr double UNIFORM = 0.0, SIGNED = 1.0, AROUND = 2.0, LOGARITHMIC = 3.0;

// The number at this share: at least `low` and within `range` above, where SIGNED with either sign; within +-`range`
// around `low`; or with its logarithm within `range` above that of `low`.
inline double number_at(double low, double range, double kind, double share) {
  double twice = 2.0 * share - 1.0;
  if (kind == UNIFORM) return low + range * share;
  if (kind == AROUND) return low + range * twice;
  if (kind == LOGARITHMIC) return low * exp(range * share);
  // Each half of [0, 1) stands for one sign.
  return copysign(low + range * abs(twice), twice);
}

// Draws the numbers of the next episodes of the first `count` environments in `rows` by the lines of the draw table.
// Returns the place of a row that names no environment, or -1.
inline long long draw_episodes(const Batch& b, long long count) {
  for (long long n = 0; n < count; n++) {
    long long i = b.rows[n];
    if (i < 0 || i >= b.num_envs) return n;
    for (long long k = 0; k < b.draw_lines; k++) {
      const double* line = b.draw_table + 6 * k;
      double share = draw(b.keys + 2 * i, (Word)line[1], (Word)b.episodes[i], (int)line[2]);
      b.drawn[k * b.num_envs + n] = number_at(line[3], line[4], line[5], share);
    }
  }
  return -1;
}

// Writes the initial values of the next episodes of these environments, and deactivates the others for one step.
template <int N> void begin_blocks(const Batch& b, long long count, long long size) {
  for (long long at = 0; at < b.num_envs; at += N)
    for (int j = 0; j < N; j++) ((Block<N>*)(b.world + at / N * size))->active[j] = 0.0;
  for (long long n = 0; n < count; n++) {
    long long i = b.rows[n];
    double* lane = b.world + i / N * size + i % N;
    auto& block = *(Block<N>*)(b.world + i / N * size);
    // The constants of varied plants are derived when their episode begins.
    long long plant = (double*)block.plant_m - (double*)&block, memory = sizeof(Block<N>) / 8;
    for (long long row = 0; row < plant; row += N) lane[row] = 0.0;
    for (long long row = memory; row < size; row += N) lane[row] = 0.0;
    for (long long cell = 0; cell < b.memory_size; cell++) lane[memory + cell * N] = b.memory[cell];
    for (long long k = 0; k < b.draw_lines; k++) lane[(long long)b.draw_table[6 * k] * N] = b.drawn[k * b.num_envs + n];
    int j = (int)(i % N);
    block.start_x[j] = block.x[j];
    block.smallest_normal_ratio[j] = INFINITE;
    block.largest_theta[j] = abs(block.theta[j]), block.largest_theta_dot[j] = abs(block.theta_dot[j]);
    block.normal_force[j] = (block.M[j] + b.settings->m) * b.settings->g;
    block.active[j] = 1.0;
    b.episodes[i]++;
  }
}

inline void begin_episodes(const Batch& b, long long count) {
  if (b.lanes == 1) begin_blocks<1>(b, count, block_size<1>(b));
  else begin_blocks<LANES>(b, count, block_size<LANES>(b));
}
}  // namespace LEVEL
