"""The constants of the control laws, each once: the published gains, and what the paper leaves open."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from capsule_gym.parameters import check_number


class Gains(NamedTuple):
    """The gains of the adaptive law (37) to (39).

    Attributes:
        Lambda_theta: bandwidth of the first-order filter of the pendulum's error, 1/s.
        Lambda_x: bandwidth of the filter of the platform's error, 1/s.
        K1: N m s/rad.
        K2: N s.
        K3: of the non-collocated terms, N s/m.
        Gamma_1: rate of adaptation of alpha_theta.
        Gamma_2: rate of adaptation of alpha_x.
    """

    Lambda_theta: float
    Lambda_x: float
    K1: float
    K2: float
    K3: float
    Gamma_1: float
    Gamma_2: float


# Sect. 5.
PUBLISHED = Gains(Lambda_theta=12.0, Lambda_x=30.0, K1=1.3, K2=10.0, K3=50.0, Gamma_1=0.1, Gamma_2=0.1)
# Of `compliant`.
COMPLIANT = Gains(Lambda_theta=4.0, Lambda_x=PUBLISHED.Lambda_x, K1=0.05, K2=0.0, K3=0.0, Gamma_1=0.0, Gamma_2=0.0)


class Choices(NamedTuple):
    """What (39) needs and the paper leaves open, and what keeps the law's variables bounded.

    Attributes:
        beta: the 'selected small constant' in the denominators of (39c) and (39d), rad^2/s^2.
        n: of the exponent (2n + 2) / (2n + 1) in (39d).
        eta_0: the auxiliary variable eta at the start.
        saturation_width: of the saturation that stands for sgn(delta_theta), rad/s; 0.0 is sgn itself.
        eta_bound: the largest eta: (39d) can grow without bound in finite time.
        estimate_range: every estimate is kept within this fraction of its nominal value; infinity leaves it free.
        anchored: whether x_d starts anew from the platform at every cycle, or goes on from the start of the run.
    """

    beta: float
    n: int
    eta_0: float
    saturation_width: float
    eta_bound: float
    estimate_range: float
    anchored: bool


# (eta - 1) makes the last term of (39c) positive feedback while eta < 1; eta(0) = 1 rules that out.
REGULARISED = Choices(beta=1.0, n=1, eta_0=1.0, saturation_width=0.5, eta_bound=10.0, estimate_range=0.5, anchored=True)
UNREGULARISED = Choices(
    beta=0.01, n=1, eta_0=1.0, saturation_width=0.0, eta_bound=1e6, estimate_range=math.inf, anchored=False
)

# Of (35), not published: a double pole at -20 rad/s, well below the 1 kHz of the law and well above the profile.
K_P = 400.0
K_V = 40.0


def check_gains(**gains: Any) -> dict[str, float]:
    """The gains as floats, each finite and not negative."""
    return {name: check_number(name, value, "a finite number >= 0", 0.0) for name, value in gains.items()}
