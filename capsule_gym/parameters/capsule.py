"""The plant: the constants of a capsule robot, with their checks."""

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

from capsule_gym.checks import check_choice, check_number
from capsule_gym.core import _core
from capsule_gym.core.native import evaluate
from capsule_gym.parameters.limits import LARGEST, SMALLEST, check_divisor

NormalForce = Literal["newton", "paper"]


class Plant(NamedTuple):
    """The constants of one plant as the core reads them: SI units, float64, no validation.

    The first three differ between the environments of a batch. mass_ratio, m / (M + m), saves
    divisions. g is the component of gravity perpendicular to the floor. Only where `extended` is
    1.0 does the core read the option for the paper's normal force, and the constants from
    `downhill` on: g sin(slope), the floor's viscous coefficient, static_ratio - 1 and the inverse
    speed of the Stribeck curve (0.0 without one), the motor's friction, and a force that pushes the
    platform forwards, N.
    """

    M: float
    mu: float
    mass_ratio: float
    pivot_torque_on_contact: float
    extended: float
    m: float
    l: float
    g: float
    k: float
    c: float
    static_ratio: float
    backward_ratio: float
    downhill: float
    viscous: float
    stribeck_excess: float
    stribeck_rate: float
    motor_friction: float
    push: float


# The constants that a `Randomization` draws besides M and mu, in the order of their draws.
CONSTANTS = tuple(_core.CONSTANTS)
# The smallest and the largest values, SI units; those of other constants are 0 and LARGEST.
LIMITS = dict.fromkeys(("M", "m", "l", "g", "backward_ratio"), (SMALLEST, LARGEST))
LIMITS |= {"static_ratio": (1.0, LARGEST), "slope": (-1.5, 1.5)}


def _check_size(name: str, value: Any, low: float, high: float = LARGEST) -> float:
    """Returns a constant of the plant as a float; outside its range a force might not be finite."""
    return check_number(name, value, f"a finite number from {low:g} to {high:g}", low, high)


