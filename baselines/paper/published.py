"""The numbers and claims of the paper (Sect. 5).

Liu, Yu, Cang: Optimized adaptive tracking control for an underactuated vibro-driven capsule system,
Nonlinear Dynamics 94 (2018).
"""

from dataclasses import dataclass
from typing import cast

from capsule_gym.control.laws.profiles import V1, V1_EPC
from capsule_gym.parameters import RANDOMIZATIONS


@dataclass(frozen=True)
class Number:
    """A published number with its unit (empty for a ratio) and its decimals as printed."""

    quantity: str
    unit: str
    value: float
    digits: int


def _run(rate: float, swing: float, speed: float, torque: float) -> dict[str, Number]:
    """The numbers of a run (second paragraph, Figures 3 to 5) by the names of our results."""
    return {
        "peak_velocity": Number("largest theta'", "rad/s", rate, 1),
        "swing": Number("largest swing", "deg", swing, 2),
        "mean_speed": Number("mean speed, five cycles", "cm/s", speed, 3),
        "peak_torque": Number("largest torque", "N m", torque, 4),
    }


SWING_DIFFERENCE = Number("swing, EPC minus proposed", "deg", 17.1, 1)
PROPOSED = _run(V1, 68.75, 0.642, 0.5367)
# EPC's own swing is not printed.
EPC = _run(V1_EPC, round(68.75 + SWING_DIFFERENCE.value, 2), 0.629, 0.6246)
RUNS = {"proposed": PROPOSED, "EPC": EPC}
# Figure 6.
ADAPTIVE_PEAK_VELOCITY = Number("largest theta'", "rad/s", 7.9, 1)
NATURAL_FREQUENCY = Number("omega_n", "rad/s", 5.7184, 4)
# Third paragraph.
BASE_PARAMETERS = (
    Number("alpha_theta: m l^2", "kg m^2", 0.01424, 5),
    Number("alpha_theta: m l", "kg m", 0.0414, 4),
    Number("alpha_theta: k", "N m/rad", 0.36, 2),
    Number("alpha_theta: c", "N m s/rad", 0.0923, 4),
    Number("alpha_theta: m g l", "N m", 0.40527, 5),
    Number("alpha_x: m l", "kg m", 0.0414, 4),
    Number("alpha_x: M + m", "kg", 0.638, 3),
    Number("alpha_x: mu", "", 0.01, 2),
    Number("alpha_x: m l", "kg m", 0.0414, 4),
)

# "Uncertain with known bounds"; the environment draws its plants from them, too.
M_RANGE = cast(tuple[float, float], RANDOMIZATIONS["paper"].M)
MU_RANGE = cast(tuple[float, float], RANDOMIZATIONS["paper"].mu)
