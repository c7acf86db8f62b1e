"""What the paper states in numbers (Sect. 5), once, with the place where it stands.

Liu, Yu, Cang: Optimized adaptive tracking control for an underactuated vibro-driven capsule system, Nonlinear
Dynamics 94 (2018).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Number:
    """A published number.

    Attributes:
        quantity: what it measures.
        unit: SI or as printed; empty for a ratio.
        value: as printed.
        digits: decimals as printed.
        where: its place in the paper.
    """

    quantity: str
    unit: str
    value: float
    digits: int
    where: str


@dataclass(frozen=True)
class Claim:
    """A published statement that is no number of its own.

    Attributes:
        text: the statement.
        where: its place in the paper.
    """

    text: str
    where: str


_COMPARISON = "Sect. 5, second paragraph"
_ADAPTIVE = "Sect. 5, third paragraph"

# Of a run, by the name that the reproduction gives it.
PROPOSED = {
    "peak_velocity": Number("largest theta'", "rad/s", 7.8, 1, f"{_COMPARISON}, Fig. 3"),
    "swing": Number("largest swing", "deg", 68.75, 2, f"{_COMPARISON}, Fig. 3"),
    "mean_speed": Number("mean speed, five cycles", "cm/s", 0.642, 3, f"{_COMPARISON}, Fig. 4"),
    "peak_torque": Number("largest torque", "N m", 0.5367, 4, f"{_COMPARISON}, Fig. 5"),
}
EPC = {
    "peak_velocity": Number("largest theta'", "rad/s", 11.0, 1, f"{_COMPARISON}, Fig. 3"),
    # Printed as 17.1 degrees more than the proposed profile's.
    "swing": Number("largest swing", "deg", 85.85, 2, f"{_COMPARISON}, Fig. 3"),
    "mean_speed": Number("mean speed, five cycles", "cm/s", 0.629, 3, f"{_COMPARISON}, Fig. 4"),
    "peak_torque": Number("largest torque", "N m", 0.6246, 4, f"{_COMPARISON}, Fig. 5"),
}
SWING_DIFFERENCE = Number("swing, EPC minus proposed", "deg", 17.1, 1, _COMPARISON)
ADAPTIVE_PEAK_VELOCITY = Number("largest theta'", "rad/s", 7.9, 1, f"{_ADAPTIVE}, Fig. 6")
NATURAL_FREQUENCY = Number("omega_n", "rad/s", 5.7184, 4, "Sect. 5, first paragraph")
BASE_PARAMETERS = {
    "alpha_theta_1": Number("alpha_theta: m l^2", "kg m^2", 0.01424, 5, _ADAPTIVE),
    "alpha_theta_2": Number("alpha_theta: m l", "kg m", 0.0414, 4, _ADAPTIVE),
    "alpha_theta_3": Number("alpha_theta: k", "N m/rad", 0.36, 2, _ADAPTIVE),
    "alpha_theta_4": Number("alpha_theta: c", "N m s/rad", 0.0923, 4, _ADAPTIVE),
    "alpha_theta_5": Number("alpha_theta: m g l", "N m", 0.40527, 5, _ADAPTIVE),
    "alpha_x_1": Number("alpha_x: m l", "kg m", 0.0414, 4, _ADAPTIVE),
    "alpha_x_2": Number("alpha_x: M + m", "kg", 0.638, 3, _ADAPTIVE),
    "alpha_x_3": Number("alpha_x: mu", "", 0.01, 2, _ADAPTIVE),
    "alpha_x_4": Number("alpha_x: m l", "kg m", 0.0414, 4, _ADAPTIVE),
}

CLAIMS = {
    "faster": Claim("the proposed profile is faster than EPC", _COMPARISON),
    "torque": Claim("its largest torque is lower than EPC's", _COMPARISON),
    "energy": Claim("its energy efficacy is superior", _COMPARISON),
    "backward": Claim("backward motions are sufficiently suppressed", f"{_COMPARISON}, Fig. 4"),
    "adaptive": Claim("the adaptive law tracks exactly for every M and mu of the ranges", _ADAPTIVE),
    "sliding": Claim("the sliding variable delta_theta converges to zero", f"{_ADAPTIVE}, Fig. 9"),
    "lyapunov": Claim("the Lyapunov function (40) never rises", "Theorem 1, Eq. (41)"),
}

# Assumed known bounds of the adaptive runs.
M_RANGE = (0.45, 0.55)
MU_RANGE = (0.009, 0.011)
