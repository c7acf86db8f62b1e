"""One episode of a trained policy or a control law, in a window or as a GIF: `python -m capsule_gym.demo`."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
from gymnasium.error import DependencyNotInstalled
from tyro.conf import arg

from capsule_gym.command_line import Count, Positional, check_output, described, parse, refuse
from capsule_gym.evaluation_sets import EPISODE_SETTINGS, SET_NAMES, PlantSpec, load_set
from capsule_gym.parameters import check_number, nearest
from capsule_gym.policy import load_policy, policy_names, pretrained
from capsule_gym.rendering import FRAME_SECONDS, Ghost, Overlay, Renderer, write_gif
from capsule_gym.task import CONTROL_DT, HORIZON, Termination

PROG = "python -m capsule_gym.demo"
FPS = 50
SLOWEST, FASTEST = 0.1, 20.0
# Of the episode in a file unless told otherwise, s; and pictures there, each a megabyte until it is written.
FILE_SECONDS, MOST_PICTURES = 10.0, 1000
# Drives with no torque.
NOBODY = "zero"

Act = Callable[[np.ndarray], np.ndarray]

ENDS = {
    Termination.none: "the time is up",
    Termination.pendulum: "the ball met the platform",
    Termination.contact: "the capsule left the floor",
    Termination.diverged: "the motion was lost",
}


def law_names() -> list[str]:
    """The names of the control laws: the leaderboard's, and of a law that is not on it its own."""
    named: dict[str, str] = import_module("baselines.policies").LAWS
    return [*named, *(name for name in _own_names() if f"baselines:{name}" not in named.values())]


def find_law(name: str) -> str | None:
    """A control law as `controller` takes it, as "baselines:gait"; None where there is none of that name.

    Args:
        name: the leaderboard's, as "gait-guarded"; or its own, with or without its package, as "baselines:gait".
    """
    named: dict[str, str] = import_module("baselines.policies").LAWS
    own = name.removeprefix("baselines:").replace("-", "_")
    return named.get(name) or (f"baselines:{own}" if own in _own_names() else None)


def _own_names() -> list[str]:
    """The names of the control laws in Python."""
    return list(import_module("baselines").__all__)


def driver_names() -> list[str]:
    """Everything that drives by its name: no torque, the control laws, the trained policies."""
    return [NOBODY, *law_names(), *policy_names()]


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


class Driver(Protocol):
    """What drives: a trained policy, a law, a player.

    Attributes:
        name: as it is shown.
        env_kwargs: the environment that it acts in.
    """

    @property
    def name(self) -> str:
        """As it is shown."""

    @property
    def env_kwargs(self) -> Mapping[str, Any]:
        """The arguments of the environment that it acts in."""

    def start(self, seeds: Sequence[int], /) -> Act:
        """Begins a batch of episodes; returns the function from observations (n, entries) to actions (n, 1)."""


@dataclass(frozen=True)
class Law:
    """A control law by itself, or no torque at all.

    Attributes:
        name: as it is shown.
        env_kwargs: the environment with that law.
    """

    name: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)

    def start(self, seeds: Sequence[int]) -> Act:
        """Begins a batch of episodes, in which every action is 0."""
        actions = np.zeros((len(seeds), 1), np.float32)
        return lambda observations: actions


def find_driver(name_or_path: str) -> Driver:
    """Finds what drives.

    Args:
        name_or_path: one of `driver_names()`; a law also by its name in Python, as "gait" or "baselines:gait", one run
            of a policy as "residual-ppo/seed-2"; or the path of a policy file or of a training run's folder.

    Raises:
        ValueError: if there is no such driver, or its file is broken.
    """
    law = find_law(name_or_path)
    if law is not None:
        return Law(name_or_path.removeprefix("baselines:"), {"controller": law})
    if name_or_path == NOBODY:
        return Law(NOBODY)
    if name_or_path in pretrained() or Path(name_or_path).exists():
        return load_policy(name_or_path)
    names = driver_names()
    raise ValueError(
        f"must be one of {', '.join(names)}, or the path of a policy file or of a run's folder, got {name_or_path!r}"
        f"{nearest(name_or_path, names)}"
    )


class Drive:
    """The episode of one driver.

    Args:
        driver: what drives.
        plant: M, mu and the start.

    Attributes:
        driver: what drives.
        end: why the episode is over; None while it is not.
    """

    def __init__(self, driver: Driver, plant: PlantSpec) -> None:
        self.driver = driver
        # With it comes numba, which takes most of a second to import; a command line that is wrong needs none of it.
        from capsule_gym.env import CapsuleEnv

        settings: dict[str, Any] = {**driver.env_kwargs, **EPISODE_SETTINGS}
        self._dt = float(settings.get("control_dt", CONTROL_DT))
        self.env = CapsuleEnv(**settings)
        self.begin(plant)

    def begin(self, plant: PlantSpec) -> None:
        """Begins an episode on a plant."""
        self._act = self.driver.start([plant.seed])
        self._observation, self._info = self.env.reset(seed=plant.seed, options=plant.reset_options())
        self._steps = 0
        self.end: Termination | None = None

    @property
    def time(self) -> float:
        """Since the episode began, s."""
        return self._steps * self._dt

    def advance(self, time: float) -> None:
        """Steps to that time in s, or to the end of the episode."""
        while self.end is None and self.time + 0.5 * self._dt < time:
            self._observation, _, _, _, self._info = self.env.step(self._act(self._observation[None])[0])
            self._steps += 1
            if self._info["termination"]:
                self.end = Termination(int(self._info["termination"]))
            elif self.time + 0.5 * self._dt > HORIZON:
                self.end = Termination.none

    @property
    def mean_speed(self) -> float:
        """So far, cm/s; 0 at the start."""
        shown = self.shown()
        return 100.0 * shown["x"] / shown["time"] if shown["time"] > 0.0 else 0.0

    def shown(self) -> dict[str, Any]:
        """What `Renderer.draw` is told of the present state."""
        from capsule_gym.env import shown_state

        return shown_state(self.env.simulation, 0)

    def ghost(self) -> Ghost:
        """The present state as another robot's ghost."""
        theta, _, x, _ = self._info["state"].tolist()
        return Ghost(self.driver.name, theta, x)


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
    speeds = "; ".join(f"{each.driver.name} {each.mean_speed:.2f} cm/s" for each in (drive, rival) if each)
    ended = "" if not drive.end else f": {ENDS[drive.end]}"
    return f"{speeds} over {drive.time:.1f} s on M = {plant.M:g} kg, mu = {plant.mu:g}{ended}"


if __name__ == "__main__":
    sys.exit(main())
