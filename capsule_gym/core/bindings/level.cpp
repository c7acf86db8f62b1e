// The core at one level of instructions: compiled once for each, with -DLEVEL=name and its -march.
#include "../physics/trajectory.hpp"
#include "functions.hpp"
#include "instruction_levels.hpp"

namespace LEVEL {
// Templates with the choices that their arguments make.
static void begin_any(const Batch& batch, long long count) {
  (batch.lanes == 1 ? begin_episodes<1> : begin_episodes<LANES>)(batch, count);
}
static void metrics_any(const Batch& batch, const long long* rows, long long count, double horizon,
                        double* out) {
  (batch.lanes == 1 ? episode_metrics<1> : episode_metrics<LANES>)(batch, rows, count, horizon,
                                                                   out);
}
static long long run_any(const Batch& batch, long long first, long long last, long long steps,
                         const double* network, double* memory) {
  auto run = batch.lanes == 1 ? run_episodes<1> : run_episodes<LANES>;
  return run(batch, first, last, steps, network, memory);
}
static long long trajectory_any(const double* values, const double* partials, long long n,
                                long long steps, double h, double* states, double* slopes) {
  return (partials ? trajectory<Dual> : trajectory<double>)(values, partials, n, steps, h, states,
                                                            slopes);
}

constexpr Function FUNCTIONS[] = {
    // First what a step of one environment calls: the search for a name takes part of its time.
    named<step_one>("step_one"),
    named<advance>("advance"),
    named<draw_episodes>("draw_episodes"),
    named<begin_any>("begin_episodes"),
    named<metrics_any>("episode_metrics"),
    named<run_any>("run_episodes"),
    named<trajectory_any>("trajectory"),
    named<law_torques>("law_torques"),
    named<platform_motion>("platform_motion"),
    named<act>("act"),
    named<memory_size>("memory_size"),
    evaluated<&AnyPlant::accelerations>("accelerations"),
    evaluated<&AnyPlant::normal_force>("normal_force"),
    evaluated<&AnyPlant::driving_force>("driving_force"),
    evaluated<&AnyPlant::friction_force>("friction_force"),
    evaluated<&AnyPlant::stick_margin>("stick_margin"),
    evaluated<&AnyPlant::contact_phase>("contact_phase"),
    evaluated<plant_step<AnyPlant, double>>("step"),
    evaluated<sincos<double>>("sincos"),
    evaluated<exp<double>>("exp"),
    evaluated<tanh<double>>("tanh"),
    evaluated<log>("log"),
    evaluated<derive<double>>("derive"),
    evaluated<normals_from>("normals"),
    evaluated<number_at>("number_at"),
    evaluated<Goal::rate<double>>("goal_rate"),
};

const Function* find(const char* name) {
  for (const Function& function : FUNCTIONS)
    if (!__builtin_strcmp(function.name, name)) return &function;
  return nullptr;
}
}  // namespace LEVEL
