// One Runge-Kutta step of the plant within a phase of contact.
//
// The step is free of branches: a register takes several environments through it at once. Steps
// through changes of phase are in events.hpp.
#pragma once
#include "plant.hpp"

namespace LEVEL {
template <class T> struct Boundary {
  T value, rate;
};
template <class T> struct Stepped {
  State<T> end;
  Accelerations<T> first;  // at the start
  // The smallest N of the stages: if it is negative, the platform did not press on the floor during
  // the whole step.
  T smallest;
};

// Whether the boundary may have been crossed within h seconds. The tangent bounds a convex function
// from below: no dip inside the step can escape the second test.
template <class T> INLINE auto crosses(T before, T rate, T after, T h) {
  return (after < 0.0) | ((before > 0.0) & (before + h * rate < 0.0));
}

// Integral of |theta_dot| over h seconds that turned the pendulum by `turned`; theta_dot went from
// start to end.
template <class T> INLINE T swept(T start, T end, T turned, T h) {
  return select(start * end >= 0.0, abs(turned),
                0.5 * h * (start * start + end * end) / (abs(start) + abs(end)));
}

// One classical Runge-Kutta step of h seconds inside one phase, with the friction coefficient mu;
// `first` is `pressed_accelerations` at the start.
template <class P, class T = Number<P>>
INLINE Stepped<T> runge_kutta(const State<T>& s, T slip, T mu, T u, const P& p, T h,
                              const Accelerations<T>& first) {
  // The accelerations do not depend on x, and not on x_dot on a level floor with Coulomb friction:
  // sums suffice.
  T half = 0.5 * h;
  T theta_2 = s.theta + half * s.theta_dot;
  auto [a1, b1, normal_1] = first;
  auto [a2, b2, normal_2] =
      p.pressed_accelerations(theta_2, s.theta_dot + half * a1, s.x_dot + half * b1, slip, mu, u);
  T theta_3 = theta_2 + half * half * a1;
  T theta_dot_3 = s.theta_dot + half * a2;
  auto [a3, b3, normal_3] =
      p.pressed_accelerations(theta_3, theta_dot_3, s.x_dot + half * b2, slip, mu, u);
  T theta_4 = s.theta + h * s.theta_dot + half * h * a2;
  auto [a4, b4, normal_4] =
      p.pressed_accelerations(theta_4, s.theta_dot + h * a3, s.x_dot + h * b3, slip, mu, u);
  T sixth = h / 6.0;
  State<T> end = {s.theta + h * s.theta_dot + h * sixth * (a1 + a2 + a3),
                  s.theta_dot + sixth * (a1 + 2.0 * (a2 + a3) + a4),
                  s.x + h * s.x_dot + h * sixth * (b1 + b2 + b3),
                  s.x_dot + sixth * (b1 + 2.0 * (b2 + b3) + b4)};
  return {end, first, min(min(normal_1, normal_2), min(normal_3, normal_4))};
}

// The quantity that stays positive while the phase lasts, and its time derivative: m/s in slip, N
// in stick. For one environment.
template <class P, class T = Number<P>>
INLINE Boundary<T> boundary(const State<T>& s, T x_ddot, T slip, T u, const P& p) {
  if (slip != 0.0) return {slip * s.x_dot, slip * x_ddot};
  return {p.stick_margin(s.theta, s.theta_dot, u).value,
          p.stick_margin_rate(s.theta, s.theta_dot, u)};
}

// Takes a step of h seconds inside one phase, and returns whether the phase lasts; if not,
// `event_step` takes the step. may_stick = false asserts that slip is nowhere 0.0, which saves a
// third of the work.
template <bool may_stick, class P, class T = Number<P>>
INLINE auto smooth_step(const State<T>& s, T slip, T u, const P& p, T h, Stepped<T>& r) {
  T mu = p.kinetic_friction(slip);
  auto at_start = p.pressed_accelerations(s.theta, s.theta_dot, s.x_dot, slip, mu, u);
  r = runge_kutta(s, slip, mu, u, p, h, at_start);
  const auto& [end, first, smallest] = r;
  T before = slip * s.x_dot;
  T rate = slip * first.x_ddot;
  T after = slip * end.x_dot;
  auto stopped = end.x_dot == 0.0;
  if constexpr (may_stick) {
    auto sticks = slip == 0.0;
    before = select(sticks, p.stick_margin(s.theta, s.theta_dot, u).value, before);
    rate = select(sticks, p.stick_margin_rate(s.theta, s.theta_dot, u), rate);
    after = select(sticks, p.stick_margin(end.theta, end.theta_dot, u).value, after);
    stopped = stopped & !sticks;
  }
  return !(crosses(before, rate, after, h) | stopped | (smallest < 0.0));
}
}  // namespace LEVEL
