"""The gains of the control laws, each once: the published ones, and those that the paper leaves open."""

from __future__ import annotations

from typing import Any

from capsule_gym.parameters import check_number

# Published: Sect. 5.
LAMBDA_THETA, LAMBDA_X = 12.0, 30.0
K_1, K_2, K_3 = 1.3, 10.0, 50.0
GAMMA_1 = GAMMA_2 = 0.1

# Not published: a double pole at -20 rad/s, well below the 1 kHz of the law and well above the profile.
K_P = 400.0
K_V = 40.0


def check_gains(**gains: Any) -> dict[str, float]:
    """The gains as floats, each finite and not negative."""
    return {name: check_number(name, value, "a finite number >= 0", 0.0) for name, value in gains.items()}
