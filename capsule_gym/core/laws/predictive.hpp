// A law for late, noisy measurements and a lagging motor: an observer and a predictor around the
// gait.
//
// The sensors show the state of LATENCY calls ago. An observer with fixed gains estimates that
// state. The nominal model predicts from it, with the torques that the law has returned since, the
// state at which the next torque acts. The friction coefficient, the mass of the platform and the
// bias of the measured x_dot are estimated by gradient descent on the squared error of x_dot. The
// position is not measured.
#pragma once
#include "gait.hpp"

namespace LEVEL {
namespace predictor {
// Assumed of sensors and motor.
constexpr int LATENCY = 10;              // calls from a measurement to its torque
constexpr double LAG = 0.005;            // time constant of the motor, s
constexpr double MOTOR_FRICTION = 0.05;  // N m
// Speeds below which the model's friction falls linearly to 0.
constexpr double MOTOR_STICK_RATE = 0.2;     // rad/s
constexpr double FLOOR_STICK_SPEED = 0.005;  // m/s
// Share of a measurement's error by which a call corrects the estimate.
constexpr double GAIN_THETA = 0.005;
constexpr double GAIN_THETA_DOT = 0.05;
constexpr double GAIN_X_DOT = 0.02;
// Rates of learning per call.
constexpr double RATE_MU = 0.02;    // of log(mu), s/m
constexpr double RATE_M = 1e-3;     // of log(M), s^2/m
constexpr double RATE_BIAS = 1e-4;  // of the bias of x_dot, share of the error
// Ranges of mu and of the bias of x_dot.
constexpr double LOW_MU = 0.0025;
constexpr double HIGH_MU = 1.0;
constexpr double LARGEST_BIAS = 0.05;  // m/s
// Calls per Euler step of the predictor, whose torques are averaged.
constexpr int STRIDE = 3;

// The estimate of the state LATENCY calls ago, before the measurement of that time.
template <class T> struct Estimate {
  T begun;  // 1.0 after the first measurement
  T theta, theta_dot, x_dot;
  T motor;  // the motor's torque after its lag, N m
  T M, mu;
  T bias;  // of the measured x_dot, m/s
};
template <class T> struct Memory {
  Estimate<T> estimate;
  T queue[LATENCY];  // the torques of the last calls, the oldest first
};

// One Euler step of h seconds of the nominal model with the estimated M and mu; implicit for the
// motor's lag.
template <class T> INLINE void model_step(Estimate<T>& e, T torque, double h, const auto& law) {
  e.motor = e.motor + h / (LAG + h) * (torque - e.motor);
  T u = e.motor - MOTOR_FRICTION * clip(e.theta_dot / MOTOR_STICK_RATE, T(1.0));
  auto plant = nominal_plant<T, Kind::coulomb>(law);
  plant.M = e.M;
  plant.mu = e.mu;
  plant.mass_ratio = law.m / (e.M + law.m);
  T friction = e.mu * clip(e.x_dot / FLOOR_STICK_SPEED, T(1.0));
  auto a = plant.pressed_accelerations(e.theta, e.theta_dot, e.x_dot, 1.0, friction, u);
  e.theta = e.theta + h * (e.theta_dot + 0.5 * h * a.theta_ddot);
  e.theta_dot = e.theta_dot + h * a.theta_ddot;
  e.x_dot = e.x_dot + h * a.x_ddot;
}

// Corrects the estimate by a measurement; the first measurement is used unchanged.
//
// If the measured x_dot is above its estimate while the platform slides forwards, friction is
// smaller than estimated. If it is above while the pendulum swings forwards, the platform is
// lighter than estimated.
template <class T> INLINE void correct(Estimate<T>& e, T theta, T theta_dot, T x_dot) {
  theta = clip(theta, T(THETA_LIMIT));
  theta_dot = clip(theta_dot, T(THETA_DOT_BOUND));
  x_dot = clip(x_dot, T(X_DOT_BOUND));
  auto first = e.begun == 0.0;
  e.begun = 1.0;
  e.theta = select(first, theta, clip(e.theta, T(THETA_LIMIT)));
  e.theta_dot = select(first, theta_dot, clip(e.theta_dot, T(THETA_DOT_BOUND)));
  e.x_dot = select(first, x_dot, clip(e.x_dot, T(X_DOT_BOUND)));
  T error = x_dot - e.bias - e.x_dot;
  T sliding = clip(e.x_dot / FLOOR_STICK_SPEED, T(1.0));
  T swinging = sincos(e.theta).cos * e.theta_dot;
  e.theta = e.theta + GAIN_THETA * (theta - e.theta);
  e.theta_dot = e.theta_dot + GAIN_THETA_DOT * (theta_dot - e.theta_dot);
  e.x_dot = e.x_dot + GAIN_X_DOT * error;
  T M = e.M * (1.0 - RATE_M * swinging * error);
  T mu = e.mu * (1.0 - RATE_MU * sliding * error);
  e.M = min(T(Estimator<double>::HIGH_M), max(T(Estimator<double>::LOW_M), M));
  e.mu = min(T(HIGH_MU), max(T(LOW_MU), mu));
  e.bias = clip(e.bias + RATE_BIAS * error, T(LARGEST_BIAS));
}

// Corrects the estimate by a measurement of LATENCY calls ago and returns the prediction of the
// present. The memory becomes that of the next call, but for the last of the queue, the torque of
// this call.
template <class T>
INLINE Estimate<T> predict(Memory<T>& memory, const State<T>& s, const auto& law) {
  auto& [estimate, queue] = memory;
  correct(estimate, s.theta, s.theta_dot, s.x_dot);
  model_step(estimate, queue[0], law.dt, law);
  Estimate<T> present = estimate;
  for (int i = 1; i < LATENCY; i += STRIDE) {
    T torque = (queue[i] + queue[i + 1] + queue[i + 2]) / double(STRIDE);
    model_step(present, torque, STRIDE * law.dt, law);
  }
  for (int i = 1; i < LATENCY; i++) queue[i - 1] = queue[i];
  return present;
}
}  // namespace predictor

// The guarded gait on the predicted state.
struct GaitPredictive {
#define GAIT_PREDICTIVE_CONSTANTS(ONE, MANY)                                     \
  GAIT_CONSTANTS(ONE, MANY)                                                      \
  NOMINAL_CONSTANTS(ONE)                                                         \
  ONE(lightest) /* smallest mass of a platform that must keep its contact, kg */ \
  ONE(dt)
  CAPSULE_LAW(GaitPredictive, "gait_predictive", T, predictor::Memory, NoReference,
              GAIT_PREDICTIVE_CONSTANTS)
  // Added to the predicted x_dot, m/s: the gait becomes slow if the estimate is too low, but hardly
  // if it is too high.
  static constexpr double X_DOT_MARGIN = 0.004;
  // Smallest normal force, as a share of the weight with the lightest platform.
  static constexpr double CONTACT_MARGIN = 0.1;
  // Change of the normal force per torque, 1/m, below which the torque does not act on it: near the
  // upright.
  static constexpr double UPRIGHT = 1e-6;

