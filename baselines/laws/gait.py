"""A gait without a clock as a `Controller`: the torque is a polynomial of the state, and a guard keeps the contact.

The law does not observe the plant and follows no reference. `python -m baselines.gaits` has found the numbers in
`gait.json`. The guard identifies a platform that is lighter than those of the search by the momentum that the pendulum
gives it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from capsule_gym import _core
from capsule_gym.checks import check_number, short_repr
from capsule_gym.config import LAW_DT
from capsule_gym.controller import Controller, CoreLaw
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS
from capsule_gym.task import TORQUE_LIMIT

FILE = Path(__file__).with_name("gait.json")
# In the order of the core: the coefficients phi_ijk of theta^i theta_dot^j x_dot^k and of the step in the direction of
# slip; the guard's gain in N m s^2, and the theta_dot^2 cos(theta), 1/s^2, from which it acts.
PARAMETERS = tuple(_core.LAWS["gait"][0].partition(" torque_limit")[0].split())
COEFFICIENTS = PARAMETERS[:-2]
# The parameters were searched on platforms of this mass and larger ones, kg.
_WIDE = RANDOMIZATIONS["wide"].M
assert _WIDE is not None
LIGHTEST = _WIDE[0]
# The two observed entries of the reference and its phase stay 0.
NO_REFERENCE = np.zeros((1, 2))


@lru_cache(maxsize=1)
def known_parameters() -> tuple[float, ...]:
    """The parameters of `gait.json`, in the order of `PARAMETERS`, read once."""
    content = json.loads(FILE.read_text(encoding="utf-8"))["parameters"]
    return tuple(float(content[name]) for name in PARAMETERS)


def gait_constants(parameters: Sequence[float]) -> dict[str, float]:
    """The constants that the laws with a gait share, by the names that the core gives them."""
    return {**dict(zip(PARAMETERS, parameters, strict=True)), "torque_limit": TORQUE_LIMIT}


def gait(parameters: Sequence[float] | None = None) -> Controller:
    """The gait: its torque is a function of theta, theta_dot and x_dot. It does not observe M and mu.

    Its guard estimates M while the platform slips and acts earlier on platforms lighter than those of `wide`.

    Args:
        parameters: numbers in the order of `PARAMETERS`; None for those of `gait.json`.

    Raises:
        TypeError: if a parameter is not a number.
        ValueError: if a parameter is not finite, or their number is wrong.
    """
    pendulum = {name: getattr(NOMINAL, name) for name in ("m", "l", "g")}
    law = CoreLaw("gait", **gait_constants(_checked(parameters)), **pendulum, lightest=LIGHTEST, dt=LAW_DT)
    return Controller(law.name, law, NO_REFERENCE, memory=(0.0,) * law.cells)


def _checked(parameters: Sequence[float] | None) -> tuple[float, ...]:
    """The parameters as floats; None gives those of `gait.json`."""
    if parameters is None:
        return known_parameters()
    if len(parameters) != len(PARAMETERS):
        raise ValueError(
            f"parameters must be {len(PARAMETERS)} numbers, {', '.join(PARAMETERS)}, got {short_repr(parameters)}"
        )
    return tuple(
        check_number(f"parameters, {name},", value, "a finite number")
        for name, value in zip(PARAMETERS, parameters, strict=True)
    )
