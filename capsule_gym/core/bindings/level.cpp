// The core at one level of instructions: compiled once for each, with -DLEVEL=name and its -march.
#include "../physics/trajectory.hpp"
#include "functions.hpp"
#include "instruction_levels.hpp"

namespace LEVEL {
long long call(const char* function, const Argument* a) {
  auto is = [&](const char* name) { return !__builtin_strcmp(function, name); };
  const Batch* batch = a[0];  // not of all functions
  if (is("advance")) return advance(*batch, a[1], a[2], (long long)a[3] != 0);
  if (is("step_one")) return step_one(*batch, a[1]);
  if (is("draw_episodes")) return draw_episodes(*batch, a[1]);
  if (is("begin_episodes")) return (batch->lanes == 1 ? begin_episodes<1> : begin_episodes<LANES>)(*batch, a[1]), -1;
  if (is("episode_metrics"))
    return (batch->lanes == 1 ? episode_metrics<1> : episode_metrics<LANES>)(*batch, a[1], a[2], a[3], a[4]), -1;
  if (is("run_episodes"))
    return (batch->lanes == 1 ? run_episodes<1> : run_episodes<LANES>)(*batch, a[1], a[2], a[3], a[4]);
  if (is("trajectory"))
    return ((const double*)a[1] ? trajectory<Dual> : trajectory<double>)(a[0], a[1], a[2], a[3], a[4], a[5], a[6]);
  if (is("law_torques")) return law_torques(a[0], a[1], a[2], a[3], a[4], a[5], a[6]), -1;
  if (is("platform_motion")) return platform_motion(a[0], a[1], a[2], a[3], a[4], *(const AnyPlant*)a[5], a[6]), -1;
  if (is("act")) return act(a[0], a[1], a[2], a[3]), -1;
  return evaluate(function, a[0], a[1], a[2], a[3], a[4]);
}
}  // namespace LEVEL
