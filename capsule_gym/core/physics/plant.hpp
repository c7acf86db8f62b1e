// The physics of the plant within a phase of contact; SI units.
//
// The plant is the paper's Eq. (1), its misprints corrected (docs/physics.md names them), with q =
// [theta, x] and the friction force f:
//
//     m l^2 theta'' - m l cos(theta) x'' - m g l sin(theta) + k theta + c theta' = u
//     (M + m) x'' - m l cos(theta) theta'' + m l sin(theta) theta'^2 + f = 0
//
// on a level floor with Coulomb friction alone. Within a phase of contact the motion is smooth.
// `slip` names the phase: +1.0 forwards, -1.0 backwards, 0.0 stick. It follows from the state: the
// platform sticks only where x_dot is exactly 0.0.
//
// The floor of an extended plant may slope (g is then g cos(slope), and a = g sin(slope)), its
// friction may depend on the speed (b is the viscous coefficient, v_s the speed of the Stribeck
// curve), the motor may have friction u_f, and a force F may push the platform:
//
//     m l^2 theta'' - m l cos(theta) x'' - m l (g sin(theta) + a cos(theta)) + k theta + c theta'
//         = u - u_f (35 s - 35 s^3 + 21 s^5 - 5 s^7) / 16
//     (M + m) (x'' + a) + b x' - m l cos(theta) theta'' + m l sin(theta) theta'^2 + f = F
//
// with f = d mu (1 + (static_ratio - 1) / (1 + (x' / v_s)^2)) N in slip in the direction d, and s =
// theta' / w, clipped to [-1, 1].
//
// `fma(a, b, c)` is a b + c, rounded once.
#pragma once
#include "../numbers/elementary.hpp"

