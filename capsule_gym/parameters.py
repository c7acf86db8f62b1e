"""The plant: its constants, their randomisation, and disturbances, with their checks."""

import math
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any, Literal, NamedTuple

from capsule_gym import _core
from capsule_gym.checks import check_choice, check_flag, check_name, check_number, check_pair, require
from capsule_gym.native import evaluate

NormalForce = Literal["newton", "paper"]

# Range of a plant's constants, in SI units, within which every force and acceleration is finite.
SMALLEST, LARGEST = 1e-12, 1e12
# s. Beyond this range, rounding would keep steps from dividing each other.
SHORTEST_STEP, LONGEST_STEP = 1e-9, 1e6
# rad: largest slope of the floor.
LARGEST_SLOPE = 1.5


class Plant(NamedTuple):
    """The constants of one plant as the core reads them: SI units, float64, no validation.

    The first three differ between the environments of a batch. mass_ratio, m / (M + m), saves divisions. g is the
    component of gravity perpendicular to the floor. Only where `extended` is 1.0 does the core read the option for the
    paper's normal force, and the constants from `downhill` on: g sin(slope), the floor's viscous coefficient,
    static_ratio - 1 and the inverse speed of the Stribeck curve (0.0 without one), the motor's friction, and a force
    that pushes the platform forwards, N.
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
# The smallest values of those that are not 0.
SMALLEST_OF = {**dict.fromkeys(("M", "m", "l", "g", "backward_ratio"), SMALLEST), "static_ratio": 1.0}


# Numbers by which the core divides where they are not 0.
DIVISORS = (
    *("stribeck_speed", "lag", "torque_resolution"),
    *("theta_resolution", "theta_dot_resolution", "x_dot_resolution"),
)


def _check_size(name: str, value: Any, low: float, high: float = LARGEST) -> float:
    """Returns a constant of the plant as a float; outside its range a force might not be finite."""
    return check_number(name, value, f"a finite number from {low:g} to {high:g}", low, high)


def check_divisor(field: str, name: str, number: float) -> float:
    """Returns the value of a field; a ValueError if the core divides by it and the quotient might overflow."""
    require(field not in DIVISORS or not 0.0 < number < SMALLEST, name, f"0 or at least {SMALLEST:g}", number)
    return number


@dataclass(frozen=True, kw_only=True)
class Capsule:
    """The constants of the capsule robot, in SI units; the defaults are those of Liu, Yu and Cang (2018), Sect. 5.

    Attributes:
        M: mass of the platform, kg.
        m: mass of the ball, kg.
        l: distance from the pivot to the ball, m.
        g: gravitational acceleration, m/s^2.
        k: stiffness of the torsional spring, N m/rad.
        c: viscous coefficient of the pivot, N m s/rad.
        mu: kinetic friction coefficient when the platform slides forwards, without dimension.
        static_ratio: static over kinetic friction coefficient, at least 1.
        backward_ratio: friction coefficient backwards over forwards (the paper's Remark 1: anisotropic contact).
        viscous: viscous friction of the floor, N s/m, in addition to Coulomb's.
        stribeck_speed: speed in m/s at which the friction coefficient is half way between its static and its kinetic
            value (Hess and Soom's curve); 0 for a jump at the start of slip.
        slope: angle by which the floor rises forwards, rad.
        motor_friction: Coulomb friction of the motor, N m, smooth below 1 rad/s.
        normal_force: "newton", from Newton's law, or "paper", which subtracts (k theta + c theta') sin(theta) as the
            paper's (7) does; that torque is internal, so the option serves the reproduction only.

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
            low, high = (-LARGEST_SLOPE, LARGEST_SLOPE) if name == "slope" else (SMALLEST_OF.get(name, 0.0), LARGEST)
            # Narrow types of numpy would reduce the precision of all derived quantities.
            value = _check_size(f"Capsule.{name}", getattr(self, name), low, high)
            object.__setattr__(self, name, check_divisor(name, f"Capsule.{name}", value))
        check_choice("Capsule.normal_force", self.normal_force, ("newton", "paper"), "'newton' or 'paper'")
        self.check_plant(self.M, self.mu)

    def check_plant(self, M: float, mu: float) -> None:
        """Raises an error for M in kg and mu that are invalid for this capsule.

        In slip N depends on theta'' and theta'' on N through friction. There is exactly one solution at every angle if
        (M + m) / m > (1 + sqrt(1 + mu^2)) / 2. Other plants admit Painleve's paradox.

        Raises:
            TypeError: if M or mu is not a number.
            ValueError: if M or mu is out of range, or the plant admits Painleve's paradox.
        """
        M, mu = _check_size("M", M, SMALLEST), _check_size("mu", mu, 0.0)
        # The largest coefficient that can act.
        mu *= max(1.0, self.backward_ratio) * self.static_ratio
        share, bound = (M + self.m) / self.m, (1.0 + math.sqrt(1.0 + mu * mu)) / 2.0
        if share <= bound:
            # As a product: a power that overflows raises an exception in Python.
            largest = math.sqrt((2.0 * share - 1.0) * (2.0 * share - 1.0) - 1.0)
            raise ValueError(
                f"M={M!r}, m={self.m!r} and friction coefficient mu={mu!r} admit Painleve's paradox: the slip "
                f"equations need (M + m) / m > (1 + sqrt(1 + mu^2)) / 2 = {bound:.6g}, got {share:.6g}; with these "
                f"masses mu must stay below {largest:.6g}"
            )

    def fastest_rate(self, M: float, mu: float) -> float:
        """The fastest rate of the pendulum's own motion in 1/s, which the integrator must resolve.

        It is the largest absolute eigenvalue of the motion linearised at rest, over all angles and both directions of
        slip (docs/physics.md). It is larger for lighter platforms and more friction.
        """
        mu *= max(1.0, self.backward_ratio)
        share = self.m / (M + self.m)
        # The share of the inertia that remains in slip at the worst angle; Painleve's condition keeps it positive.
        remains = 1.0 - share * (1.0 + math.sqrt(1.0 + mu * mu)) / 2.0
        if remains <= 0.0:  # by rounding
            return math.inf
        inertia = self.m * self.l * self.l * remains
        # The paper's normal force, which the pivot's torque changes, adds this share of that torque at most.
        pivot = 0.5 * mu * share * self.l if self.normal_force == "paper" else 0.0
        # The friction of the motor is steepest at rest, the Stribeck curve, which falls, at v_s / sqrt(3).
        damping = (1.0 + pivot) * (self.c + _core.MOTOR_SLOPE * self.motor_friction / _core.MOTOR_WIDTH) / inertia
        weight = self.m * self.g * self.l
        steepest = 0.65 * mu * (self.static_ratio - 1.0) * self.g / self.stribeck_speed if self.stribeck_speed else 0.0
        floor = self.viscous / ((M + self.m) * remains) + steepest * (M + self.m) / M
        lowest = (1.0 - (1.0 + math.pi) * pivot) * self.k - weight * math.sqrt(1.0 + mu * mu)
        highest = (1.0 + (1.0 + math.pi) * pivot) * self.k + weight * mu
        rates = []
        for stiffness in (lowest / inertia, highest / inertia):
            square = damping * damping / 4.0 - stiffness
            rates.append(damping / 2.0 + math.sqrt(square) if square >= 0.0 else math.sqrt(stiffness))
        return max(rates) + floor

    def plant(self, M: float | None = None, mu: float | None = None) -> Plant:
        """The constants as the core reads them, with another M in kg or mu if one is given."""
        capsule = replace(self, M=self.M if M is None else M, mu=self.mu if mu is None else mu)
        paper = float(self.normal_force == "paper")
        extended = float(any((paper, self.viscous, self.stribeck_speed, self.slope, self.motor_friction)))
        # Without the first four of `_core.PLANT`, which the core leaves to the caller.
        derived = map(float, evaluate("derive", *(getattr(self, name) for name in CONSTANTS))[4:])
        return Plant(capsule.M, capsule.mu, capsule.m / (capsule.M + capsule.m), paper, extended, *derived)


NOMINAL = Capsule()
"""The capsule of the paper."""


# Limit of the exponential in the core.
LARGEST_RATIO = 1e300
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Randomization:
    """Ranges (low, high) from which every episode draws its plant uniformly. None keeps the value of the `Capsule`.

    The fields have the names and the units of the `Capsule`'s.

    Attributes:
        log_mu: draw log(mu) instead of mu uniformly.

    Raises:
        TypeError: if a range is not a pair of numbers.
        ValueError: if a range is not finite or not ordered, or contains values that are invalid for a `Capsule`.

    Examples:
        >>> heavy = Randomization(M=(0.8, 1.0), mu=(0.01, 0.1), log_mu=True)
        >>> print(heavy)
        M in [0.8, 1] kg, mu log-uniform in [0.01, 0.1]
    """

    M: Range | None = None
    mu: Range | None = None
    log_mu: bool = False
    m: Range | None = None
    l: Range | None = None
    g: Range | None = None
    k: Range | None = None
    c: Range | None = None
    static_ratio: Range | None = None
    backward_ratio: Range | None = None
    viscous: Range | None = None
    stribeck_speed: Range | None = None
    slope: Range | None = None
    motor_friction: Range | None = None

    def __post_init__(self) -> None:
        check_flag("Randomization.log_mu", self.log_mu)
        for name in ("M", "mu", *CONSTANTS):
            value, whose = getattr(self, name), f"Randomization.{name}"
            if value is None:
                continue
            # A Stribeck speed of 0 means none: just above it the friction is as steep as can be.
            positive = name in ("M", "stribeck_speed") or (name == "mu" and self.log_mu)
            limits, sign = {}, ""
            if positive or name == "mu":
                limits, sign = {"low": 0.0, "open_low": positive}, "0 < " if positive else "0 <= "
            accepted = f"a pair (low, high) of finite numbers with {sign}low <= high"
            low, high = check_pair(whose, value, accepted, **limits)
            if name == "mu" and self.log_mu:
                require(high / low <= LARGEST_RATIO, whose, f"within a factor of {LARGEST_RATIO:g} with log_mu", value)
            object.__setattr__(self, name, (low, high))

    @property
    def drawn(self) -> list[str]:
        """The names of `CONSTANTS` that have a range."""
        return [name for name in CONSTANTS if getattr(self, name) is not None]

    @classmethod
    def named(cls, name: "str | Randomization", argument: str = "randomization") -> "Randomization":
        """The `Randomization` of a name; a `Randomization` is returned unchanged."""
        if isinstance(name, cls):
            return name
        return RANDOMIZATIONS[check_name(argument, name, cls, RANDOMIZATIONS)]

    def corners(self, capsule: Capsule) -> list[Capsule]:
        """The capsules at the ends of all ranges but those of M and mu, with the lightest platform and most friction.

        Both are the worst case of Painleve's condition and of the integrator's stability, and every other constant is
        at one end of its range.

        Raises:
            ValueError: if one of them, or the heaviest platform with the least friction, is invalid.
        """
        try:
            capsule.check_plant((self.M or (capsule.M,))[-1], (self.mu or (capsule.mu,))[0])
            M, mu = (self.M or (capsule.M,))[0], (self.mu or (capsule.mu,))[-1]
            every = product(*(getattr(self, name) for name in self.drawn))
            return [replace(capsule, M=M, mu=mu, **dict(zip(self.drawn, values, strict=True))) for values in every]
        except ValueError as error:
            raise ValueError(f"Randomization({self}): {error}") from None

    def __str__(self) -> str:
        if self == Randomization():
            return "the capsule's own M and mu"
        M = f"M in [{self.M[0]:g}, {self.M[1]:g}] kg" if self.M else "the capsule's own M"
        scale = "log-uniform " if self.log_mu else ""
        mu = f"mu {scale}in [{self.mu[0]:g}, {self.mu[1]:g}]" if self.mu else "the capsule's own mu"
        ranges = ((name, *getattr(self, name)) for name in self.drawn)
        return ", ".join([M, mu, *(f"{name} in [{low:g}, {high:g}]" for name, low, high in ranges)])


# The constants that are hard to measure on a robot, within 10 % of the paper's.
_WITHIN_A_TENTH: dict[str, Any] = {
    name: (0.9 * getattr(NOMINAL, name), 1.1 * getattr(NOMINAL, name)) for name in ("m", "l", "k", "c")
}
RANDOMIZATIONS = {
    "none": Randomization(),
    "paper": Randomization(M=(0.45, 0.55), mu=(0.009, 0.011)),
    "wide": Randomization(M=(0.35, 0.75), mu=(0.005, 0.3), log_mu=True),
    "broad": Randomization(M=(0.25, 1.2), mu=(0.002, 0.6), log_mu=True),
    "sticky": Randomization(M=(0.35, 0.75), mu=(0.2, 0.6)),
    "real": Randomization(M=(0.45, 0.55), mu=(0.009, 0.011), **_WITHIN_A_TENTH),
    "real-wide": Randomization(M=(0.35, 0.75), mu=(0.005, 0.3), log_mu=True, **_WITHIN_A_TENTH),
}

# Largest sizes of disturbances (SI units), and the longest latency, s, whose states each environment remembers.
LARGEST_DISTURBANCE, LONGEST_LATENCY = 1e3, 0.5
# The sensors that always exist, unless they are `unmeasured`.
SENSORS = ("theta", "theta_dot", "x_dot")

Draws = float | Range


@dataclass(frozen=True, kw_only=True)
class Disturbances:
    """Imperfect sensors and motor, and pushes on the platform.

    A pair (low, high) of numbers is a range from which every episode draws uniformly. The control law and the agent
    both observe the sensors. Sensors are read at every call of the control law or, without one, at every agent step.
    The measured x is the integral of the measured x_dot or, where `x_noise` is given, the reading of a sensor. The
    observation's `stick` is 1 where the measured |x_dot| is at most `stick_threshold`.

    Attributes:
        theta_noise, theta_dot_noise, x_dot_noise: standard deviations of the sensors' white noise, rad, rad/s and m/s;
            independent between readings.
        theta_bias, theta_dot_bias, x_dot_bias: constant errors of the sensors.
        theta_drift, theta_dot_drift, x_dot_drift: standard deviations of the sensors' Gauss-Markov errors.
        drift_time: time constant of the Gauss-Markov errors, s.
        theta_resolution, theta_dot_resolution, x_dot_resolution: steps to which readings are rounded; 0 does not round.
        latency: age of the state that a reading shows, s; rounded to whole periods of the law or, without a law, to
            steps of the integrator.
        lag: time constant of the motor's torque, s.
        motor_friction: Coulomb friction of the motor, N m, added to `Capsule.motor_friction`.
        torque_resolution: step to which the commanded torque is rounded, N m; 0 does not round.
        push: largest force on the platform, N. In every second a force drawn uniformly from [-push, push] acts for
            0.1 s from a random time on.
        unmeasured: any of "theta", "theta_dot" and "x_dot"; their readings are 0.
        controls: which controller observes the sensors: "both", "law" or "agent"; the other one observes the state.
        stick_threshold: largest measured |x_dot| that counts as stick, m/s.
        x_noise: standard deviation of the white noise of a sensor of x, m; None if there is none.

    Raises:
        TypeError: if a field is of the wrong type.
        ValueError: if a field is out of range.

    Examples:
        >>> Disturbances(latency=(0.005, 0.015), x_dot_noise=0.01).latency
        (0.005, 0.015)
    """

    theta_noise: Draws = 0.0
    theta_dot_noise: Draws = 0.0
    x_dot_noise: Draws = 0.0
    theta_bias: Draws = 0.0
    theta_dot_bias: Draws = 0.0
    x_dot_bias: Draws = 0.0
    theta_drift: Draws = 0.0
    theta_dot_drift: Draws = 0.0
    x_dot_drift: Draws = 0.0
    drift_time: Draws = 0.05
    theta_resolution: Draws = 0.0
    theta_dot_resolution: Draws = 0.0
    x_dot_resolution: Draws = 0.0
    latency: Draws = 0.0
    lag: Draws = 0.0
    motor_friction: Draws = 0.0
    torque_resolution: Draws = 0.0
    push: Draws = 0.0
    unmeasured: tuple[str, ...] = ()
    controls: Literal["both", "law", "agent"] = "both"
    stick_threshold: float = 0.01
    x_noise: float | None = None

    def __post_init__(self) -> None:
        for name in DISTURBANCES:
            low, high = self.limits(name)
            accepted = f"a number from {low:g} to {high:g}, or a pair (low, high) of such numbers with low <= high"
            value, whose = getattr(self, name), f"Disturbances.{name}"
            check = check_pair if isinstance(value, (tuple, list)) else check_number
            checked = check(whose, value, accepted, low=low, high=high)
            for end in checked if isinstance(checked, tuple) else (checked,):
                check_divisor(name, whose, end)
            object.__setattr__(self, name, checked)
        names = self.unmeasured
        fits = isinstance(names, (tuple, list)) and all(isinstance(name, str) and name in SENSORS for name in names)
        require(fits, "Disturbances.unmeasured", f"a tuple of names out of {SENSORS}", names)
        object.__setattr__(self, "unmeasured", tuple(names))
        check_choice("Disturbances.controls", self.controls, ("both", "law", "agent"), "'both', 'law' or 'agent'")
        for name, kinds in (("stick_threshold", "a number of m/s"), ("x_noise", "None or a number of m")):
            if (value := getattr(self, name)) is not None or name == "stick_threshold":
                accepted = f"{kinds} from 0 to {LARGEST_DISTURBANCE:g}"
                number = check_number(f"Disturbances.{name}", value, accepted, 0.0, LARGEST_DISTURBANCE)
                object.__setattr__(self, name, number)

    @staticmethod
    def limits(name: str) -> tuple[float, float]:
        """The smallest and the largest value that a field of `DISTURBANCES` may have."""
        if name.endswith("_bias"):
            return -LARGEST_DISTURBANCE, LARGEST_DISTURBANCE
        lowest = SHORTEST_STEP if name == "drift_time" else 0.0
        return lowest, LONGEST_LATENCY if name == "latency" else LARGEST_DISTURBANCE

    @classmethod
    def named(cls, name: "str | Disturbances") -> "Disturbances | None":
        """The `Disturbances` of a name, None for "none"; a `Disturbances` is returned unchanged."""
        if isinstance(name, cls):
            return name
        return REAL if check_name("disturbances", name, cls, ("none", "real")) == "real" else None


DISTURBANCES = tuple(each.name for each in fields(Disturbances))[:-4]
"""The fields of `Disturbances` that are numbers or ranges."""

REAL = Disturbances(
    theta_noise=0.01,
    theta_dot_noise=0.1,
    x_dot_noise=0.01,
    theta_bias=(-0.02, 0.02),
    theta_dot_bias=(-0.1, 0.1),
    x_dot_bias=(-0.02, 0.02),
    theta_drift=0.02,
    theta_dot_drift=0.1,
    x_dot_drift=0.02,
    latency=(0.005, 0.015),
    lag=0.005,
    motor_friction=0.05,
)
"""The disturbances of `disturbances="real"`: cheap sensors, and the latency of a bus or a camera."""
