// Steps of the plant through changes of the contact phase, which are located inside the step.
//
// `event_step` takes one environment through every change. `pass_rest` computes the most common
// change, the end of a slip, without branches, for several environments at once.
#pragma once
#include "integrator.hpp"

namespace LEVEL {
// Far more events than in any step. The limit only prevents an endless loop after a rounding error.
constexpr int EVENT_LIMIT = 1000;
constexpr int ROOT_ITERATIONS = 60;
constexpr int CUBIC_ITERATIONS = 3;
// Size of the boundary (m/s in slip, N in stick) that counts as zero: ten times its rounding error.
constexpr double EVENT_TOLERANCE = 1e-15;
// Share of a step that the state may be moved along its tangent: at 2 ms and 50 rad/s^2 an error of
// 1e-16 rad.
constexpr double LAST_CORRECTION = 1e-6;
// Share of a bracket below which its halves are the same number.
constexpr double SMALLEST_BRACKET = 1e-14;
// Share of a step below which a slip that starts and ends at rest counts as none.
constexpr double VOID_PHASE = 1e-9;

// The result of a step: the new state and the integrals over the step.
template <class T> struct Motion {
  State<T> end;
  T forward, backward;  // distance moved forwards and backwards, m
  T stuck;              // time in stick, s
  T swept;              // integral of |theta_dot|, rad
  T normal_force;       // the smallest met at the start of a phase, N; 0.0 where contact was lost
  T events;             // number of changes of phase located inside the step
};

// A part of a step that stays in one phase: its length tau in s, the state and the accelerations at
// its end, and x'' and N at its start. The phase lasts while the boundary is positive.
template <class T> struct Piece {
  T tau;
  State<T> end;
  Boundary<T> boundary;
  T theta_ddot, x_ddot, first_x_ddot, normal_force;
};

// Root in (0, width) of the cubic with those values and rates at its ends, the first positive, the
// last not.
template <class T> INLINE T first_guess(T g_low, T rate_low, T g_high, T rate_high, T width) {
  // In s = tau / width: g_low + c s + d s^2 + e s^3.
  T c = rate_low * width;
  T end = rate_high * width;
  T d = 3.0 * (g_high - g_low) - 2.0 * c - end;
  T e = 2.0 * (g_low - g_high) + c + end;
  T s = g_low / (g_low - g_high);
  for (int i = 0; i < CUBIC_ITERATIONS; i++) {
    T value = fma(fma(fma(e, s, d), s, c), s, g_low);
    T slope = fma(fma(3.0 * e, s, 2.0 * d), s, c);
    s = select(slope < 0.0, min(T(1.0), max(T(0.0), s - value / slope)), s);
  }
  return s * width;
}

// The state `tau` seconds later along its tangent.
template <class T> INLINE State<T> extrapolate(const State<T>& s, T theta_ddot, T x_ddot, T tau) {
  return {s.theta + tau * s.theta_dot, s.theta_dot + tau * theta_ddot, s.x + tau * s.x_dot,
          s.x_dot + tau * x_ddot};
}

// The start of a phase of contact; `first` is `pressed_accelerations` there.
template <class P> struct Phase {
  using T = Number<P>;
  State<T> s;
  T slip, u;
  P p;
  Accelerations<T> first;

  // The piece of this step of tau seconds.
  NOINLINE Piece<T> finish(T tau, const Stepped<T>& r) const {
    auto a = p.accelerations(r.end.theta, r.end.theta_dot, r.end.x_dot, slip, u);
    return {.tau = tau,
            .end = r.end,
            .boundary = boundary(r.end, a.x_ddot, slip, u, p),
            .theta_ddot = a.theta_ddot,
            .x_ddot = a.x_ddot,
            .first_x_ddot = r.first.x_ddot,
            .normal_force = max(T(0.0), r.first.normal)};
  }

  // A step of tau seconds in one phase, even if the phase would end earlier. It is always a full
  // Runge-Kutta step from the phase's start, so that an event is as accurate as the integrator
  // itself. A step in which the contact is lost is taken without friction.
  NOINLINE Piece<T> piece(T tau) const {
    auto r = runge_kutta(s, slip, p.kinetic_friction(slip), u, p, tau, first);
    if (!(r.smallest >= 0.0)) {
      auto lifted = p.pressed_accelerations(s.theta, s.theta_dot, s.x_dot, slip, 0.0, u);
      r = runge_kutta(s, slip, T(0.0), u, p, tau, lifted);
    }
    return finish(tau, r);
  }

  // The piece that ends on the boundary: Newton's method on re-taken steps, kept inside a bracket.
  // The first guess is the root of the cubic through the bracket's ends. The last correction is so
  // small that the state is extrapolated along its tangent. The bracket begins at `low`, with the
  // boundary `before` > 0 and its rate there.
  NOINLINE Piece<T> root(T low, T before, T rate, const Piece<T>& beyond) const {
    T end = beyond.tau;
    T width = end - low;
    T tau = low + first_guess(before, rate, beyond.boundary.value, beyond.boundary.rate, width);
    T correction = INFINITE;
    Piece<T> trial = beyond;
    for (int i = 0; i < ROOT_ITERATIONS; i++) {
      trial = piece(tau);
      const auto& [value, slope] = trial.boundary;
      correction = slope < 0.0 ? -value / slope : T(INFINITE);
      bool small = abs(correction) <= LAST_CORRECTION * width;
      bool on_boundary = abs(value) <= EVENT_TOLERANCE;
      bool narrow = end - low <= SMALLEST_BRACKET * width;
      if (small || on_boundary || narrow) break;
      (value < 0.0 ? end : low) = tau;
      tau = tau + correction;
      if (!(low < tau && tau < end)) tau = 0.5 * (low + end);
    }
    if (abs(correction) > LAST_CORRECTION * width) return trial;
    trial.end = extrapolate(trial.end, trial.theta_ddot, trial.x_ddot, correction);
    trial.tau = trial.tau + correction;
    trial.boundary.value = 0.0;
    return trial;
  }

  // The piece up to the first event of a step that may have crossed the boundary, or `whole`
  // without an event.
  NOINLINE Piece<T> until_event(T before, T rate, const Piece<T>& whole) const {
    Piece<T> beyond = whole;
    if (whole.boundary.value >= 0.0) {
      // The minimum of the parabola with this start, rate and end.
      T h = whole.tau;
      T curvature = whole.boundary.value - before - rate * h;
      T dip = curvature > 0.0 ? -0.5 * rate * h * h / curvature : h;
      if (!(dip < h)) return whole;
      beyond = piece(dip);
      if (beyond.boundary.value >= 0.0) return whole;
    }
    if (before > EVENT_TOLERANCE) return root(0.0, before, rate, beyond);
    // The phase starts on its own boundary: a bracket must begin after the state has left the
    // boundary.
    for (int i = 0; i < ROOT_ITERATIONS; i++) {
      Piece<T> left = piece(0.5 * beyond.tau);
      if (left.boundary.value > 0.0)
        return root(left.tau, left.boundary.value, left.boundary.rate, beyond);
      beyond = left;
    }
    return beyond;
  }
};

// The phase that starts in this state.
template <class P, class T = Number<P>>
INLINE Phase<P> begin_phase(const State<T>& s, T slip, T u, const P& p) {
  T mu = p.kinetic_friction(slip);
  return {s, slip, u, p, p.pressed_accelerations(s.theta, s.theta_dot, s.x_dot, slip, mu, u)};
}

// Adds a piece of a step, in the phase `slip`, to the motion before it.
template <class T> INLINE void add_piece(Motion<T>& m, const Piece<T>& piece, T slip) {
  T turned = piece.end.theta - m.end.theta;
  m.swept = m.swept + swept(m.end.theta_dot, piece.end.theta_dot, turned, piece.tau);
  m.forward = m.forward + max(T(0.0), piece.end.x - m.end.x);
  m.backward = m.backward + max(T(0.0), m.end.x - piece.end.x);
  if (slip == 0.0) m.stuck = m.stuck + piece.tau;
  m.normal_force = min(m.normal_force, piece.normal_force);
  m.end = piece.end;
}

// The phase after an event, which makes a platform that has slipped rest. `returned`: the slip has
// ended where it started.
template <class P, class T = Number<P>>
INLINE T phase_after_event(State<T>& s, T slip, T u, const P& p, bool returned) {
  // At the boundary rounding could give either phase, so the direction of the load decides.
  if (slip == 0.0) return p.stick_margin(s.theta, s.theta_dot, u).force > 0.0 ? 1.0 : -1.0;
  s.x_dot = 0.0;
  // If load and limit are equal up to rounding, such a slip would start again forever.
  return returned ? T(0.0) : p.contact_phase(s, u);
}

// A step from a phase and from the whole step under the assumption that this phase lasts.
template <class P, class T = Number<P>>
NOINLINE inline Motion<T> event_step(const Phase<P>& start, const Piece<T>& whole) {
  const P& p = start.p;
  Motion<T> m = {start.s, 0.0, 0.0, 0.0, 0.0, INFINITE, 0.0};
  T slip = start.slip;
  T remaining = whole.tau;
  Phase<P> phase = start;
  Piece<T> done = whole;
  for (int count = 0; count < EVENT_LIMIT; count++) {
    if (count > 0) {
      phase = begin_phase(m.end, slip, start.u, p);
      done = phase.piece(remaining);
    }
    auto [before, rate] = boundary(m.end, done.first_x_ddot, slip, start.u, p);
    // The last piece takes the rest of the step, so that no time is lost.
    bool last = count == EVENT_LIMIT - 1;
    bool crossed = crosses(before, rate, done.boundary.value, remaining) && !last;
    bool beyond = crossed && done.boundary.value < 0.0;
    if (crossed) done = phase.until_event(before, rate, done);
    add_piece(m, done, slip);
    bool ended = done.tau < remaining || beyond;
    if (!ended) break;
    m.events = m.events + 1.0;
    bool returned = before <= 0.0 && done.tau <= VOID_PHASE * whole.tau;
    slip = phase_after_event(m.end, slip, start.u, p, returned);
    remaining = remaining - done.tau;
    if (remaining <= 0.0) break;
  }
  return m;
}

// Advances the plant by h seconds at constant torque, through every change of contact phase.
template <class P, class T = Number<P>>
inline Motion<T> plant_step(const State<T>& s, T u, const P& p, T h) {
  auto start = begin_phase(s, p.contact_phase(s, u), u, p);
  return event_step(start, start.piece(h));
}

template <class T, class Condition> struct Passed {
  Motion<T> motion;
  Condition holds;
};

// `event_step` from slip through one moment of rest, free of branches, with the same bits. Not
// valid where `holds` is false: if another event happens, or if locating the moment takes more than
// one trial. `lasting` is the state after h seconds if the phase lasted.
template <class P, class T = Number<P>>
INLINE auto pass_rest(const Phase<P>& start, const State<T>& lasting, T h) {
  const auto& [s, slip, u, p, first] = start;
  T mu = p.kinetic_friction(slip);
  T before = slip * s.x_dot;
  T after = slip * lasting.x_dot;
  auto at_end =
      p.pressed_accelerations(lasting.theta, lasting.theta_dot, lasting.x_dot, slip, mu, u);
  auto holds = (slip != 0.0) & (before > EVENT_TOLERANCE) & (after < 0.0) & (at_end.normal >= 0.0);

  // The moment of rest.
  T tau = first_guess(before, slip * first.x_ddot, after, slip * at_end.x_ddot, h);
  auto [m, unused, smallest] = runge_kutta(s, slip, mu, u, p, tau, first);
  auto a = p.pressed_accelerations(m.theta, m.theta_dot, m.x_dot, slip, mu, u);
  T correction = -(slip * m.x_dot) / (slip * a.x_ddot);
  auto presses = (smallest >= 0.0) & (a.normal >= 0.0);
  auto brakes = slip * a.x_ddot < 0.0;
  holds = holds & presses & brakes & (abs(correction) <= LAST_CORRECTION * h);
  tau = tau + correction;
  State<T> rest = extrapolate(m, a.theta_ddot, a.x_ddot, correction);
  rest.x_dot = 0.0;

  // The rest of the step.
  T next_slip = p.contact_phase(rest, u);
  T remaining = h - tau;
  Stepped<T> last;
  auto lasts = smooth_step<true>(rest, next_slip, u, p, remaining, last);
  holds = holds & lasts & (remaining > 0.0);
  const State<T>& end = last.end;
  T turned = swept(s.theta_dot, rest.theta_dot, rest.theta - s.theta, tau) +
             swept(rest.theta_dot, end.theta_dot, end.theta - rest.theta, remaining);
  Motion<T> motion = {
      .end = end,
      .forward = max(T(0.0), rest.x - s.x) + max(T(0.0), end.x - rest.x),
      .backward = max(T(0.0), s.x - rest.x) + max(T(0.0), rest.x - end.x),
      .stuck = select(next_slip == 0.0, remaining, T(0.0)),
      .swept = turned,
      .normal_force = min(first.normal, last.first.normal),
      .events = 1.0,
  };
  return Passed<T, decltype(holds)>{motion, holds};
}
}  // namespace LEVEL
