// The physics of the plant within a phase of contact; SI units.
//
// The plant is the paper's Eq. (1), its misprints corrected (docs/physics.md names them), with q = [theta, x] and the
// friction force f:
//
//     m l^2 theta'' - m l cos(theta) x'' - m g l sin(theta) + k theta + c theta' = u
//     (M + m) x'' - m l cos(theta) theta'' + m l sin(theta) theta'^2 + f = 0
//
// on a level floor with Coulomb friction alone. Within a phase of contact the motion is smooth. `slip` names the phase:
// +1.0 forwards, -1.0 backwards, 0.0 stick. It follows from the state: the platform sticks only where x_dot is exactly 0.0.
//
// The floor of an extended plant may slope (g is then g cos(slope), and a = g sin(slope)), its friction may depend on the
// speed (b is the viscous coefficient, v_s the speed of the Stribeck curve), the motor may have friction u_f, and a force
// F may push the platform:
//
//     m l^2 theta'' - m l cos(theta) x'' - m l (g sin(theta) + a cos(theta)) + k theta + c theta'
//         = u - u_f (35 s - 35 s^3 + 21 s^5 - 5 s^7) / 16
//     (M + m) (x'' + a) + b x' - m l cos(theta) theta'' + m l sin(theta) theta'^2 + f = F
//
// with f = d mu (1 + (static_ratio - 1) / (1 + (x' / v_s)^2)) N in slip in the direction d, and s = theta' / w, clipped to
// [-1, 1].
//
// A step inside one phase is free of branches: a register takes several environments through it at once. Steps through
// changes of phase are in contact.hpp. `fma(a, b, c)` is a b + c, rounded once.
#pragma once
#include "elementary.hpp"

