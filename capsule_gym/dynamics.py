"""The physics: plain scalar functions of SI quantities that numba compiles for every use.

The plant is the paper's Eq. (1), its misprints corrected (docs/physics.md names them), with q = [theta, x] and the
friction force f:

    m l^2 theta'' - m l cos(theta) x'' - m g l sin(theta) + k theta + c theta' = u
    (M + m) x'' - m l cos(theta) theta'' + m l sin(theta) theta'^2 + f = 0

Within a phase of contact the motion is smooth. `slip` names the phase: +1.0 forwards, -1.0 backwards, 0.0 stick.
The phase follows from the state alone: the platform sticks only where x_dot is exactly 0.0.

That is the plant on a level floor with Coulomb friction alone. Where `Plant.extended` is not 0.0, a constant of the
compiler's, the floor may slope (g is then g cos(slope), and a = g sin(slope)), its friction may depend on the speed (b
is the viscous coefficient, v_s the speed of the Stribeck curve), the motor may have friction u_f, and a force F may
push the platform. The equations become

    m l^2 theta'' - m l cos(theta) x'' - m l (g sin(theta) + a cos(theta)) + k theta + c theta'
        = u - u_f (35 s - 35 s^3 + 21 s^5 - 5 s^7) / 16
    (M + m) (x'' + a) + b x' - m l cos(theta) theta'' + m l sin(theta) theta'^2 + f = F

with f = d mu (1 + (static_ratio - 1) / (1 + (x' / v_s)^2)) N in slip in the direction d, and s = theta' / w, clipped to
[-1, 1].

Every function is ordinary Python; `jitable` lets compiled code call it too. A step inside one phase, `smooth_step`, is
free of branches: compilers take several environments through it at once. Steps through changes of phase are in
`capsule_gym.contact`. `fma(a, b, c)` is a b + c.
"""

from __future__ import annotations

from capsule_gym.compilation import inlined, jitable
from capsule_gym.elementary import clip, fma, sincos
from capsule_gym.parameters import LEVEL, MOTOR_SLOPE, MOTOR_WIDTH, Plant


@inlined
def kinetic_friction(slip: float, p: Plant) -> float:
    """Friction coefficient while sliding fast in the direction of `slip` (+1.0 or -1.0)."""
    return p.mu * p.backward_ratio if slip < 0.0 else p.mu


@inlined
def stribeck(x_dot: float, p: Plant) -> float:
    """Friction coefficient at a velocity over the one at high speed: the Stribeck curve of Hess and Soom (1990)."""
    ratio = x_dot * p.stribeck_rate
    return 1.0 + p.stribeck_excess / (1.0 + ratio * ratio)


@inlined
def normal_force(theta: float, theta_dot: float, theta_ddot: float, p: Plant) -> float:
    """Force of the floor on the platform in N, before the clamp at zero: Newton's law on the vertical.

    With the paper's option the pivot's torque is subtracted as (7) prints it.
    """
    sin, cos = sincos(theta)
    newton = (p.M + p.m) * p.g - p.m * p.l * (theta_ddot * sin + theta_dot * theta_dot * cos)
    if p.pivot_torque_on_contact != 0.0:
        return newton - p.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * sin  # Eq. (7)
    return newton


@inlined
def driving_force(theta: float, theta_dot: float, theta_ddot: float, p: Plant) -> float:
    """Horizontal force in N with which the pendulum pushes a platform that does not accelerate; friction opposes it."""
    sin, cos = sincos(theta)
    force = p.m * p.l * (cos * theta_ddot - sin * theta_dot * theta_dot)
    if 0.0 < p.extended < LEVEL:
        force += p.push - (p.M + p.m) * p.downhill
    return force


@inlined
def motor_friction(theta_dot: float, p: Plant) -> float:
    """Torque in N m with which the motor's own friction opposes its motion: from MOTOR_WIDTH on Coulomb's.

    It is three times continuously differentiable, which preserves the integrator's order, without a root or a division.
    """
    ratio = theta_dot * (1.0 / MOTOR_WIDTH)
    z = min(ratio * ratio, 1.0)
    steep = fma(z * z, fma(-0.3125, z, 1.3125), fma(-MOTOR_SLOPE, z, MOTOR_SLOPE))
    return p.motor_friction * clip(ratio, 1.0) * steep


@inlined
def stick_acceleration(theta: float, theta_dot: float, u: float, p: Plant) -> float:
    """theta'' in rad/s^2 on a platform at rest: the first row of Eq. (1) with x'' = 0."""
    inertia = p.m * p.l * p.l
    sin, cos = sincos(theta)
    if p.extended == LEVEL:
        u -= motor_friction(theta_dot, p)
    elif p.extended != 0.0:
        u += p.m * p.l * p.downhill * cos - motor_friction(theta_dot, p)
    free = fma(-(p.k / inertia), theta, fma(-(p.c / inertia), theta_dot, u * (1.0 / inertia)))
    return fma(p.g / p.l, sin, free)


