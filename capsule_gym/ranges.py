"""Where in the ranges of a `Randomization` a draw lies; compiled with the resets, and the same bits from Python."""

from __future__ import annotations

from collections.abc import Sequence

from capsule_gym.exponential import exp
from capsule_gym.inlining import inlined


@inlined
def plant_at(lines: Sequence[float], share_M: float, share_mu: float) -> tuple[float, float]:
    """M in kg and mu at these shares, in [0, 1), of their ranges.

    Args:
        lines: from `capsule_gym.parameters.Randomization.lines`.
        share_M: of the range of M.
        share_mu: of the range of mu, or of log(mu) where that is drawn.
    """
    low_M, growth_M, low_mu, growth_mu, growth_log_mu = lines[0], lines[1], lines[2], lines[3], lines[4]
    mu = low_mu * exp(growth_log_mu * share_mu) if growth_log_mu > 0.0 else low_mu + growth_mu * share_mu
    return low_M + growth_M * share_M, mu
