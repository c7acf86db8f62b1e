"""What an identification estimates, and within which ranges."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from capsule_gym.checks import check_number, check_pair, nearest, require
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.contract import check_step, describe
from capsule_gym.identification.derivatives import PLANT, subset
from capsule_gym.parameters import SENSORS, Capsule, Disturbances, Randomization

# Ranges of what a `Randomization` may leave open, SI units.
RANGES = {
    "viscous": (0.0, 0.5),
    "static_ratio": (1.0, 1.5),
    "motor_friction": (0.0, 0.1),
    "latency": (0.0, 0.02),
    "lag": (0.0, 0.01),
    "theta_bias": (-0.1, 0.1),
    "theta_dot_bias": (-0.5, 0.5),
    "x_dot_bias": (-0.1, 0.1),
}
OTHERS = tuple(name for name in RANGES if name not in PLANT)
# Those of single sensors are 0 unless their ranges are given.
DELAYS_AND_BIASES = (*OTHERS, *(f"{name}_latency" for name in SENSORS))
QUANTITIES = (*PLANT, *DELAYS_AND_BIASES)


def check_known(known: Mapping[str, float]) -> dict[str, float]:
    """Returns known quantities as floats, or raises an error."""
    found = {}
    check_names("known", known, "a dict of numbers by name")
    for name, value in known.items():
        low, high = limits_of(name)
        accepted = f"a finite number from {low:g} to {high:g}"
        found[name] = check_number(f"known[{name!r}]", value, accepted, low, high)
    return found


def limits_of(name: str) -> tuple[float, float]:
    """The limits of a quantity; those of a plant's constants are checked together, by the plant."""
    if name in PLANT:
        return -math.inf, math.inf
    return Disturbances.limits(name)


def check_plants(known: Mapping[str, float], prior: Randomization, physics_dt: float) -> None:
    """Raises an error unless all plants of the prior with known constants can be simulated."""
    settings = describe(EnvConfig(control_dt=physics_dt, physics_dt=physics_dt), None).settings
    constants = subset(known, PLANT)
    unknown: dict[str, Any] = dict.fromkeys(constants)
    if "mu" in constants:
        unknown["log_mu"] = False
    for corner in replace(prior, **unknown).corners(Capsule(**constants)):
        check_step(corner, corner.M, corner.mu, settings)


def check_ranges(
    ranges: Mapping[str, tuple[float, float]], known: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Returns given ranges as pairs of floats, or raises an error."""
    check_names("ranges", ranges, "a dict of pairs (low, high) by name")
    found = {}
    for name, value in ranges.items():
        whose = f"ranges[{name!r}]"
        require(name not in known, whose, "of a quantity that is not known", value)
        low, high = limits_of(name)
        accepted = f"a pair (low, high) of numbers from {low:g} to {high:g} with low <= high"
        found[name] = check_pair(whose, value, accepted, low=low, high=high)
    return found


def check_names(argument: str, values: Any, accepted: str) -> None:
    """Raises an error unless the values belong to quantities by name."""
    require(isinstance(values, Mapping), argument, accepted, values, TypeError)
    for name in values:
        if name not in QUANTITIES:
            similar = nearest(str(name), QUANTITIES)
            raise ValueError(
                f"{argument} must have keys out of {QUANTITIES}, got {name!r}{similar}"
            )


def open_ranges(
    columns: Mapping[str, Any],
    known: Mapping[str, float],
    prior: Randomization,
    given: Mapping[str, tuple[float, float]],
) -> dict[str, tuple[float, float]]:
    """The ranges of the quantities that are not known; a bias needs its sensor."""
    ranges = {}
    for name in QUANTITIES:
        limits = given.get(name) or getattr(prior, name, None) or RANGES.get(name)
        sensor = name.removesuffix("_bias").removesuffix("_latency")
        sensed = sensor == name or sensor in columns
        if limits and sensed and name not in known:
            ranges[name] = limits
    return ranges
