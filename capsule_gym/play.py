"""Manual control of the motor, in a window: `python -m capsule_gym.play`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from capsule_gym.checks import check_number
from capsule_gym.command_line import arg, parse
from capsule_gym.demo import TERMINATIONS, Episode, PlantArgs, errors_in_one_line, find_policy
from capsule_gym.evaluation_sets import PlantSpec
from capsule_gym.rendering import FRAME_SECONDS

PROG = "python -m capsule_gym.play"
# The action of a held key: 1.0 would end the episode in a third of a second.
STRENGTH = 0.4
# A growing theta swings the ball to the left.
LEFT, RIGHT = frozenset({"left", "a"}), frozenset({"right", "d"})


class Game:
    """A player and a rival on the same plant at the same time; also the policy of the player's episode.

    Args:
        plants: the plants that the key N selects in turn.
        rival: the policy of the ghost.
        speed: simulated seconds per second.
        settings: the argument `settings` of both episodes.
    """

    name = "you"
    env_kwargs: dict[str, Any] = {}  # noqa: RUF012 (read only)

    def __init__(
        self, plants: Sequence[PlantSpec], rival: Any, speed: float = 1.0, settings: Mapping[str, Any] | None = None
    ) -> None:
        self.plants, self.speed, self.action = plants, speed, 0.0
        self.episode, self.rival = Episode(self, plants[0], settings), Episode(rival, plants[0], settings)
        self._number, self._time = 0, 0.0
        self._held: list[str] = []

    def start(self, seeds: Sequence[int]) -> Callable[[np.ndarray], np.ndarray]:
        """The function from observations to the action of the keys."""
        return lambda observations: np.array([[self.action]], np.float32)

    def begin(self, number: int) -> None:
        """Begins an episode of both on the plant with this number, modulo the number of plants."""
        self._number, self._time = number % len(self.plants), 0.0
        for episode in (self.episode, self.rival):
            episode.begin(self.plants[self._number])

    def on_key(self, name: str, pressed: bool) -> None:
        """Handles the press or release of a key, by pygame's name."""
        if name in LEFT | RIGHT:
            self._held = [held for held in self._held if held != name] + [name] * pressed
        elif pressed and name in ("n", "r"):
            self.begin(self._number + (name == "n"))
        # The key that was pressed last wins.
        self.action = 0.0 if not self._held else STRENGTH if self._held[-1] in LEFT else -STRENGTH

    def tick(self, seconds: float) -> None:
        """Advances the game by a real time in seconds."""
        if self.episode.end is None:
            self._time += self.speed * seconds
            self.episode.advance(self._time)
            # Both are shown at the same instant, also if the player's episode has ended before.
            self.rival.advance(self.episode.time)

    def note(self) -> str:
        """The keys and, after the end, the result of the episode."""
        keys = "A D torque   N next plant   R again"
        if self.episode.end is None:
            return keys
        end = TERMINATIONS[self.episode.end].capitalize()
        return f"{end} after {self.episode.time:.1f} s: {self.episode.speed}, {self.rival.speed}   {keys}"


@dataclass(frozen=True, kw_only=True)
class Args(PlantArgs):
    """Opens a window in which you control the motor, next to a policy on the same plant.

    The arrow keys left and right, or A and D, apply torque. N selects the next plant, R restarts.

    Examples:
      python -m capsule_gym.play
      python -m capsule_gym.play --set wide --rival direct-ppo
      python -m capsule_gym.play --M 0.6 --mu 0.05 --speed 0.5
    """

    rival: Annotated[str, arg(metavar="NAME_OR_PATH", help="Policy shown as an outline, as in demo.")] = "adaptive"
    speed: float = 1.0
    """Speed relative to real time, from 0.1 to 20."""

    def check(self) -> None:
        """Raises an error for a speed out of range."""
        check_number("--speed", self.speed, "a number from 0.1 to 20", 0.1, 20.0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    with errors_in_one_line(PROG):
        game = Game(args.plants(), find_policy(args.rival), args.speed, args.settings())
        title = f"you and {game.rival.policy.name}"
        with closing(game.episode.renderer("human", title, game.on_key)) as renderer:
            while not renderer.closed:
                renderer.draw(**game.episode.state(), ghost=game.rival.ghost(), note=game.note())
                game.tick(FRAME_SECONDS)
    return 0


if __name__ == "__main__":
    sys.exit(main())
