"""The options by which a command is told what robot it shows, and how fast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from capsule_gym.command_line import Count, described
from capsule_gym.evaluation_sets import SET_NAMES, PlantSpec, load_set
from capsule_gym.parameters import check_number

FPS = 50
SLOWEST, FASTEST = 0.1, 20.0


@dataclass(frozen=True, kw_only=True)
class PlantOptions:
    """The plant, and the pace."""

    set: Annotated[str, arg(metavar="NAME_OR_PATH", help=f"Plants: {', '.join(SET_NAMES)}, or a file.")] = "paper"
    seed: Count = 0
    """Which of the set's plants, by its seed."""
    M: float | None = None
    """Mass of the platform in kg, instead of the set's."""
    mu: float | None = None
    """Friction coefficient, instead of the set's."""
    speed: Annotated[float, described(f"Times the speed of reality, from {SLOWEST:g} to {FASTEST:g}.")] = 1.0

    def check(self) -> None:
        """Refuses a speed out of range, and plants that do not exist."""
        check_number("--speed", self.speed, f"a number from {SLOWEST:g} to {FASTEST:g}", SLOWEST, FASTEST)
        self.plants()

    def plants(self) -> tuple[PlantSpec, ...]:
        """The plants of the set, the chosen one first."""
        return load_set(self.set).from_seed(self.seed, M=self.M, mu=self.mu)
