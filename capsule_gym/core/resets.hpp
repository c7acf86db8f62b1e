// The start of an episode: random draws and initial values.
#pragma once
#include "layout.hpp"
#include "random.hpp"

namespace LEVEL {
// M in kg and mu at these shares, in [0, 1), of their ranges, or of the range of log(mu) where that is drawn. `ranges`:
// lowest M, width of its range, lowest mu, width of its range, and width of the range of log(mu), or 0.
inline Two<double> plant_at(const double* ranges, double share_M, double share_mu) {
  double log_width = ranges[4];
  double mu = log_width > 0.0 ? ranges[2] * exp(log_width * share_mu) : ranges[2] + ranges[3] * share_mu;
  return {ranges[0] + ranges[1] * share_M, mu};
}

// Draws the initial states and the plants of the next episodes of the first `count` environments in `rows`, and the
// other values by the lines of the draw table. Returns the place of a row that names no environment, or -1.
inline long long draw_episodes(const Batch& b, long long count) {
  for (long long n = 0; n < count; n++) {
    long long i = b.rows[n];
    if (i < 0 || i >= b.num_envs) return n;
    const Word *key = b.keys + 2 * i, episode = (Word)b.episodes[i];
    double theta = b.start[0], theta_dot = 0.0;
    if (b.start[1] > 0.0 || b.start[2] > 0.0) {
      theta += b.start[1] * (2.0 * draw(key, INITIAL_STATE, episode, 0) - 1.0);
      theta_dot += b.start[2] * (2.0 * draw(key, INITIAL_STATE, episode, 1) - 1.0);
    }
    auto [M, mu] = plant_at(b.ranges, draw(key, PARAMETERS, episode, 0), draw(key, PARAMETERS, episode, 1));
    const double values[] = {theta, theta_dot, 0.0, 0.0, M, mu};
    for (int r = 0; r < 6; r++) b.starts[r * b.num_envs + n] = values[r];
    for (long long k = 0; k < b.draw_lines; k++) {
      const double* line = b.draw_table + 6 * k;
      double share = draw(key, (Word)line[1], episode, (int)line[2]), low = line[3], range = line[4];
      // Where the sign is drawn, each half of [0, 1) stands for one sign.
      double twice = 2.0 * share - 1.0, size = low + range * (line[5] != 0.0 ? abs(twice) : share);
      b.drawn[k * b.num_envs + n] = line[5] != 0.0 ? copysign(size, twice) : size;
    }
  }
  return -1;
}

// Writes the initial values of the next episodes of these environments, and deactivates the others for one step.
template <int N> void begin_episodes(const Batch& b, long long count) {
  for (long long at = 0; at < b.num_envs; at += N)
    for (int j = 0; j < N; j++) block_of<N>(b, at).active[j] = 0.0;
  for (long long n = 0; n < count; n++) {
    long long i = b.rows[n], j = i % N;
    auto& block = block_of<N>(b, i);
    double* lane = (double*)&block + j;
    // The constants of varied plants are derived when their episode begins.
    long long plant = (block.plant_m - (double*)&block) / N, memory = sizeof block / sizeof block.theta;
    for (long long row = 0; row < plant; row++) lane[row * N] = 0.0;
    for (long long row = memory; row < b.block_rows; row++) lane[row * N] = 0.0;
    for (int r = 0; r < 6; r++) lane[r * N] = b.starts[r * b.num_envs + n];
    for (long long cell = 0; cell < b.memory_size; cell++) lane[(memory + cell) * N] = b.memory[cell];
    for (long long k = 0; k < b.draw_lines; k++) lane[(long long)b.draw_table[6 * k] * N] = b.drawn[k * b.num_envs + n];
    block.start_x[j] = block.x[j];
    block.smallest_normal_ratio[j] = INFINITE;
    block.largest_theta[j] = abs(block.theta[j]), block.largest_theta_dot[j] = abs(block.theta_dot[j]);
    block.normal_force[j] = (block.M[j] + b.settings->m) * b.settings->g;
    block.active[j] = 1.0;
    b.episodes[i]++;
  }
}
}  // namespace LEVEL
