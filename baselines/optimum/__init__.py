"""The optimum of the direct-torque task by dynamic programming: `python -m baselines.optimum` computes it."""

from pathlib import Path
from typing import TYPE_CHECKING

from capsule_gym.later import later

if TYPE_CHECKING:
    from baselines.optimum.cycles import Cycle, cycle
    from baselines.optimum.records import optimal_speed

__all__ = ["Cycle", "cycle", "optimal_speed"]

# N: the observation is coarser than the state, so that less may be none.
LEAST_CONTACT = 0.02
# Of what is computed.
FOLDER = Path(__file__).with_name("data")

__getattr__, __dir__ = later(
    __name__,
    {
        "Cycle": ".cycles",
        "cycle": ".cycles",
        "optimal_speed": ".records",
    },
)