@inlined
def pressed_accelerations(
    theta: float, theta_dot: float, x_dot: float, slip: float, mu: float, u: float, p: Plant
) -> tuple[float, float, float]:
    """theta'', x'' and N of Eq. (1) with f = slip mu N, one formula for slip and stick (slip = 0 pins x'' = 0).

    N is not clamped and can be below zero.
    """
    sin, cos = sincos(theta)
    share = slip * slip * p.mass_ratio
    rough = slip * mu
    # Most floors have no Stribeck curve, which saves a division.
    if 0.0 < p.extended < LEVEL and p.stribeck_excess != 0.0:
        rough *= stribeck(x_dot, p)
    squared = theta_dot * theta_dot
    weight = (p.M + p.m) * p.g
    brake = rough * p.g
    if p.pivot_torque_on_contact != 0.0:
        pivot = p.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * sin  # Eq. (7)
        weight -= pivot
        brake -= rough * pivot / (p.M + p.m)
    if 0.0 < p.extended < LEVEL:
        brake += slip * slip * (p.downhill + (p.viscous * x_dot - p.push) / (p.M + p.m))
    # The second row over M + m: x'' = rest + share l tilted theta''. N holds theta'' too, hence cos + slip mu sin.
    tilted = fma(rough, sin, cos)
    rest = fma(share * p.l, fma(rough, cos, -sin) * squared, -brake)
    # The first row over m l^2: theta'' = free + cos x'' / l.
    free = stick_acceleration(theta, theta_dot, u, p)
    # A product with the reciprocal, so that the division need not wait for the numerator.
    theta_ddot = fma(cos * (1.0 / p.l), rest, free) * (1.0 / fma(-share * cos, tilted, 1.0))
    x_ddot = fma(share * p.l * tilted, theta_ddot, rest)
    return theta_ddot, x_ddot, fma(-(p.m * p.l), fma(squared, cos, theta_ddot * sin), weight)


@jitable
def accelerations(
    theta: float, theta_dot: float, x_dot: float, slip: float, u: float, p: Plant
) -> tuple[float, float, float]:
    """theta'' in rad/s^2, x'' in m/s^2 and the normal force in N, clamped at zero: a floor does not pull.

    Args:
        theta: angle, rad.
        theta_dot: its rate, rad/s.
        x_dot: velocity of the platform, m/s.
        slip: phase of the contact, +1.0, -1.0 or 0.0 (stick).
        u: motor torque, N m.
        p: the plant.
    """
    mu = kinetic_friction(slip, p)
    theta_ddot, x_ddot, normal = pressed_accelerations(theta, theta_dot, x_dot, slip, mu, u, p)
    if normal < 0.0:
        theta_ddot, x_ddot, normal = pressed_accelerations(theta, theta_dot, x_dot, slip, 0.0, u, p)
        normal = 0.0
    return theta_ddot, x_ddot, normal


@inlined
def stick_margin(theta: float, theta_dot: float, u: float, p: Plant) -> tuple[float, float]:
    """Static friction limit minus |driving force|, in N, and the driving force itself; stick needs a margin >= 0."""
    theta_ddot = stick_acceleration(theta, theta_dot, u, p)
    force = driving_force(theta, theta_dot, theta_ddot, p)
    limit = p.static_ratio * kinetic_friction(force, p) * max(0.0, normal_force(theta, theta_dot, theta_ddot, p))
    return limit - abs(force), force


@inlined
def phase_at_rest(theta: float, theta_dot: float, u: float, p: Plant) -> float:
    """The phase of the contact at rest: 0.0 below the static limit, else the load's direction."""
    margin, force = stick_margin(theta, theta_dot, u, p)
    return 0.0 if margin >= 0.0 else 1.0 if force > 0.0 else -1.0


@inlined
def contact_phase(theta: float, theta_dot: float, x_dot: float, u: float, p: Plant) -> float:
    """The phase of the contact: the direction of motion, or `phase_at_rest`."""
    if x_dot > 0.0:
        return 1.0
    if x_dot < 0.0:
        return -1.0
    return phase_at_rest(theta, theta_dot, u, p)


@inlined
def stick_margin_rate(theta: float, theta_dot: float, u: float, p: Plant) -> float:
    """Time derivative of `stick_margin` in N/s along a stick phase, at constant torque."""
    sin, cos = sincos(theta)
    ml = p.m * p.l
    a = stick_acceleration(theta, theta_dot, u, p)
    torque_rate = ml * p.g * cos * theta_dot - p.k * theta_dot - p.c * a
    if p.extended != 0.0:
        s = clip(theta_dot * (1.0 / MOTOR_WIDTH), 1.0)
        left = 1.0 - s * s
        slope = p.motor_friction * (MOTOR_SLOPE / MOTOR_WIDTH) * (left * left * left)
        torque_rate -= ml * p.downhill * sin * theta_dot + slope * a
    jerk = torque_rate / (ml * p.l)
    force = driving_force(theta, theta_dot, a, p)
    force_rate = ml * (cos * jerk - 3.0 * sin * theta_dot * a - cos * theta_dot * theta_dot * theta_dot)
    normal_rate = -ml * (sin * jerk + 3.0 * cos * theta_dot * a - sin * theta_dot * theta_dot * theta_dot)
    if p.pivot_torque_on_contact != 0.0:
        pivot_rate = (p.k * theta_dot + p.c * a) * sin + (p.k * theta + p.c * theta_dot) * cos * theta_dot
        normal_rate -= p.pivot_torque_on_contact * pivot_rate
    limit_rate = p.static_ratio * kinetic_friction(force, p) * normal_rate
    return limit_rate - force_rate if force > 0.0 else limit_rate + force_rate