@dataclass(frozen=True, kw_only=True)
class Capsule:
    """The constants of the capsule robot, in SI units.

    The defaults are those of Liu, Yu and Cang (2018), Sect. 5.

    Attributes:
        M: mass of the platform, kg.
        m: mass of the ball, kg.
        l: distance from the pivot to the ball, m.
        g: gravitational acceleration, m/s^2.
        k: stiffness of the torsional spring, N m/rad.
        c: viscous coefficient of the pivot, N m s/rad.
        mu: kinetic friction coefficient when the platform slides forwards, without dimension.
        static_ratio: static over kinetic friction coefficient, at least 1.
        backward_ratio: friction coefficient backwards over forwards (the paper's Remark 1:
            anisotropic contact).
        viscous: viscous friction of the floor, N s/m, in addition to Coulomb's.
        stribeck_speed: speed in m/s at which the friction coefficient is half way between its
            static and its kinetic value (Hess and Soom's curve); 0 for a jump at the start of slip.
        slope: angle by which the floor rises forwards, rad.
        motor_friction: Coulomb friction of the motor, N m, smooth below 1 rad/s.
        normal_force: "newton", from Newton's law, or "paper", which subtracts (k theta + c theta')
            sin(theta) as the paper's (7) does; that torque is internal, so the option serves the
            reproduction only.

    Raises:
        TypeError: if a field is of the wrong type.
        ValueError: if a field is out of range, or the plant admits Painleve's paradox.

    Examples:
        >>> Capsule(mu=0.1).plant().mu
        0.1
        >>> Capsule(l=-1.0)
        Traceback (most recent call last):
        ...
        ValueError: Capsule.l must be a finite number from 1e-12 to 1e+12, got -1.0
    """

    M: float = 0.5
    m: float = 0.138
    l: float = 0.3
    g: float = 9.81
    k: float = 0.36
    c: float = 0.0923
    mu: float = 0.01
    static_ratio: float = 1.0
    backward_ratio: float = 1.0
    viscous: float = 0.0
    stribeck_speed: float = 0.0
    slope: float = 0.0
    motor_friction: float = 0.0
    normal_force: NormalForce = "newton"

    def __post_init__(self) -> None:
        for name in ("M", "mu", *CONSTANTS):
            whose = f"Capsule.{name}"
            low, high = LIMITS.get(name, (0.0, LARGEST))
            # Narrow types of numpy would reduce the precision of all derived quantities.
            value = _check_size(whose, getattr(self, name), low, high)
            object.__setattr__(self, name, check_divisor(name, whose, value))
        forces = get_args(NormalForce)
        check_choice("Capsule.normal_force", self.normal_force, forces, "'newton' or 'paper'")
        self.check_plant(self.M, self.mu)

    def check_plant(self, M: float, mu: float) -> None:
        """Raises an error for M in kg and mu that are invalid for this capsule.

        In slip N depends on theta'' and theta'' on N through friction. There is exactly one
        solution at every angle if (M + m) / m > (1 + sqrt(1 + mu^2)) / 2. Other plants admit
        Painleve's paradox.

        Raises:
            TypeError: if M or mu is not a number.
            ValueError: if M or mu is out of range, or the plant admits Painleve's paradox.
        """
        M = _check_size("M", M, SMALLEST)
        mu = _check_size("mu", mu, 0.0)
        # The largest coefficient that can act.
        mu *= max(1.0, self.backward_ratio) * self.static_ratio
        ratio = (M + self.m) / self.m
        bound = (1.0 + math.sqrt(1.0 + mu * mu)) / 2.0
        if ratio > bound:
            return
        # As a product: a power that overflows raises an exception in Python.
        largest = math.sqrt((2.0 * ratio - 1.0) * (2.0 * ratio - 1.0) - 1.0)
        raise ValueError(
            f"M={M!r}, m={self.m!r} and friction coefficient mu={mu!r} admit Painleve's paradox: "
            f"the slip equations need (M + m) / m > (1 + sqrt(1 + mu^2)) / 2 = {bound:.6g}, got "
            f"{ratio:.6g}; with these masses mu must stay below {largest:.6g}"
        )

    def fastest_rate(self, M: float, mu: float) -> float:
        """The fastest rate of the pendulum's own motion in 1/s, which the integrator must resolve.

        It is the largest absolute eigenvalue of the motion linearised at rest, over all angles and
        both directions of slip (docs/physics.md). It is larger for lighter platforms and more
        friction.
        """
        mu *= max(1.0, self.backward_ratio)
        share = self.m / (M + self.m)
        # The share of the inertia that remains in slip at the worst angle; Painleve's condition
        # keeps it positive.
        remains = 1.0 - share * (1.0 + math.sqrt(1.0 + mu * mu)) / 2.0
        if remains <= 0.0:  # by rounding
            return math.inf
        inertia = self.m * self.l * self.l * remains
        # The paper's normal force, which the pivot's torque changes, adds this share of that torque
        # at most.
        pivot = 0.5 * mu * share * self.l if self.normal_force == "paper" else 0.0
        # The friction of the motor is steepest at rest.
        motor = _core.MOTOR_SLOPE * self.motor_friction / _core.MOTOR_WIDTH
        damping = (1.0 + pivot) * (self.c + motor) / inertia
        weight = self.m * self.g * self.l
        # The share by which that normal force changes the spring's stiffness at most.
        spring = (1.0 + math.pi) * pivot
        lowest = (1.0 - spring) * self.k - weight * math.sqrt(1.0 + mu * mu)
        highest = (1.0 + spring) * self.k + weight * mu
        rates = [_fastest_root(damping, stiffness / inertia) for stiffness in (lowest, highest)]
        viscous = self.viscous / ((M + self.m) * remains)
        falling = 0.0
        if self.stribeck_speed > 0.0:
            # The Stribeck curve falls most steeply at stribeck_speed / sqrt(3).
            falling = 0.65 * mu * (self.static_ratio - 1.0) * self.g / self.stribeck_speed
        return max(rates) + (viscous + falling * (M + self.m) / M)

    def plant(self, M: float | None = None, mu: float | None = None) -> Plant:
        """The constants as the core reads them, with another M in kg or mu if one is given."""
        M = self.M if M is None else M
        mu = self.mu if mu is None else mu
        capsule = replace(self, M=M, mu=mu)
        mass_ratio = capsule.m / (capsule.M + capsule.m)
        paper = self.normal_force == "paper"
        optional = (paper, self.viscous, self.stribeck_speed, self.slope, self.motor_friction)
        constants = [getattr(self, name) for name in CONSTANTS]
        # Without the first four of `_core.PLANT`, which the core leaves to the caller.
        derived = map(float, evaluate("derive", *constants)[4:])
        return Plant(
            capsule.M, capsule.mu, mass_ratio, float(paper), float(any(optional)), *derived
        )


def _fastest_root(damping: float, stiffness: float) -> float:
    """The largest absolute root of s^2 + damping s + stiffness, 1/s."""
    square = damping * damping / 4.0 - stiffness
    return damping / 2.0 + math.sqrt(square) if square >= 0.0 else math.sqrt(stiffness)


NOMINAL = Capsule()
"""The capsule of the paper."""