  // Reduces a torque, at most to 0, if the normal force of the lightest platform would become too
  // small. The normal force is linear in the torque.
  template <class T> INLINE T keep_contact(T torque, T theta, T theta_dot) const {
    auto plant = nominal_plant<T, Kind::coulomb>(*this);
    plant.M = lightest;
    plant.mu = 0.0;
    plant.mass_ratio = m / (lightest + m);
    auto normal = [&](T u) {
      return plant.pressed_accelerations(theta, theta_dot, 0.0, 1.0, 0.0, u).normal;
    };
    T free = normal(0.0);
    T per_torque = normal(1.0) - free;
    T limit = (CONTACT_MARGIN * (lightest + m) * g - free) / per_torque;
    T raised = max(torque, min(T(0.0), limit));
    T lowered = min(torque, max(T(0.0), limit));
    return select(per_torque > UPRIGHT, raised, select(per_torque < -UPRIGHT, lowered, torque));
  }

  template <class T>
  INLINE T torque(const State<T>& s, predictor::Memory<T>& memory, const NoReference<T>&) const {
    auto now = predict(memory, s, *this);
    T x_dot = now.x_dot + X_DOT_MARGIN;
    T wanted = guarded_torque(now.theta, now.theta_dot, x_dot, *this, guard_from);
    T torque = clip(keep_contact(wanted, now.theta, now.theta_dot), T(torque_limit));
    memory.queue[predictor::LATENCY - 1] = torque;
    return torque;
  }
};
}  // namespace LEVEL
