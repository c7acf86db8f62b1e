// The metrics of an episode so far, from the sums that the step keeps.
#pragma once
#include "../tasks/tasks.hpp"
#include "layout.hpp"

namespace LEVEL {
// Puts the metrics of an environment, each as put(name, description, value). `horizon`: the length
// of a whole episode in s, over which the mean speed of an episode that failed is taken; NaN takes
// the time that has passed.
template <class Task, int N>
void put_metrics(const Batch& batch, long long i, double horizon, auto put) {
  const auto& b = block_of<N>(batch, i);
  int j = (int)(i % N);
  bool failed = b.termination[j] != (double)NONE;
  double distance = b.x[j] - b.start_x[j];
  // Before the first step every integral is 0, and so is every ratio.
  double elapsed = b.duration[j] > 0.0 ? b.duration[j] : 1.0;
  double whole = failed && horizon == horizon ? horizon : elapsed;
  double nowhere = b.backward[j] > 0.0 ? INFINITE : 0.0;
  put("mean_speed", "displacement over the length of a whole episode, cm/s",
      100.0 * distance / whole);
  put("cost_of_transport", "energy over weight and distance; infinite without forward progress",
      b.weight_distance[j] > 0.0 ? b.episode_energy[j] / b.weight_distance[j] : INFINITE);
  put("peak_torque", "largest |u|, N m", b.peak_torque[j]);
  put("rms_torque", "root mean square of u, N m", sqrt(b.torque_squared[j] / elapsed));
  put("backward_ratio",
      "backward over forward travel; infinite with backward travel only, 0 at rest",
      b.forward[j] > 0.0 ? b.backward[j] / b.forward[j] : nowhere);
  put("stuck_fraction", "share of the time in stick", b.stuck[j] / elapsed);
  put("smallest_normal_ratio", "smallest N / ((M + m) g)", b.smallest_normal_ratio[j]);
  put("largest_theta", "largest |theta|, rad", b.largest_theta[j]);
  put("largest_theta_dot", "largest |theta_dot|, rad/s", b.largest_theta_dot[j]);
  put("distance", "displacement, m", distance);
  put("energy", "integral of |u theta_dot|, J", b.episode_energy[j]);
  put("duration", "length of the episode, s", b.duration[j]);
  put("failed", "1 if the episode terminated, else 0", failed ? 1.0 : 0.0);
  const double* rows = (const double*)&b + batch.layout->task * N;
  auto memory = load_record<typename Task::template Memory<double>, double, N>(rows, j);
  Task::metrics(memory, whole, put);
}

// The metrics of `count` environments with these indices: `out` has the shape (metrics, count).
template <int N>
void episode_metrics(const Batch& batch, const long long* rows, long long count, double horizon,
                     double* out) {
  with_type(Tasks(), batch.task, [&]<class Task>() {
    for (long long n = 0; n < count; n++) {
      double* next = out + n;
      put_metrics<Task, N>(batch, rows[n], horizon, [&](const char*, const char*, double value) {
        *next = value;
        next += count;
      });
    }
  });
}
}  // namespace LEVEL
