"""You at the motor, in a window: `python -m capsule_gym.play`."""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from capsule_gym.command_line import parse, refuse
from capsule_gym.committed import driver_names
from capsule_gym.plant_options import FPS, PlantOptions

PROG = "python -m capsule_gym.play"


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
    # After the command line is known to be right: numba takes most of a second to import.
    from gymnasium.error import DependencyNotInstalled

    from capsule_gym.drive import find_driver
    from capsule_gym.game import Game, play
    from capsule_gym.rendering import Renderer

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
