// The control laws that run inside the step.
//
// A law is called once per period with the state, its memory and the present row of its reference, which the memory of
// the task follows. It returns the torque in N m, not yet clipped to the limit, and replaces its memory by that of the
// next call.
#pragma once
#include "laws/adaptive.hpp"
#include "laws/feedback_linearisation.hpp"
#include "laws/gait.hpp"
#include "laws/predictive.hpp"
#include "laws/pulses.hpp"

namespace LEVEL {

// The direct-torque task: the residual torque is the whole torque.
struct NoLaw {
  static constexpr const char *NAME = "none", *CONSTANTS = "";
  static constexpr int MEMORY = 1, COLUMNS = 2, TASK_ROWS = 0;
  static constexpr bool BRANCHES = false;
  explicit NoLaw(const double*) {}
  template <class T> INLINE T operator()(const State<T>&, T*, const T*) const { return 0.0; }
};

#define CAPSULE_LAWS(LAW)                                                                                              \
  LAW(NoLaw) LAW(Adaptive) LAW(FeedbackLinearising) LAW(Gait) LAW(GaitCandidate) LAW(GaitIdentifying)                  \
  LAW(GaitPredictive) LAW(AdaptivePredictive) LAW(GoalPulses) LAW(VelocityPulses)

// What Python knows of a law: its name, the names of its constants with the sizes of arrays, the cells of its memory, the
// columns of its reference and the size of the task's memory that it reads.
struct LawEntry {
  const char *name, *constants;
  int memory, columns, task_rows;
};
#define LAW(Law) {Law::NAME, Law::CONSTANTS, Law::MEMORY, Law::COLUMNS, Law::TASK_ROWS},
constexpr LawEntry LAWS[] = {CAPSULE_LAWS(LAW)};
#undef LAW

// Calls law number `law` of the list n times: states (n, 4), memories (n, MEMORY), which it replaces, rows (n, COLUMNS +
// TASK_ROWS), torques (n,).
inline void law_torques(int law, const double* constants, long long n, const double* states, double* memories,
                        const double* rows, double* torques) {
  int number = 0;
  auto evaluate = [&](auto controller) {
    using Law = decltype(controller);
    for (long long i = 0; i < n; i++)
      torques[i] = controller(load<State<double>>(states + 4 * i), memories + Law::MEMORY * i,
                              rows + (Law::COLUMNS + Law::TASK_ROWS) * i);
  };
#define LAW(Law) if (law == number++) evaluate(Law(constants));
  CAPSULE_LAWS(LAW)
#undef LAW
}

}  // namespace LEVEL
