"""Gains and constants of the control laws: the paper's, those that it leaves open, tuned ones."""

import json
import math
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from capsule_gym.checks import check_number
from capsule_gym.parameters import Plant


class Gains(NamedTuple):
    """The gains of the adaptive law (37) to (39), which `adaptive` describes."""

    Lambda_theta: float
    Lambda_x: float
    K1: float
    K2: float
    K3: float
    Gamma_1: float
    Gamma_2: float


# Sect. 5.
PUBLISHED = Gains(
    Lambda_theta=12.0, Lambda_x=30.0, K1=1.3, K2=10.0, K3=50.0, Gamma_1=0.1, Gamma_2=0.1
)


class Choices(NamedTuple):
    """Constants of (39) that the paper leaves open, and bounds of the law's variables.

    Attributes:
        beta: the 'selected small constant' in the denominators of (39c) and (39d), rad^2/s^2.
        n: n of the exponent (2n + 2) / (2n + 1) in (39d).
        eta_0: initial auxiliary variable eta.
        saturation_width: width of the saturation that replaces sgn(delta_theta), rad/s; 0.0 for sgn
            itself.
        eta_bound: largest eta, since (39d) can grow without bound in finite time.
        estimate_range: largest deviation of an estimate from its nominal value, as a fraction of
            it; can be infinite.
        anchored: x_d starts from the position of the platform at every cycle.
    """

    beta: float
    n: int
    eta_0: float
    saturation_width: float
    eta_bound: float
    estimate_range: float
    anchored: bool


# (eta - 1) makes the last term of (39c) positive feedback while eta < 1; eta(0) = 1 rules that out.
REGULARISED = Choices(
    beta=1.0,
    n=1,
    eta_0=1.0,
    saturation_width=0.5,
    eta_bound=10.0,
    estimate_range=0.5,
    anchored=True,
)
UNREGULARISED = Choices(
    beta=0.01,
    n=1,
    eta_0=1.0,
    saturation_width=0.0,
    eta_bound=1e6,
    estimate_range=math.inf,
    anchored=False,
)

# Results of `python -m baselines.tuning`.
TUNED = Path(__file__).parents[2] / "data" / "laws" / "tuned.json"
# For a law without a reference: the two entries that are observed stay 0.
NO_REFERENCE = np.zeros((1, 2))


@cache
def known_parameters(name: str) -> tuple[float, ...]:
    """The parameters of a law in `tuned.json`, read once."""
    tuned = json.loads(TUNED.read_text(encoding="utf-8"))
    return tuple(tuned[name]["parameters"])


def check_gains(**gains: Any) -> dict[str, float]:
    """The gains as floats, each finite and not negative."""
    accepted = "a finite number >= 0"
    return {name: check_number(name, value, accepted, 0.0) for name, value in gains.items()}


def plant_constants(plant: Plant) -> dict[str, float]:
    """The constants of a nominal plant by the names that the laws of the core give them."""
    constants = plant._asdict()
    del constants["extended"]
    return constants
