"""You at the motor, in a window: `python -m capsule_gym.play`."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from tyro.conf import arg

from capsule_gym.command_line import parse, refuse
from capsule_gym.demo import ENDS, FPS, Drive, Driver, PlantOptions, driver_names, find_driver
from capsule_gym.evaluation_sets import PlantSpec
from capsule_gym.rendering import Overlay, Renderer
from capsule_gym.task import CONTROL_DT, Termination

PROG = "python -m capsule_gym.play"
SPEEDS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
STRENGTHS = (0.2, 0.4, 0.6, 0.8, 1.0)
# At full strength a key that is held ends the episode in a third of a second.
GENTLE = 1
# A growing theta swings the ball to the left.
LEFT, RIGHT = frozenset({"left", "a"}), frozenset({"right", "d"})


class Player:
    """A driver whose action the keys decide.

    Attributes:
        name: as it is shown.
        env_kwargs: the environment of the direct torque.
        action: in [-1, 1].
    """

    name = "you"
    env_kwargs: Mapping[str, Any] = {}

    def __init__(self) -> None:
        self.action = 0.0

    def start(self, seeds: Sequence[int]) -> Callable[[np.ndarray], np.ndarray]:
        """Begins a batch of episodes, each of which gets the present action."""
        return lambda observations: np.full((len(seeds), 1), self.action, np.float32)


class Game:
    """A player and a rival on the same plant at the same time.

    Args:
        plants: what N goes through, the first one first.
        rival: the ghost.
        speed: simulated seconds per second.

    Attributes:
        drive: the player's episode.
        ghost: the rival's.
        shows_ghost: whether it is seen.
        paused: whether time stands still.
        over: whether the player has asked to end.
        best: the fastest whole episode so far, cm/s; None before the first.
    """

    def __init__(self, plants: Sequence[PlantSpec], rival: Driver, speed: float = 1.0) -> None:
        self.plants, self.speed = plants, speed
        self.player = Player()
        self.drive, self.ghost = Drive(self.player, plants[0]), Drive(rival, plants[0])
        self.shows_ghost, self.paused, self.over = True, False, False
        self.best: float | None = None
        self._number, self._time, self._strength = 0, 0.0, GENTLE
        self._held: list[str] = []

    def begin(self, number: int) -> None:
        """Begins an episode of both on the plant of that number, counted on from the first without end."""
        self._number, self._time = number % len(self.plants), 0.0
        for drive in (self.drive, self.ghost):
            drive.begin(self.plants[self._number])

    def on_key(self, name: str, pressed: bool) -> None:
        """Hears of a key.

        Args:
            name: as pygame names it.
            pressed: False where it is let go.
        """
        if name in LEFT | RIGHT:
            self._held = [held for held in self._held if held != name] + [name] * pressed
        elif pressed:
            act = self._commands().get(name)
            if act is not None:
                act()
        # The key that was pressed last wins.
        side = 0.0 if not self._held else 1.0 if self._held[-1] in LEFT else -1.0
        self.player.action = side * STRENGTHS[self._strength]

    def _commands(self) -> dict[str, Callable[[], None]]:
        """What a key does at the moment it is pressed."""
        faster, slower = (lambda: self._change_speed(1)), (lambda: self._change_speed(-1))
        return {
            "n": lambda: self.begin(self._number + 1),
            "r": lambda: self.begin(self._number),
            "g": lambda: setattr(self, "shows_ghost", not self.shows_ghost),
            "space": lambda: setattr(self, "paused", not self.paused),
            ".": self._step,
            "up": lambda: self._change_strength(1),
            "down": lambda: self._change_strength(-1),
            **dict.fromkeys(("+", "=", "[+]"), faster),
            **dict.fromkeys(("-", "[-]"), slower),
            **dict.fromkeys(("q", "escape"), lambda: setattr(self, "over", True)),
        }

    def _change_speed(self, by: int) -> None:
        beyond = [speed for speed in SPEEDS if (speed - self.speed) * by > 0.0]
        self.speed = min(beyond, key=lambda speed: abs(speed - self.speed), default=self.speed)

    def _change_strength(self, by: int) -> None:
        self._strength = max(0, min(len(STRENGTHS) - 1, self._strength + by))

    def _step(self) -> None:
        """One step of the agent, after which time stands still."""
        self.paused = True
        self._advance(CONTROL_DT)

    def tick(self, seconds: float) -> None:
        """Lets that much time of the player pass, s."""
        if not self.paused:
            self._advance(self.speed * seconds)

    def _advance(self, seconds: float) -> None:
        if self.drive.end is not None:
            return
        self._time += seconds
        self.drive.advance(self._time)
        # Seen at the same instant, also where the player's episode has ended within.
        self.ghost.advance(self.drive.time)
        if self.drive.end == Termination.none:
            self.best = max(self.best or -np.inf, self.drive.mean_speed)

    def overlay(self) -> Overlay:
        """What lies over the picture of the player's robot."""
        pace = "paused" if self.paused else f"speed {self.speed:g}"
        note = (
            f"A D torque   up down {STRENGTHS[self._strength]:.0%}   N next plant   R again   G ghost   + - {pace}   "
        )
        ghost = self.ghost.ghost() if self.shows_ghost else None
        return Overlay(ghost, f"{note}space pause   . step   Q end", self.banner())

    def banner(self) -> str:
        """How the episode has ended; empty while it goes on."""
        if self.drive.end is None:
            return ""
        speeds = f"{self.drive.mean_speed:.2f} cm/s, {self.ghost.driver.name} {self.ghost.mean_speed:.2f}"
        best = "" if self.best is None else f", your best {self.best:.2f}"
        return f"{ENDS[self.drive.end].capitalize()} after {self.drive.time:.1f} s: {speeds}{best}"


def play(game: Game, renderer: Renderer, seconds: float) -> None:
    """Draws and plays until the player ends it or closes the window.

    Args:
        game: what is played.
        renderer: of a window that tells the game of its keys, and holds its frames to the pace.
        seconds: between two frames.
    """
    while not game.over:
        renderer.draw(**game.drive.shown(), overlay=game.overlay())
        if renderer.closed:
            return
        game.tick(seconds)


@dataclass(frozen=True, kw_only=True)
class Options(PlantOptions):
    """Lets you drive the capsule by keys, with a control law or a trained policy as a ghost on the same plant.

    Left and right, or A and D, swing the ball; up and down set how strongly. N takes the next plant, R begins again on
    this one, G shows or hides the ghost, + and - change the speed, space pauses, a full stop makes one step, Q or
    Escape ends.

    Examples:
      python -m capsule_gym.play
      python -m capsule_gym.play --set wide --rival direct-ppo
      python -m capsule_gym.play --M 0.6 --mu 0.05 --speed 0.5
    """

    rival: Annotated[str, arg(metavar="NAME_OR_PATH", help=f"The ghost: {', '.join(driver_names())}, or a path.")] = (
        "adaptive"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    try:
        rival = find_driver(options.rival)
    except ValueError as error:
        refuse(PROG, f"--rival {error}")
    game = Game(options.plants(), rival, options.speed)
    capsule, limit = game.drive.env.simulation.capsule, game.drive.env.simulation.settings.torque_limit
    try:
        renderer = Renderer(capsule, "human", FPS, limit, f"you and {rival.name}", game.on_key)
    except (DependencyNotInstalled, RuntimeError) as error:
        refuse(PROG, f"no window: {error}")
    try:
        play(game, renderer, 1.0 / FPS)
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    finally:
        renderer.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
