"""A trained policy or a control law in a window, or as a moving picture: `python -m capsule_gym.demo`."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from capsule_gym.command_line import Positional, check_output, described, parse, refuse
from capsule_gym.committed import driver_names
from capsule_gym.parameters import check_number
from capsule_gym.plant_options import FPS, PlantOptions
from capsule_gym.rendering import FRAME_SECONDS, write_gif
from capsule_gym.task import HORIZON

if TYPE_CHECKING:
    from capsule_gym.drive import Drive
    from capsule_gym.evaluation_sets import PlantSpec
    from capsule_gym.rendering import Renderer

PROG = "python -m capsule_gym.demo"
# Of the episode in a file unless told otherwise, s; and pictures there, each a megabyte until it is written.
FILE_SECONDS, MOST_PICTURES = 10.0, 1000


@dataclass(frozen=True, kw_only=True)
class Options(PlantOptions):
    """Shows one episode of a trained policy or a control law: in a window, or with -o as a moving picture in a file.

    Examples:
      python -m capsule_gym.demo direct-ppo
      python -m capsule_gym.demo residual-on-gait --rival adaptive --set drift --seed 3
      python -m capsule_gym.demo direct-ppo/seed-2 --M 0.6 --mu 0.05 -o out.gif
    """

    policy: Annotated[
        Positional[str],
        arg(
            metavar="NAME_OR_PATH",
            help=f"{', '.join(driver_names())}; one run of a policy as NAME/seed-0; or the path of a policy file or of "
            "a run's folder.",
        ),
    ]
    rival: Annotated[str | None, arg(metavar="NAME_OR_PATH", help="Another one on the same plant, as a ghost.")] = None
    output: Annotated[Path | None, arg(metavar="FILE", aliases=["-o"])] = None
    """Write a GIF to this file instead of opening a window."""
    overwrite: bool = False
    """Let --output replace an existing file."""
    start: float = 0.0
    """Where in the episode it begins, s."""
    seconds: Annotated[
        float | None,
        described(f"How much of the episode; None shows the rest in a window, and puts {FILE_SECONDS:g} into a file."),
    ] = None

    def check(self) -> None:
        """Refuses numbers out of range, plants that do not exist and files that cannot be written."""
        super().check()
        accepted = f"between 0 and {HORIZON:g} s"
        check_number("--start", self.start, accepted, 0.0, HORIZON)
        if self.seconds is not None:
            check_number("--seconds", self.seconds, f"above 0 and at most {HORIZON:g} s", 0.0, HORIZON, open_low=True)
        check_output("--output", self.output, overwrite=self.overwrite)
        if self.output is not None:
            if self.output.suffix.lower() != ".gif":
                raise ValueError(f"--output must name a GIF, got {str(self.output)!r}")
            count = (self.end() - self.start) / (FRAME_SECONDS * self.speed)
            if count > MOST_PICTURES:
                raise ValueError(f"--seconds and --speed must give at most {MOST_PICTURES} pictures, got {count:.0f}")

    def end(self) -> float:
        """Where in the episode it ends, s."""
        seconds = self.seconds or (HORIZON if self.output is None else FILE_SECONDS)
        return min(HORIZON, self.start + seconds)


def scenes(drive: Drive, rival: Drive | None, renderer: Renderer, times: Sequence[float]) -> Iterator[Any]:
    """Draws an episode at these times, s, up to its end or until the window is closed; yields what was drawn."""
    from capsule_gym.rendering import Overlay

    for time in times:
        drive.advance(time)
        if rival is not None:
            rival.advance(drive.time)
        yield renderer.draw(**drive.shown(), overlay=Overlay(rival.ghost()) if rival else None)
        if drive.end is not None or renderer.closed:
            return


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    # After the command line is known to be right: numba takes most of a second to import.
    from gymnasium.error import DependencyNotInstalled

    from capsule_gym.drive import Drive, find_driver
    from capsule_gym.rendering import Renderer

    drives, plant = [], options.plants()[0]
    for option, name in (("NAME_OR_PATH", options.policy), ("--rival", options.rival)):
        try:
            drives += [] if name is None else [Drive(find_driver(name), plant)]
        except ValueError as error:
            refuse(PROG, f"{option} {error}")
    drive, rival = drives[0], next(iter(drives[1:]), None)
    simulation, name = drive.env.simulation, drive.driver.name
    mode = "human" if options.output is None else "rgb_array"
    try:
        renderer = Renderer(simulation.capsule, mode, FPS, simulation.settings.torque_limit, name)
    except (DependencyNotInstalled, RuntimeError) as error:
        refuse(PROG, f"{'no window' if options.output is None else 'no picture'}: {error}")
    try:
        show(options, drive, rival, renderer)
    except (ImportError, OSError) as error:
        refuse(PROG, str(error))
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    finally:
        renderer.close()
    print(summary(drive, rival, plant))
    if options.output is not None:
        print(f"Written: {options.output} ({options.output.stat().st_size / 1e6:.1f} MB)")
    return 0


def show(options: Options, drive: Drive, rival: Drive | None, renderer: Renderer) -> None:
    """Shows what the options ask for in the renderer's window, or writes it to their file."""
    every = options.speed * (1.0 / FPS if options.output is None else FRAME_SECONDS)
    count = round((options.end() - options.start) / every)
    pictures = scenes(drive, rival, renderer, [options.start + n * every for n in range(count + 1)])
    if options.output is not None:
        write_gif(pictures, options.output)
    else:
        for _ in pictures:
            pass


def summary(drive: Drive, rival: Drive | None, plant: PlantSpec) -> str:
    """What came of it, in a line."""
    from capsule_gym.drive import ENDS

    speeds = "; ".join(f"{each.driver.name} {each.mean_speed:.2f} cm/s" for each in (drive, rival) if each)
    ended = "" if not drive.end else f": {ENDS[drive.end]}"
    return f"{speeds} over {drive.time:.1f} s on M = {plant.M:g} kg, mu = {plant.mu:g}{ended}"


if __name__ == "__main__":
    sys.exit(main())