@inlined
def runge_kutta(
    theta: float,
    theta_dot: float,
    x: float,
    x_dot: float,
    slip: float,
    mu: float,
    u: float,
    p: Plant,
    h: float,
    first: tuple[float, float, float],
) -> tuple[float, float, float, float, float]:
    """One classical Runge-Kutta step of h seconds inside one phase, with the friction coefficient mu.

    `first` is `pressed_accelerations` at the start.

    Returns:
        The state afterwards, and the smallest N of the stages: if it is negative, the platform did not press on the
        floor during the whole step.
    """
    # The accelerations do not depend on x, and not on x_dot on a level floor with Coulomb friction: sums suffice.
    half = 0.5 * h
    theta_2 = theta + half * theta_dot
    a1, b1, normal_1 = first
    a2, b2, normal_2 = pressed_accelerations(theta_2, theta_dot + half * a1, x_dot + half * b1, slip, mu, u, p)
    theta_3, theta_dot_3 = theta_2 + half * half * a1, theta_dot + half * a2
    a3, b3, normal_3 = pressed_accelerations(theta_3, theta_dot_3, x_dot + half * b2, slip, mu, u, p)
    theta_4 = theta + h * theta_dot + half * h * a2
    a4, b4, normal_4 = pressed_accelerations(theta_4, theta_dot + h * a3, x_dot + h * b3, slip, mu, u, p)
    sixth = h / 6.0
    return (
        theta + h * theta_dot + h * sixth * (a1 + a2 + a3),
        theta_dot + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        x + h * x_dot + h * sixth * (b1 + b2 + b3),
        x_dot + sixth * (b1 + 2.0 * (b2 + b3) + b4),
        min(min(normal_1, normal_2), min(normal_3, normal_4)),
    )


@inlined
def boundary(
    theta: float, theta_dot: float, x_dot: float, x_ddot: float, slip: float, u: float, p: Plant
) -> tuple[float, float]:
    """The quantity that stays positive while the phase lasts, and its time derivative: m/s in slip, N in stick."""
    if slip == 0.0:
        return stick_margin(theta, theta_dot, u, p)[0], stick_margin_rate(theta, theta_dot, u, p)
    return slip * x_dot, slip * x_ddot


@inlined
def crosses(before: float, rate: float, after: float, h: float) -> bool:
    """Whether the boundary may have been crossed within h seconds.

    The tangent bounds a convex function from below: no dip inside the step can escape the second test.
    """
    return after < 0.0 or (before > 0.0 and before + h * rate < 0.0)


@inlined
def smooth_step(
    theta: float, theta_dot: float, x: float, x_dot: float, slip: float, u: float, p: Plant, h: float, may_stick: bool
) -> tuple[float, float, float, float, float, float, float, float, bool]:
    """`contact.step` without an event: h seconds inside one phase, free of branches.

    Args:
        theta: angle from the upright, rad.
        theta_dot: its rate, rad/s.
        x: displacement of the platform, m.
        x_dot: its velocity, m/s.
        slip: the phase.
        u: motor torque, N m.
        p: the plant.
        h: length of the step, s.
        may_stick: False asserts that slip is not 0.0; if the compiler knows this, it saves a third of the work.

    Returns:
        The state afterwards; theta'', x'' and N at the start; the smallest N of the stages; and whether the phase
        lasts: if not, `contact.event_step` takes the step.
    """
    mu = kinetic_friction(slip, p)
    theta_ddot, x_ddot, normal = first = pressed_accelerations(theta, theta_dot, x_dot, slip, mu, u, p)
    theta_1, theta_dot_1, x_1, x_dot_1, smallest = runge_kutta(theta, theta_dot, x, x_dot, slip, mu, u, p, h, first)
    if may_stick:
        before, rate = boundary(theta, theta_dot, x_dot, x_ddot, slip, u, p)
        after = boundary(theta_1, theta_dot_1, x_dot_1, x_ddot, slip, u, p)[0]
        stopped = x_dot_1 == 0.0 and slip != 0.0
    else:
        before, rate, after = slip * x_dot, slip * x_ddot, slip * x_dot_1
        stopped = x_dot_1 == 0.0
    lasts = not (crosses(before, rate, after, h) or stopped or smallest < 0.0)
    return theta_1, theta_dot_1, x_1, x_dot_1, theta_ddot, x_ddot, normal, smallest, lasts


@inlined
def swept(start: float, end: float, turned: float, h: float) -> float:
    """Integral of |theta_dot| over h seconds that turned the pendulum by `turned`; theta_dot went from start to end."""
    if start * end >= 0.0:
        return abs(turned)
    return 0.5 * h * (start * start + end * end) / (abs(start) + abs(end))