namespace LEVEL {
// The constants of a plant that an `extended` one adds are zero in the others, which do not read them.
enum class Kind {
  coulomb,   // a level floor with Coulomb friction alone
  paper,     // the same with the paper's normal force (7)
  extended,  // everything
  varied,    // everything, and the constants from m on differ between environments
  level,     // they differ, on level floors with Coulomb friction alone and without pushes
};

template <bool condition, class A, class B> struct Choose { using type = A; };
template <class A, class B> struct Choose<false, A, B> { using type = B; };

// The names of the constants from m on; their values are in SI units.
#define CAPSULE_PLANT(FIELD)                                                                                           \
  FIELD(m) FIELD(l)                                                                                                    \
  /* gravity's component perpendicular to the floor */                                                                 \
  FIELD(g) FIELD(k) FIELD(c) FIELD(static_ratio) FIELD(backward_ratio)                                                 \
  /* g sin(slope), the floor's viscous coefficient, static_ratio - 1 and the inverse of the Stribeck curve's speed */  \
  FIELD(downhill) FIELD(viscous) FIELD(stribeck_excess) FIELD(stribeck_rate) FIELD(motor_friction)                     \
  /* the force that pushes the platform forwards */                                                                    \
  FIELD(push)

template <class T, Kind kind_> struct Plant {
  using Number = T;
  static constexpr Kind kind = kind_;
  static constexpr bool varied = kind == Kind::varied || kind == Kind::level;
  // Whether all that an extended plant adds may act; whether the motor may have friction.
  static constexpr bool rough = kind == Kind::extended || kind == Kind::varied, geared = rough || kind == Kind::level;
  using Constant = typename Choose<varied, T, double>::type;

  T M, mu;
  T mass_ratio;                    // m / (M + m), which saves divisions
  double pivot_torque_on_contact;  // 1.0 for the paper's normal force, 0.0 for Newton's
#define FIELD(name) Constant name;
  CAPSULE_PLANT(FIELD)
#undef FIELD
};

template <class P> using Number = typename P::Number;
// Whether the paper's normal force is chosen.
template <class P> INLINE bool pivot_on_contact(const P& p) {
  return P::kind != Kind::coulomb && (P::kind == Kind::paper || p.pivot_torque_on_contact != 0.0);
}

template <class T> struct State { T theta, theta_dot, x, x_dot; };

// rad: the ball meets the platform.
constexpr double THETA_LIMIT = PI / 2.0;
// Bounds of the observation, which is clipped to them. Full torque switched in the worst phase gives 13 rad/s and 1.2 m/s
// on the capsule of the paper; the rest is room for other capsules.
constexpr double THETA_DOT_BOUND = 20.0, X_DOT_BOUND = 2.0;

// Friction coefficient while sliding fast in the direction of `slip` (+1.0 or -1.0).
template <class P> INLINE Number<P> kinetic_friction(Number<P> slip, const P& p) {
  return select(slip < 0.0, p.mu * p.backward_ratio, p.mu);
}

// Friction coefficient at a velocity over the one at high speed: the Stribeck curve of Hess and Soom (1990).
template <class P> INLINE Number<P> stribeck(Number<P> x_dot, const P& p) {
  auto ratio = x_dot * p.stribeck_rate;
  return 1.0 + p.stribeck_excess / (1.0 + ratio * ratio);
}

// Force of the floor on the platform in N, before the clamp at zero: Newton's law on the vertical. With the paper's
// option the pivot's torque is subtracted as (7) prints it.
template <class P> INLINE Number<P> normal_force(Number<P> theta, Number<P> theta_dot, Number<P> theta_ddot, const P& p) {
  auto [sin, cos] = sincos(theta);
  auto newton = (p.M + p.m) * p.g - p.m * p.l * (theta_ddot * sin + theta_dot * theta_dot * cos);
  if (pivot_on_contact(p)) return newton - p.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * sin;  // Eq. (7)
  return newton;
}

// Horizontal force in N with which the pendulum pushes a platform that does not accelerate; friction opposes it.
template <class P> INLINE Number<P> driving_force(Number<P> theta, Number<P> theta_dot, Number<P> theta_ddot, const P& p) {
  auto [sin, cos] = sincos(theta);
  auto force = p.m * p.l * (cos * theta_ddot - sin * theta_dot * theta_dot);
  if constexpr (P::rough) force = force + (p.push - (p.M + p.m) * p.downhill);
  return force;
}

// The force of Coulomb friction on a sliding platform, N, against the direction of `slip`; `normal` is not negative.
template <class P> INLINE Number<P> friction_force(Number<P> slip, Number<P> x_dot, Number<P> normal, const P& p) {
  auto mu = kinetic_friction(slip, p);
  if constexpr (P::rough) mu = mu * stribeck(x_dot, p);
  return slip * mu * normal;
}

// Rate in rad/s below which the motor's Coulomb friction is smooth, so that the integrator resolves a change of sign, and
// its slope at rest, 35 / 16, in units of the friction over that rate.
constexpr double MOTOR_WIDTH = 1.0, MOTOR_SLOPE = 2.1875;

// Torque in N m with which the motor's own friction opposes its motion: from MOTOR_WIDTH on Coulomb's. It is three times
// continuously differentiable, which preserves the integrator's order, without a root or a division.
template <class P> INLINE Number<P> motor_friction(Number<P> theta_dot, const P& p) {
  using T = Number<P>;
  T ratio = theta_dot * (1.0 / MOTOR_WIDTH);
  T z = min(ratio * ratio, T(1.0));
  T steep = fma(z * z, fma(-0.3125, z, 1.3125), fma(-MOTOR_SLOPE, z, MOTOR_SLOPE));
  return p.motor_friction * clip(ratio, T(1.0)) * steep;
}

// theta'' in rad/s^2 on a platform at rest: the first row of Eq. (1) with x'' = 0.
template <class P> INLINE Number<P> stick_acceleration(Number<P> theta, Number<P> theta_dot, Number<P> u, const P& p) {
  auto inertia = p.m * p.l * p.l;
  auto [sin, cos] = sincos(theta);
  if constexpr (P::rough) u = u + (p.m * p.l * p.downhill * cos - motor_friction(theta_dot, p));
  else if constexpr (P::geared) u = u - motor_friction(theta_dot, p);
  auto free = fma(-(p.k / inertia), theta, fma(-(p.c / inertia), theta_dot, u * (1.0 / inertia)));
  return fma(p.g / p.l, sin, free);
}

template <class T> struct Accelerations { T theta_ddot, x_ddot, normal; };

// theta'', x'' and N of Eq. (1) with f = slip mu N, one formula for slip and stick (slip = 0 pins x'' = 0); N is not
// clamped and can be below zero.
template <class P>
INLINE Accelerations<Number<P>> pressed_accelerations(Number<P> theta, Number<P> theta_dot, Number<P> x_dot, Number<P> slip,
                                                      Number<P> mu, Number<P> u, const P& p) {
  using T = Number<P>;
  auto [sin, cos] = sincos(theta);
  T share = slip * slip * p.mass_ratio;
  T rough = slip * mu;
  // Most floors have no Stribeck curve, which saves a division.
  if constexpr (P::rough) {
    if (any(p.stribeck_excess != 0.0)) rough = rough * stribeck(x_dot, p);
  }
  T squared = theta_dot * theta_dot;
  T weight = (p.M + p.m) * p.g;
  T brake = rough * p.g;
  if (pivot_on_contact(p)) {
    T pivot = p.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * sin;  // Eq. (7)
    weight = weight - pivot;
    brake = brake - rough * pivot / (p.M + p.m);
  }
  if constexpr (P::rough) brake = brake + slip * slip * (p.downhill + (p.viscous * x_dot - p.push) / (p.M + p.m));
  // The second row over M + m: x'' = rest + share l tilted theta''. N holds theta'' too, hence cos + slip mu sin.
  T tilted = fma(rough, sin, cos);
  T rest = fma(share * p.l, fma(rough, cos, -sin) * squared, -brake);
  // The first row over m l^2: theta'' = free + cos x'' / l.
  T free = stick_acceleration(theta, theta_dot, u, p);
  // A product with the reciprocal, so that the division need not wait for the numerator.
  T theta_ddot = fma(cos * (1.0 / p.l), rest, free) * (1.0 / fma(-share * cos, tilted, 1.0));
  T x_ddot = fma(share * p.l * tilted, theta_ddot, rest);
  return {theta_ddot, x_ddot, fma(-(p.m * p.l), fma(squared, cos, theta_ddot * sin), weight)};
}

// The same with N clamped at zero: a floor does not pull. For one environment.
template <class P>
INLINE Accelerations<Number<P>> accelerations(Number<P> theta, Number<P> theta_dot, Number<P> x_dot, Number<P> slip,
                                              Number<P> u, const P& p) {
  auto a = pressed_accelerations(theta, theta_dot, x_dot, slip, kinetic_friction(slip, p), u, p);
  if (a.normal < 0.0) {
    a = pressed_accelerations(theta, theta_dot, x_dot, slip, 0.0, u, p);
    a.normal = 0.0;
  }
  return a;
}

template <class T> struct Margin { T value, force; };

// Static friction limit minus |driving force|, in N, and the driving force itself; stick needs a margin >= 0.
template <class P> INLINE Margin<Number<P>> stick_margin(Number<P> theta, Number<P> theta_dot, Number<P> u, const P& p) {
  using T = Number<P>;
  T theta_ddot = stick_acceleration(theta, theta_dot, u, p);
  T force = driving_force(theta, theta_dot, theta_ddot, p);
  T limit = p.static_ratio * kinetic_friction(force, p) * max(T(0.0), normal_force(theta, theta_dot, theta_ddot, p));
  return {limit - abs(force), force};
}

// The phase of the contact at rest: 0.0 below the static limit, else the load's direction.
template <class P> INLINE Number<P> phase_at_rest(Number<P> theta, Number<P> theta_dot, Number<P> u, const P& p) {
  auto [margin, force] = stick_margin(theta, theta_dot, u, p);
  return select(margin >= 0.0, 0.0, select(force > 0.0, Number<P>(1.0), Number<P>(-1.0)));
}

// The phase of the contact: the direction of motion, or `phase_at_rest`. For one environment.
template <class P> INLINE Number<P> contact_phase(const State<Number<P>>& s, Number<P> u, const P& p) {
  if (s.x_dot > 0.0) return 1.0;
  if (s.x_dot < 0.0) return -1.0;
  return phase_at_rest(s.theta, s.theta_dot, u, p);
}

// Time derivative of `stick_margin` in N/s along a stick phase, at constant torque.
template <class P> INLINE Number<P> stick_margin_rate(Number<P> theta, Number<P> theta_dot, Number<P> u, const P& p) {
  using T = Number<P>;
  auto [sin, cos] = sincos(theta);
  auto ml = p.m * p.l;
  T a = stick_acceleration(theta, theta_dot, u, p);
  T torque_rate = ml * p.g * cos * theta_dot - p.k * theta_dot - p.c * a;
  if constexpr (P::geared) {
    T s = clip(theta_dot * (1.0 / MOTOR_WIDTH), T(1.0));
    T left = 1.0 - s * s;
    T slope = p.motor_friction * (MOTOR_SLOPE / MOTOR_WIDTH) * (left * left * left);
    torque_rate = torque_rate - (ml * p.downhill * sin * theta_dot + slope * a);
  }
  T jerk = torque_rate / (ml * p.l);
  T force = driving_force(theta, theta_dot, a, p);
  T force_rate = ml * (cos * jerk - 3.0 * sin * theta_dot * a - cos * theta_dot * theta_dot * theta_dot);
  T normal_rate = -ml * (sin * jerk + 3.0 * cos * theta_dot * a - sin * theta_dot * theta_dot * theta_dot);
  if (pivot_on_contact(p)) {
    T pivot_rate = (p.k * theta_dot + p.c * a) * sin + (p.k * theta + p.c * theta_dot) * cos * theta_dot;
    normal_rate = normal_rate - p.pivot_torque_on_contact * pivot_rate;
  }
  T limit_rate = p.static_ratio * kinetic_friction(force, p) * normal_rate;
  return select(force > 0.0, limit_rate - force_rate, limit_rate + force_rate);
}

template <class T> struct Stepped {
  State<T> end;
  // The smallest N of the stages: if it is negative, the platform did not press on the floor during the whole step.
  T smallest;
};

// One classical Runge-Kutta step of h seconds inside one phase, with the friction coefficient mu; `first` is
// `pressed_accelerations` at the start.
template <class P>
INLINE Stepped<Number<P>> runge_kutta(const State<Number<P>>& s, Number<P> slip, Number<P> mu, Number<P> u, const P& p,
                                      Number<P> h, const Accelerations<Number<P>>& first) {
  using T = Number<P>;
  // The accelerations do not depend on x, and not on x_dot on a level floor with Coulomb friction: sums suffice.
  T half = 0.5 * h;
  T theta_2 = s.theta + half * s.theta_dot;
  auto [a1, b1, normal_1] = first;
  auto [a2, b2, normal_2] = pressed_accelerations(theta_2, s.theta_dot + half * a1, s.x_dot + half * b1, slip, mu, u, p);
  T theta_3 = theta_2 + half * half * a1, theta_dot_3 = s.theta_dot + half * a2;
  auto [a3, b3, normal_3] = pressed_accelerations(theta_3, theta_dot_3, s.x_dot + half * b2, slip, mu, u, p);
  T theta_4 = s.theta + h * s.theta_dot + half * h * a2;
  auto [a4, b4, normal_4] = pressed_accelerations(theta_4, s.theta_dot + h * a3, s.x_dot + h * b3, slip, mu, u, p);
  T sixth = h / 6.0;
  return {{s.theta + h * s.theta_dot + h * sixth * (a1 + a2 + a3),
           s.theta_dot + sixth * (a1 + 2.0 * (a2 + a3) + a4),
           s.x + h * s.x_dot + h * sixth * (b1 + b2 + b3),
           s.x_dot + sixth * (b1 + 2.0 * (b2 + b3) + b4)},
          min(min(normal_1, normal_2), min(normal_3, normal_4))};
}

template <class T> struct Boundary { T value, rate; };

// The quantity that stays positive while the phase lasts, and its time derivative: m/s in slip, N in stick. For one
// environment.
template <class P>
INLINE Boundary<Number<P>> boundary(const State<Number<P>>& s, Number<P> x_ddot, Number<P> slip, Number<P> u, const P& p) {
  if (slip == 0.0) return {stick_margin(s.theta, s.theta_dot, u, p).value, stick_margin_rate(s.theta, s.theta_dot, u, p)};
  return {slip * s.x_dot, slip * x_ddot};
}

// Whether the boundary may have been crossed within h seconds. The tangent bounds a convex function from below: no dip
// inside the step can escape the second test.
template <class T> INLINE auto crosses(T before, T rate, T after, T h) {
  return (after < 0.0) | ((before > 0.0) & (before + h * rate < 0.0));
}

template <class T, class M> struct Smooth {
  State<T> end;
  Accelerations<T> first;
  T smallest;
  // Whether the phase lasts; if not, `event_step` takes the step.
  M lasts;
};

// A step of h seconds inside one phase. may_stick = false asserts that slip is nowhere 0.0, which saves a third of the
// work.
template <bool may_stick, class P>
INLINE auto smooth_step(const State<Number<P>>& s, Number<P> slip, Number<P> u, const P& p, Number<P> h) {
  using T = Number<P>;
  T mu = kinetic_friction(slip, p);
  auto first = pressed_accelerations(s.theta, s.theta_dot, s.x_dot, slip, mu, u, p);
  auto [end, smallest] = runge_kutta(s, slip, mu, u, p, h, first);
  T before = slip * s.x_dot, rate = slip * first.x_ddot, after = slip * end.x_dot;
  auto stopped = end.x_dot == 0.0;
  if constexpr (may_stick) {
    auto sticks = slip == 0.0;
    before = select(sticks, stick_margin(s.theta, s.theta_dot, u, p).value, before);
    rate = select(sticks, stick_margin_rate(s.theta, s.theta_dot, u, p), rate);
    after = select(sticks, stick_margin(end.theta, end.theta_dot, u, p).value, after);
    stopped = stopped & !sticks;
  }
  auto lasts = !(crosses(before, rate, after, h) | stopped | (smallest < 0.0));
  return Smooth<T, decltype(lasts)>{end, first, smallest, lasts};
}

// Integral of |theta_dot| over h seconds that turned the pendulum by `turned`; theta_dot went from start to end.
template <class T> INLINE T swept(T start, T end, T turned, T h) {
  return select(start * end >= 0.0, abs(turned), 0.5 * h * (start * start + end * end) / (abs(start) + abs(end)));
}
}  // namespace LEVEL
