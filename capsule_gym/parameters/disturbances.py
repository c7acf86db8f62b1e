"""Imperfect sensors and motor, and pushes on the platform, with their checks."""

from dataclasses import dataclass
from typing import Literal

from capsule_gym.checks import check_choice, check_name, check_number, check_pair, require
from capsule_gym.core import _core
from capsule_gym.parameters.limits import SHORTEST_STEP, check_divisor
from capsule_gym.parameters.randomization import Range

# Largest size of a disturbance, SI units.
LARGEST_DISTURBANCE = 1e3
# s; each environment remembers its states for so long.
LONGEST_LATENCY = 0.5
# The disturbances that make readings older, for which environments remember their states.
DELAYS = ("latency", "theta_latency", "theta_dot_latency", "x_dot_latency", "jitter")
# The sensors that always exist, unless they are `unmeasured`.
SENSORS = ("theta", "theta_dot", "x_dot")

Draws = float | Range


@dataclass(frozen=True, kw_only=True)
class Disturbances:
    """Imperfect sensors and motor, and pushes on the platform.

    A pair (low, high) of numbers is a range from which every episode draws uniformly. The control
    law and the agent both observe the sensors. Sensors are read at every call of the control law
    or, without one, at every agent step. The measured x is the integral of the measured x_dot or,
    where `x_noise` is given, the reading of a sensor. The observation's `stick` is 1 where the
    measured |x_dot| is at most `stick_threshold`.

    Attributes:
        theta_noise, theta_dot_noise, x_dot_noise: standard deviations of the sensors' white noise,
            rad, rad/s and m/s; independent between readings.
        theta_bias, theta_dot_bias, x_dot_bias: constant errors of the sensors.
        theta_drift, theta_dot_drift, x_dot_drift: standard deviations of the sensors' Gauss-Markov
            errors.
        drift_time: time constant of the Gauss-Markov errors, s.
        theta_resolution, theta_dot_resolution, x_dot_resolution: steps to which readings are
            rounded; 0 does not round.
        latency: age of the state that a reading shows, s; rounded to whole periods of the law or,
            without a law, to steps of the integrator.
        theta_latency, theta_dot_latency, x_dot_latency: latencies of single sensors, s, added to
            `latency`.
        jitter: largest time by which a reading of all sensors is taken early, s; drawn uniformly
            from [0, jitter] for each reading. Between two periods the state is interpolated.
        hold: periods that a sensor repeats its sample, rounded to a whole number; a period is the
            time between readings.
        lost: probability that a sensor's reading is lost. The control law and the agent then
            observe the last one received; the first one of an episode is never lost.
        lag: time constant of the motor's torque, s.
        motor_friction: Coulomb friction of the motor, N m, added to `Capsule.motor_friction`.
        torque_resolution: step to which the commanded torque is rounded, N m; 0 does not round.
        push: largest force on the platform, N. In every second a force drawn uniformly from [-push,
            push] acts for 0.1 s from a random time on.
        unmeasured: any of "theta", "theta_dot" and "x_dot"; their readings are 0.
        controls: which controller observes the sensors: "both", "law" or "agent"; the other one
            observes the state.
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
    theta_latency: Draws = 0.0
    theta_dot_latency: Draws = 0.0
    x_dot_latency: Draws = 0.0
    jitter: Draws = 0.0
    hold: Draws = 0.0
    lost: Draws = 0.0
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
            object.__setattr__(self, name, self._checked_draws(name))
        names = self.unmeasured
        fits = isinstance(names, (tuple, list)) and all(
            isinstance(name, str) and name in SENSORS for name in names
        )
        require(fits, "Disturbances.unmeasured", f"a tuple of names out of {SENSORS}", names)
        object.__setattr__(self, "unmeasured", tuple(names))
        choices = ("both", "law", "agent")
        check_choice("Disturbances.controls", self.controls, choices, "'both', 'law' or 'agent'")
        self._check_field("stick_threshold", "a number of m/s")
        if self.x_noise is not None:
            self._check_field("x_noise", "None or a number of m")

    def _checked_draws(self, name: str) -> Draws:
        """The value of a field of `DISTURBANCES`, a number or a range, after its check."""
        value = getattr(self, name)
        low, high = self.limits(name)
        accepted = (
            f"a number from {low:g} to {high:g}, or a pair (low, high) of such numbers with "
            "low <= high"
        )
        whose = f"Disturbances.{name}"
        check = check_pair if isinstance(value, (tuple, list)) else check_number
        checked = check(whose, value, accepted, low=low, high=high)
        for end in checked if isinstance(checked, tuple) else (checked,):
            check_divisor(name, whose, end)
        return checked

    def _check_field(self, name: str, kind: str) -> None:
        """Checks a field that is not drawn."""
        accepted = f"{kind} from 0 to {LARGEST_DISTURBANCE:g}"
        value = getattr(self, name)
        size = check_number(f"Disturbances.{name}", value, accepted, 0.0, LARGEST_DISTURBANCE)
        object.__setattr__(self, name, size)

    @staticmethod
    def limits(name: str) -> tuple[float, float]:
        """The smallest and the largest value that a field of `DISTURBANCES` may have."""
        if name.endswith("_bias"):
            return -LARGEST_DISTURBANCE, LARGEST_DISTURBANCE
        if name in DELAYS:
            return 0.0, LONGEST_LATENCY
        if name == "lost":
            return 0.0, 1.0
        lowest = SHORTEST_STEP if name == "drift_time" else 0.0
        return lowest, LARGEST_DISTURBANCE

    @classmethod
    def named(cls, name: "str | Disturbances") -> "Disturbances | None":
        """The `Disturbances` of a name, None for "none"; a `Disturbances` is returned unchanged."""
        if isinstance(name, cls):
            return name
        known = {"none": None, "real": REAL}
        return known[check_name("disturbances", name, cls, known)]


DISTURBANCES = tuple(_core.DISTURBANCES)
"""The fields of `Disturbances` that are numbers or ranges, in the order of their draws."""

SAMPLING = tuple(_core.SAMPLING)
"""Those of `DISTURBANCES` with draws of their own, which older files do not have."""

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
"""The disturbances of `disturbances="real"`: cheap sensors, the latency of a bus or a camera."""
