// The control laws that run inside the step.
//
// A law is called once per period with the state, its memory and the present row of its reference, which the memory of
// the task follows. It returns the torque in N m, not yet clipped to the limit, and replaces its memory by that of the
// next call.
#pragma once
#include "laws/adaptive.hpp"
#include "laws/feedback_linearisation.hpp"
#include "laws/gait.hpp"
#include "laws/periodic.hpp"
#include "laws/predictive.hpp"
#include "laws/pulses.hpp"

namespace LEVEL {
// The direct-torque task: none, so that the residual torque is the whole torque.
struct NoLaw {
  static constexpr const char *NAME = "none", *CONSTANTS = "";
  static constexpr int MEMORY = 1, COLUMNS = 2;
  static constexpr bool BRANCHES = false;
  explicit NoLaw(const double*) {}
  template <class T> INLINE T operator()(const State<T>&, T*, const T*) const { return 0.0; }
};
}  // namespace LEVEL

#define CAPSULE_LAWS(LAW)                                                                                              \
  LAW(NoLaw) LAW(Adaptive) LAW(FeedbackLinearising) LAW(Gait) LAW(GaitCandidate) LAW(GaitIdentifying)                  \
  LAW(GaitPredictive) LAW(AdaptivePredictive) LAW(GoalPulses) LAW(VelocityPulses)                 \
  LAW(Tracking) LAW(Oscillator)
