// The control laws that run inside the step.
//
// A law is called once per period with the state, its memory and the present row of its reference,
// which the memory of the task follows. It returns the torque in N m, not yet clipped to the limit,
// and replaces its memory by that of the next call.
#pragma once
#include "adaptive.hpp"
#include "feedback_linearisation.hpp"
#include "gait.hpp"
#include "periodic.hpp"
#include "predictive.hpp"
#include "pulses.hpp"

namespace LEVEL {
// The direct-torque task: none, so that the residual torque is the whole torque.
struct NoLaw {
  CAPSULE_LAW(NoLaw, "none", T, NoMemory, NoReference, NO_CONSTANTS)

  template <class T> INLINE T torque(const State<T>&, NoMemory<T>&, const NoReference<T>&) const {
    return 0.0;
  }
};

using Laws = List<NoLaw, Adaptive, FeedbackLinearising, Gait, GaitPredictive, GoalPulses,
                  VelocityPulses, Tracking, Oscillator>;
}  // namespace LEVEL
