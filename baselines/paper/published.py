"""The numbers and claims of the paper (Sect. 5), each with its place.

Liu, Yu, Cang: Optimized adaptive tracking control for an underactuated vibro-driven capsule system, Nonlinear
Dynamics 94 (2018).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

from baselines.laws.profiles import V1, V1_EPC
from capsule_gym.parameters import RANDOMIZATIONS


@dataclass(frozen=True)
class Number:
    """A published number with its unit (empty for a ratio), its decimals as printed, and its place in the paper."""

    quantity: str
    unit: str
    value: float
    digits: int
    where: str


_COMPARISON = "Sect. 5, second paragraph"
_ADAPTIVE = "Sect. 5, third paragraph"


def _run(rate: float, swing: float, speed: float, torque: float) -> dict[str, Number]:
    """The numbers of a run, by their names in the reproduction."""
    return {
        "peak_velocity": Number("largest theta'", "rad/s", rate, 1, f"{_COMPARISON}, Fig. 3"),
        "swing": Number("largest swing", "deg", swing, 2, f"{_COMPARISON}, Fig. 3"),
        "mean_speed": Number("mean speed, five cycles", "cm/s", speed, 3, f"{_COMPARISON}, Fig. 4"),
        "peak_torque": Number("largest torque", "N m", torque, 4, f"{_COMPARISON}, Fig. 5"),
    }


SWING_DIFFERENCE = Number("swing, EPC minus proposed", "deg", 17.1, 1, _COMPARISON)
PROPOSED = _run(V1, 68.75, 0.642, 0.5367)
# EPC's own swing is not printed.
EPC = _run(V1_EPC, round(68.75 + SWING_DIFFERENCE.value, 2), 0.629, 0.6246)
RUNS = {"proposed": PROPOSED, "EPC": EPC}
ADAPTIVE_PEAK_VELOCITY = Number("largest theta'", "rad/s", 7.9, 1, f"{_ADAPTIVE}, Fig. 6")
NATURAL_FREQUENCY = Number("omega_n", "rad/s", 5.7184, 4, "Sect. 5, first paragraph")
BASE_PARAMETERS = (
    Number("alpha_theta: m l^2", "kg m^2", 0.01424, 5, _ADAPTIVE),
    Number("alpha_theta: m l", "kg m", 0.0414, 4, _ADAPTIVE),
    Number("alpha_theta: k", "N m/rad", 0.36, 2, _ADAPTIVE),
    Number("alpha_theta: c", "N m s/rad", 0.0923, 4, _ADAPTIVE),
    Number("alpha_theta: m g l", "N m", 0.40527, 5, _ADAPTIVE),
    Number("alpha_x: m l", "kg m", 0.0414, 4, _ADAPTIVE),
    Number("alpha_x: M + m", "kg", 0.638, 3, _ADAPTIVE),
    Number("alpha_x: mu", "", 0.01, 2, _ADAPTIVE),
    Number("alpha_x: m l", "kg m", 0.0414, 4, _ADAPTIVE),
)

# Published statements that are not numbers, with their places.
CLAIMS = {
    "faster": ("the proposed profile is faster than EPC", _COMPARISON),
    "torque": ("its largest torque is lower than EPC's", _COMPARISON),
    "energy": ("its energy efficacy is superior", _COMPARISON),
    "backward": ("backward motions are sufficiently suppressed", f"{_COMPARISON}, Fig. 4"),
    "adaptive": ("the adaptive law tracks exactly for every M and mu of the ranges", _ADAPTIVE),
    "finite_time": ("it matches the reference in finite time under parametric uncertainty", "Abstract and Sect. 1"),
    "rate": ("the angular velocity (its error) will eventually converge to zero", f"{_ADAPTIVE}, Fig. 7"),
    "sliding": ("the sliding variable delta_theta converges to zero", f"{_ADAPTIVE}, Fig. 9"),
    "stable": ("the system is globally asymptotically stabilized", "Theorem 1 (1)"),
    "bounded": ("all signals in the closed loop are bounded and uniformly continuous", "Theorem 1 (2)"),
    "convergence": ("the collocated error signals converge asymptotically", "Theorem 1 (3)"),
    "lyapunov": ("the Lyapunov function (40) never rises", "Theorem 1, Eq. (41)"),
}

# "Uncertain with known bounds"; the environment draws its plants from them, too.
M_RANGE = cast(tuple[float, float], RANDOMIZATIONS["paper"].M)
MU_RANGE = cast(tuple[float, float], RANDOMIZATIONS["paper"].mu)
