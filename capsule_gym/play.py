"""You at the motor, in a window: `python -m capsule_gym.play`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from tyro.conf import arg

from capsule_gym.command_line import parse, refuse
from capsule_gym.demo import FPS, TERMINATIONS, Agent, Episode, PlantArgs, agent_names, find_agent, renderer_of
from capsule_gym.evaluation_sets import PlantSpec
from capsule_gym.rendering import Renderer

PROG = "python -m capsule_gym.play"
STRENGTHS = (0.2, 0.4, 0.6, 0.8, 1.0)
# At full strength a key that is held ends the episode in a third of a second.
FIRST_STRENGTH = 1
# A growing theta swings the ball to the left.
LEFT, RIGHT = frozenset({"left", "a"}), frozenset({"right", "d"})


class Game:
    """A player and a rival on the same plant at the same time.

    Args:
        plants: what N goes through, the first one first.
        rival: the ghost.
        speed: simulated seconds per second.

    Attributes:
        action: of the player, in [-1, 1].
        episode: the player's.
        rival: the rival's.
        paused: whether time stands still.
        over: whether the player has asked to end.
    """

    def __init__(self, plants: Sequence[PlantSpec], rival: Agent, speed: float = 1.0) -> None:
        self.plants, self.speed, self.action = plants, speed, 0.0
        player = Agent("you", {}, lambda: lambda observation: np.array([self.action], np.float32))
        self.episode, self.rival = Episode(player, plants[0]), Episode(rival, plants[0])
        self.paused, self.over = False, False
        self._number, self._time, self._strength = 0, 0.0, FIRST_STRENGTH
        self._held: list[str] = []

    def begin(self, number: int) -> None:
        """Begins an episode of both on the plant of that number, counted on from the first without end."""
        self._number, self._time = number % len(self.plants), 0.0
        for episode in (self.episode, self.rival):
            episode.begin(self.plants[self._number])

    def on_key(self, name: str, pressed: bool) -> None:
        """Handles a key.

        Args:
            name: as pygame names it.
            pressed: False where it is released.
        """
        if name in LEFT | RIGHT:
            self._held = [held for held in self._held if held != name] + [name] * pressed
        match name if pressed else "":
            case "n":
                self.begin(self._number + 1)
            case "r":
                self.begin(self._number)
            case "space":
                self.paused = not self.paused
            case "up":
                self._strength = min(self._strength + 1, len(STRENGTHS) - 1)
            case "down":
                self._strength = max(self._strength - 1, 0)
            case "q" | "escape":
                self.over = True
        # The key that was pressed last wins.
        side = 0.0 if not self._held else 1.0 if self._held[-1] in LEFT else -1.0
        self.action = side * STRENGTHS[self._strength]

    def tick(self, seconds: float) -> None:
        """Advances the game by that much time of the player, s."""
        if self.paused or self.episode.end is not None:
            return
        self._time += self.speed * seconds
        self.episode.advance(self._time)
        # Seen at the same instant, also where the player's episode has ended within.
        self.rival.advance(self.episode.time)

    def note(self) -> str:
        """The keys, and how strong and how fast the player is."""
        return (
            f"A D torque   up down {STRENGTHS[self._strength]:.0%}   N next plant   R again   space pause   Q end   "
            f"{'paused' if self.paused else f'speed {self.speed:g}'}"
        )

    def banner(self) -> str:
        """How the episode has ended; empty while it goes on."""
        if self.episode.end is None:
            return ""
        speeds = f"{self.episode.mean_speed:.2f} cm/s, {self.rival.agent.name} {self.rival.mean_speed:.2f}"
        return f"{TERMINATIONS[self.episode.end].capitalize()} after {self.episode.time:.1f} s: {speeds}"

    def run(self, renderer: Renderer, seconds: float) -> None:
        """Draws and plays until the player ends the game or closes the window.

        Args:
            renderer: of a window that passes its keys to `on_key`, and holds its frames to the pace.
            seconds: between two frames.
        """
        while not self.over:
            state, ghost = self.episode.state(), self.rival.ghost()
            renderer.draw(**state, ghost=ghost, note=self.note(), banner=self.banner())
            if renderer.closed:
                return
            self.tick(seconds)


@dataclass(frozen=True, kw_only=True)
class Args(PlantArgs):
    """Lets you drive the capsule by keys, with a control law or a trained policy as a ghost on the same plant.

    Left and right, or A and D, swing the ball; up and down set how strongly. N takes the next plant, R begins again on
    this one, space pauses, Q or Escape ends.

    Examples:
      python -m capsule_gym.play
      python -m capsule_gym.play --set wide --rival direct-ppo
      python -m capsule_gym.play --M 0.6 --mu 0.05 --speed 0.5
    """

    rival: Annotated[str, arg(metavar="NAME_OR_PATH", help=f"The ghost: {', '.join(agent_names())}, or a path.")] = (
        "adaptive"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, PROG, arguments)
    try:
        game = Game(args.plants(), find_agent("--rival", args.rival), args.speed)
    except ValueError as error:
        refuse(PROG, str(error))
    with renderer_of(PROG, game.episode, "human", f"you and {game.rival.agent.name}", game.on_key) as renderer:
        game.run(renderer, 1.0 / FPS)
    return 0


if __name__ == "__main__":
    sys.exit(main())