namespace LEVEL {
// The constants of a plant that an `extended` one adds are zero in the others, which do not read
// them.
enum class Kind {
  coulomb,   // a level floor with Coulomb friction alone, and Newton's normal force
  extended,  // everything
  varied,    // everything, and the constants from m on differ between environments
};

template <bool condition, class A, class B> struct Choose {
  using type = A;
};
template <class A, class B> struct Choose<false, A, B> {
  using type = B;
};

// The names of the constants from m on; their values are in SI units.
#define CAPSULE_PLANT(FIELD)                                         \
  FIELD(m)                                                           \
  FIELD(l)                                                           \
  FIELD(g) /* gravity's component perpendicular to the floor */      \
  FIELD(k)                                                           \
  FIELD(c)                                                           \
  FIELD(static_ratio)                                                \
  FIELD(backward_ratio)                                              \
  FIELD(downhill)        /* g sin(slope) */                          \
  FIELD(viscous)         /* the floor's viscous coefficient */       \
  FIELD(stribeck_excess) /* static_ratio - 1 */                      \
  FIELD(stribeck_rate)   /* inverse of the Stribeck curve's speed */ \
  FIELD(motor_friction)                                              \
  FIELD(push) /* the force that pushes the platform forwards */

// Those from m on as `Capsule` names them, which `derive` turns into those of `Plant`.
#define CAPSULE_CONSTANTS(FIELD) \
  FIELD(m)                       \
  FIELD(l)                       \
  FIELD(g)                       \
  FIELD(k)                       \
  FIELD(c)                       \
  FIELD(static_ratio)            \
  FIELD(backward_ratio)          \
  FIELD(viscous)                 \
  FIELD(stribeck_speed)          \
  FIELD(slope)                   \
  FIELD(motor_friction)
template <class T> struct Constants {
  CAPSULE_CONSTANTS(CAPSULE_NUMBER)
};

template <class T> struct State {
  T theta, theta_dot, x, x_dot;
};

// rad: the ball meets the platform.
constexpr double THETA_LIMIT = PI / 2.0;
// Bounds of the observation, which is clipped to them. Full torque switched in the worst phase
// gives 13 rad/s and 1.2 m/s on the capsule of the paper; the rest is room for other capsules.
constexpr double THETA_DOT_BOUND = 20.0;  // rad/s
constexpr double X_DOT_BOUND = 2.0;       // m/s

template <class T> struct Accelerations {
  T theta_ddot, x_ddot, normal;
};
template <class T> struct Margin {
  T value, force;
};

// Rate in rad/s below which the motor's Coulomb friction is smooth, so that the integrator resolves
// a change of sign.
constexpr double MOTOR_WIDTH = 1.0;
// Slope of the motor's friction at rest, in units of the friction over MOTOR_WIDTH: 35 / 16.
constexpr double MOTOR_SLOPE = 2.1875;

template <class T, Kind kind_> struct Plant {
  using Number = T;
  static constexpr Kind kind = kind_;
  static constexpr bool varied = kind == Kind::varied;
  // Whether all that an extended plant adds may act.
  static constexpr bool extended = kind == Kind::extended || varied;
  using Constant = typename Choose<varied, T, double>::type;

  T M;
  T mu;
  T mass_ratio;                    // m / (M + m), which saves divisions
  double pivot_torque_on_contact;  // 1.0 for the paper's normal force, 0.0 for Newton's
#define FIELD(name) Constant name;
  CAPSULE_PLANT(FIELD)
#undef FIELD

  // Whether the paper's normal force is chosen.
  INLINE bool pivot_on_contact() const { return extended && pivot_torque_on_contact != 0.0; }

  // Friction coefficient while sliding fast in the direction of `slip` (+1.0 or -1.0).
  INLINE T kinetic_friction(T slip) const { return select(slip < 0.0, mu * backward_ratio, mu); }

  // The friction coefficient at a velocity, from the one at high speed, `fast`: the Stribeck curve
  // of Hess and Soom (1990). The sign of `fast` is kept.
  INLINE T friction_coefficient(T fast, T x_dot) const {
    if constexpr (extended) {
      // Most floors have no Stribeck curve, which saves a division.
      if (acts(stribeck_excess)) {
        auto ratio = x_dot * stribeck_rate;
        return fast * (1.0 + stribeck_excess / (1.0 + ratio * ratio));
      }
    }
    return fast;
  }

  // What the paper's option subtracts from the normal force, N: Eq. (7).
  INLINE T pivot_force(T theta, T theta_dot, T sin) const {
    return pivot_torque_on_contact * (k * theta + c * theta_dot) * sin;
  }

  // Newton's law on the vertical: the force of the floor on a platform with this weight in N;
  // `squared` is theta_dot^2. `pressed_accelerations` fuses the multiply-adds, which saves time,
  // `normal_force` does not: the bits of episodes depend on both.
  template <bool fused>
  INLINE T pressing_force(T weight, T theta_ddot, T sin, T cos, T squared) const {
    // Downward acceleration of the ball over l.
    T fall = multiply_add<fused, T>(squared, cos, theta_ddot * sin);
    return multiply_add<fused, T>(-(m * l), fall, weight);
  }

  // Force of the floor on the platform in N, before the clamp at zero.
  INLINE T normal_force(T theta, T theta_dot, T theta_ddot) const {
    auto [sin, cos] = sincos(theta);
    T newton = pressing_force<false>((M + m) * g, theta_ddot, sin, cos, theta_dot * theta_dot);
    if (pivot_on_contact()) return newton - pivot_force(theta, theta_dot, sin);
    return newton;
  }

  // Horizontal force in N with which the pendulum pushes a platform that does not accelerate;
  // friction opposes it.
  INLINE T driving_force(T theta, T theta_dot, T theta_ddot) const {
    auto [sin, cos] = sincos(theta);
    auto force = m * l * (cos * theta_ddot - sin * theta_dot * theta_dot);
    if constexpr (extended) force = force + (push - (M + m) * downhill);
    return force;
  }

  // The force of Coulomb friction on a sliding platform, N, against the direction of `slip`;
  // `normal` is not negative. `pressed_accelerations` contains the same force, but cannot call this
  // function: N depends on the unknown theta''.
  INLINE T friction_force(T slip, T x_dot, T normal) const {
    return friction_coefficient(slip * kinetic_friction(slip), x_dot) * normal;
  }

  // The largest friction force on a platform at rest under a load in the direction of `force`, N.
  INLINE T static_friction_limit(T force, T normal) const {
    return static_ratio * kinetic_friction(force) * normal;
  }

  // Torque in N m with which the motor's own friction opposes its motion: from MOTOR_WIDTH on
  // Coulomb's. It is three times continuously differentiable, which preserves the integrator's
  // order, without a root or a division.
  INLINE T motor_drag(T theta_dot) const {
    T ratio = theta_dot * (1.0 / MOTOR_WIDTH);
    T z = min(ratio * ratio, T(1.0));
    T steep = fma(z * z, fma(-0.3125, z, 1.3125), fma(-MOTOR_SLOPE, z, MOTOR_SLOPE));
    return motor_friction * clip(ratio, T(1.0)) * steep;
  }

  // Derivative of `motor_drag` over theta_dot, N m s.
  INLINE T motor_drag_slope(T theta_dot) const {
    T ratio = clip(theta_dot * (1.0 / MOTOR_WIDTH), T(1.0));
    T left = 1.0 - ratio * ratio;
    return motor_friction * (MOTOR_SLOPE / MOTOR_WIDTH) * (left * left * left);
  }

  // theta'' in rad/s^2 on a platform at rest: the first row of Eq. (1) with x'' = 0.
  INLINE T stick_acceleration(T theta, T theta_dot, T u) const {
    auto inertia = m * l * l;
    auto [sin, cos] = sincos(theta);
    if constexpr (extended) u = u + (m * l * downhill * cos - motor_drag(theta_dot));
    auto free = fma(-(k / inertia), theta, fma(-(c / inertia), theta_dot, u * (1.0 / inertia)));
    return fma(g / l, sin, free);
  }

  // theta'', x'' and N of Eq. (1), one formula for slip and stick (slip = 0 pins x'' = 0); N is not
  // clamped and can be below zero. `mu` is the friction coefficient at high speed.
  //
  // In slip the second row is (M + m) x'' = driving_force - friction_force - b x'. Both forces
  // depend on theta'': the solution contains them, but cannot call them. A test puts the solution
  // into both functions.
  INLINE Accelerations<T> pressed_accelerations(T theta, T theta_dot, T x_dot, T slip, T mu,
                                                T u) const {
    auto [sin, cos] = sincos(theta);
    T share = slip * slip * mass_ratio;
    T slip_mu = friction_coefficient(slip * mu, x_dot);
    T squared = theta_dot * theta_dot;
    T weight = (M + m) * g;
    T brake = slip_mu * g;
    if (pivot_on_contact()) {
      T pivot = pivot_force(theta, theta_dot, sin);
      weight = weight - pivot;
      brake = brake - slip_mu * pivot / (M + m);
    }
    if constexpr (extended) {
      // Most floors are level without viscous friction, which saves a division.
      if (acts(downhill) || acts(viscous) || acts(push)) {
        T deceleration = downhill + (viscous * x_dot - push) / (M + m);
        brake = brake + slip * slip * deceleration;
      }
    }
    // The second row over M + m: x'' = rest + share l tilted theta''. N holds theta'' too, hence
    // cos + slip mu sin.
    T tilted = fma(slip_mu, sin, cos);
    T rest = fma(share * l, fma(slip_mu, cos, -sin) * squared, -brake);
    // The first row over m l^2: theta'' = free + cos x'' / l.
    T free = stick_acceleration(theta, theta_dot, u);
    // A product with the reciprocal, so that the division need not wait for the numerator.
    T theta_ddot = fma(cos * (1.0 / l), rest, free) * (1.0 / fma(-share * cos, tilted, 1.0));
    T x_ddot = fma(share * l * tilted, theta_ddot, rest);
    return {theta_ddot, x_ddot, pressing_force<true>(weight, theta_ddot, sin, cos, squared)};
  }

  // The same with N clamped at zero: a floor does not pull. For one environment.
  INLINE Accelerations<T> accelerations(T theta, T theta_dot, T x_dot, T slip, T u) const {
    auto a = pressed_accelerations(theta, theta_dot, x_dot, slip, kinetic_friction(slip), u);
    if (a.normal < 0.0) {
      a = pressed_accelerations(theta, theta_dot, x_dot, slip, 0.0, u);
      a.normal = 0.0;
    }
    return a;
  }

  // Static friction limit minus |driving force|, in N, and the driving force itself; stick needs a
  // margin >= 0.
  INLINE Margin<T> stick_margin(T theta, T theta_dot, T u) const {
    T theta_ddot = stick_acceleration(theta, theta_dot, u);
    T force = driving_force(theta, theta_dot, theta_ddot);
    T limit = static_friction_limit(force, max(T(0.0), normal_force(theta, theta_dot, theta_ddot)));
    return {limit - abs(force), force};
  }

  // The phase of the contact: the direction of motion; at rest 0.0 below the static limit, else the
  // load's direction.
  INLINE T contact_phase(const State<T>& s, T u) const {
    auto rests = s.x_dot == 0.0;
    if (!any(rests)) return select(s.x_dot > 0.0, T(1.0), T(-1.0));
    auto [margin, force] = stick_margin(s.theta, s.theta_dot, u);
    T direction = select(rests, force, s.x_dot);
    return select(rests & (margin >= 0.0), T(0.0), select(direction > 0.0, T(1.0), T(-1.0)));
  }

  // Time derivative of `stick_margin` in N/s along a stick phase, at constant torque.
  INLINE T stick_margin_rate(T theta, T theta_dot, T u) const {
    auto [sin, cos] = sincos(theta);
    auto ml = m * l;
    T a = stick_acceleration(theta, theta_dot, u);
    T torque_rate = ml * g * cos * theta_dot - k * theta_dot - c * a;
    if constexpr (extended) {
      T gravity_rate = ml * downhill * sin * theta_dot;
      torque_rate = torque_rate - (gravity_rate + motor_drag_slope(theta_dot) * a);
    }
    T jerk = torque_rate / (ml * l);
    T force = driving_force(theta, theta_dot, a);
    T force_rate =
        ml * (cos * jerk - 3.0 * sin * theta_dot * a - cos * theta_dot * theta_dot * theta_dot);
    T normal_rate =
        -ml * (sin * jerk + 3.0 * cos * theta_dot * a - sin * theta_dot * theta_dot * theta_dot);
    if (pivot_on_contact()) {
      T pivot_rate = (k * theta_dot + c * a) * sin + (k * theta + c * theta_dot) * cos * theta_dot;
      normal_rate = normal_rate - pivot_torque_on_contact * pivot_rate;
    }
    T limit_rate = static_friction_limit(force, normal_rate);  // the limit is linear in N
    return select(force > 0.0, limit_rate - force_rate, limit_rate + force_rate);
  }
};

template <class P> using Number = typename P::Number;

// Whether a plant with these constants is not a level floor with Coulomb friction alone.
template <class T> INLINE bool is_extended(const Constants<T>& given) {
  return given.viscous != 0.0 || given.stribeck_speed != 0.0 || given.slope != 0.0 ||
         given.motor_friction != 0.0;
}

// The plant with these constants, which nothing pushes; M and mu are left to the caller.
template <class T> INLINE Plant<T, Kind::varied> derive(const Constants<T>& given) {
  auto [sin, cos] = sincos(given.slope);
  Plant<T, Kind::varied> p = {};
  p.m = given.m;
  p.l = given.l;
  p.g = given.g * cos;
  p.k = given.k;
  p.c = given.c;
  p.static_ratio = given.static_ratio;
  p.backward_ratio = given.backward_ratio;
  p.downhill = given.g * sin;
  p.viscous = given.viscous;
  p.motor_friction = given.motor_friction;
  if (given.stribeck_speed > 0.0) {
    p.stribeck_excess = given.static_ratio - 1.0;
    p.stribeck_rate = 1.0 / given.stribeck_speed;
  }
  return p;
}
}  // namespace LEVEL
