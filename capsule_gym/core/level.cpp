// The core at one level of instructions: compiled once for each, with -DLEVEL=name and its -march.
#include "level.hpp"
#include "functions.hpp"
#include "network.hpp"
#include "resets.hpp"
#include "rollout.hpp"
#include "step.hpp"

namespace LEVEL {

void begin_episodes(const Batch& batch, long long count) {
  if (batch.lanes == 1) return begin_blocks<1>(batch, count, block_size<1>(batch));
  begin_blocks<LANES>(batch, count, block_size<LANES>(batch));
}

template <class Law>
void torques_of(const Law& law, const double* states, double* memory, const double* rows, double* torques, long long n) {
  for (long long i = 0; i < n; i++) {
    const double* s = states + 4 * i;
    torques[i] = law(State<double>{s[0], s[1], s[2], s[3]}, memory + Law::MEMORY * i, rows + Law::COLUMNS * i);
  }
}

void law_torques(long long law, const double* constants, const double* states, double* memory, const double* rows,
                 double* torques, long long n) {
  int number = 0;
#define LAW(Law) \
  if (law == number++) return torques_of(Law(constants), states, memory, rows, torques, n);
  CAPSULE_LAWS(LAW)
#undef LAW
}

void motion_of_platform(const double* angle, const double* velocity, const double* acceleration, const double* plant,
                        double* motion, long long n, double h) {
  platform_motion(angle, velocity, acceleration, n, h, load<Plant<double, Kind::extended>>(plant), motion);
}

bool act_allocating(const double* packed, const float* observations, long long entries, long long n, double* memory,
                    float* actions) {
  Network network(packed);
  void* workspace = __builtin_malloc(workspace_size(network, n < LANES ? (int)n : LANES));
  if (!workspace) return false;
  act_batch(network, observations, entries, n, (Identification*)memory, workspace, actions);
  __builtin_free(workspace);
  return true;
}

long long run_allocating(const Batch& batch, long long first, long long last, long long steps, double control_dt,
                         const double* packed, double* memory, const double* changes, long long num_changes) {
  Network network(packed);
  void* workspace = __builtin_malloc(workspace_size(network, LANES));
  if (!workspace) return NO_MEMORY;
  Rollout rollout = {batch, network, (Identification*)memory, workspace, changes, num_changes, steps, control_dt};
  long long broken = run_episodes(rollout, first, last);
  __builtin_free(workspace);
  return broken;
}

void write_inputs_of(const double* header, const float* observations, long long entries, long long n, double* memory,
                     float* inputs) {
  write_inputs(*(const Header*)header, observations, entries, n, (Identification*)memory, inputs);
}

}  // namespace LEVEL

#define TEXT(x) #x
#define NAME_OF(x) TEXT(x)
#define JOIN(a, b) a##b
#define SYMBOL(x) JOIN(capsule_level_, x)

extern "C" const Level SYMBOL(LEVEL);
extern "C" const Level SYMBOL(LEVEL) = {
    NAME_OF(LEVEL),     LEVEL::advance,     LEVEL::draw_episodes,      LEVEL::begin_episodes,
    LEVEL::evaluate,    LEVEL::law_torques, LEVEL::motion_of_platform, LEVEL::act_allocating,
    LEVEL::write_inputs_of, LEVEL::run_allocating};
