"""One episode of a trained policy or a control law, in a window or as a GIF: `python -m capsule_gym.demo`."""

from __future__ import annotations

import signal
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from gymnasium.error import DependencyNotInstalled
from tyro.conf import arg

from capsule_gym.command_line import Count, Positional, check_output, parse, refuse
from capsule_gym.evaluation_sets import EPISODE_SETTINGS, SET_NAMES, PlantSpec, load_set
from capsule_gym.parameters import NOMINAL, check_number, nearest
from capsule_gym.policy import load_policy, policy_names, pretrained
from capsule_gym.rendering import FRAME_SECONDS, Ghost, Renderer, write_gif
from capsule_gym.task import HORIZON, Termination

PROG = "python -m capsule_gym.demo"
FPS = 50
SLOWEST, FASTEST = 0.1, 20.0
# Seconds of the episode in a file by default, and the most pictures there: each takes a megabyte until it is written.
FILE_SECONDS, MOST_PICTURES = 10.0, 1000
# The agent whose torque is always 0.
ZERO = "zero"

TERMINATIONS = {
    Termination.none: "the time is up",
    Termination.pendulum: "the ball met the platform",
    Termination.contact: "the capsule left the floor",
    Termination.diverged: "the motion was lost",
}


class Agent(NamedTuple):
    """A trained policy, a control law or a player.

    Attributes:
        name: as it is shown.
        env_kwargs: the arguments of the environment that it acts in.
        start: begins an episode; returns the function from an observation (entries,) to an action (1,).
    """

    name: str
    env_kwargs: Mapping[str, Any]
    start: Callable[[], Callable[[np.ndarray], np.ndarray]]


def control_laws() -> dict[str, str]:
    """The control laws as `controller` takes them: by the leaderboard's name, a law that is not on it by its own."""
    named: dict[str, str] = import_module("baselines.policies").LAWS
    own = {name: f"baselines:{name}" for name in import_module("baselines").__all__}
    return named | {name: law for name, law in own.items() if law not in named.values()}


def agent_names() -> list[str]:
    """The names that `find_agent` knows: no torque, the control laws, the trained policies."""
    return [ZERO, *control_laws(), *policy_names()]


def find_agent(option: str, name_or_path: str) -> Agent:
    """Finds an agent.

    Args:
        option: of the command line, for errors.
        name_or_path: one of `agent_names()`; one run of a policy as "residual-ppo/seed-2"; or the path of a policy
            file or of a training run's folder.

    Raises:
        ValueError: if there is no such agent, or its file is broken.
    """
    laws = control_laws()
    if name_or_path in laws or name_or_path == ZERO:
        kwargs = {"controller": laws.get(name_or_path)}
        return Agent(name_or_path, kwargs, lambda: lambda observation: np.zeros(1, np.float32))
    if name_or_path in pretrained() or Path(name_or_path).exists():
        policy = load_policy(name_or_path)
        return Agent(policy.name, policy.env_kwargs, lambda: policy.start([0]))
    names = agent_names()
    raise ValueError(
        f"{option} must be one of {', '.join(names)}, or the path of a policy file or of a run's folder, got "
        f"{name_or_path!r}{nearest(name_or_path, names)}"
    )


class Episode:
    """An episode of one agent.

    Args:
        agent: what acts.
        plant: M, mu and the start.

    Attributes:
        agent: what acts.
        env: the environment that it acts in.
        end: why the episode is over; None while it is not.
    """

    def __init__(self, agent: Agent, plant: PlantSpec) -> None:
        # With it comes numba, which takes most of a second to import; `--help` and errors need none of it.
        from capsule_gym.env import CapsuleEnv

        self.agent = agent
        self.env = CapsuleEnv(**{**agent.env_kwargs, **EPISODE_SETTINGS})
        self._dt = self.env.simulation.options.control_dt
        self.begin(plant)

    def begin(self, plant: PlantSpec) -> None:
        """Begins an episode on a plant."""
        self._act = self.agent.start()
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
            self._observation, _, _, _, self._info = self.env.step(self._act(self._observation))
            self._steps += 1
            if self._info["termination"]:
                self.end = Termination(int(self._info["termination"]))
            elif self.time + 0.5 * self._dt > HORIZON:
                self.end = Termination.none

    @property
    def mean_speed(self) -> float:
        """So far, cm/s; 0 at the start."""
        return 100.0 * self.ghost().x / self.time if self.time > 0.0 else 0.0

    def state(self) -> dict[str, Any]:
        """The present state, as `Renderer.draw` takes it."""
        from capsule_gym.env import shown_state

        return shown_state(self.env.simulation, 0)

    def ghost(self) -> Ghost:
        """The present state as another robot's ghost."""
        theta, _, x, _ = self._info["state"].tolist()
        return Ghost(self.agent.name, theta, x)


@dataclass(frozen=True, kw_only=True)
class PlantArgs:
    """The plant, and the pace."""

    set: Annotated[str, arg(metavar="NAME_OR_PATH", help=f"Plants: {', '.join(SET_NAMES)}, or a file.")] = "paper"
    seed: Count = 0
    """Which of the set's plants, by its seed."""
    M: float | None = None
    """Mass of the platform in kg, instead of the set's."""
    mu: float | None = None
    """Friction coefficient, instead of the set's."""
    speed: Annotated[float, arg(help=f"Times the speed of reality, from {SLOWEST:g} to {FASTEST:g}.")] = 1.0

    def check(self) -> None:
        """Refuses a speed out of range, and plants that do not exist."""
        check_number("--speed", self.speed, f"a number from {SLOWEST:g} to {FASTEST:g}", SLOWEST, FASTEST)
        self.plants()

    def plants(self) -> tuple[PlantSpec, ...]:
        """The plants of the set, the chosen one first; with M or mu given, all have these and none jumps."""
        plants = load_set(self.set).plants
        seeds = [plant.seed for plant in plants]
        if self.seed not in seeds:
            raise ValueError(f"--seed must be one of the set's, {min(seeds)} to {max(seeds)}, got {self.seed}")
        first = seeds.index(self.seed)
        given: dict[str, Any] = {name: value for name in ("M", "mu") if (value := getattr(self, name)) is not None}
        changed = given and {**given, "changes": ()}
        chosen = tuple(replace(plant, **changed) for plant in plants[first:] + plants[:first])
        for plant in chosen:
            NOMINAL.check_plant(plant.M, plant.mu)
        return chosen


@dataclass(frozen=True, kw_only=True)
class Args(PlantArgs):
    """Shows one episode of a trained policy or a control law: in a window, or with -o as a GIF in a file.

    Examples:
      python -m capsule_gym.demo direct-ppo
      python -m capsule_gym.demo residual-on-gait --rival adaptive --set drift --seed 3
      python -m capsule_gym.demo direct-ppo/seed-2 --M 0.6 --mu 0.05 -o out.gif
    """

    policy: Annotated[
        Positional[str],
        arg(
            metavar="NAME_OR_PATH",
            help=f"{', '.join(agent_names())}; one run of a policy as NAME/seed-0; or the path of a policy file or of "
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
        arg(help=f"How much of the episode; None shows the rest in a window, and puts {FILE_SECONDS:g} into a file."),
    ] = None

    def check(self) -> None:
        """Refuses numbers out of range, plants that do not exist and files that cannot be written."""
        super().check()
        check_number("--start", self.start, f"between 0 and {HORIZON:g} s", 0.0, HORIZON)
        if self.seconds is not None:
            check_number("--seconds", self.seconds, f"above 0 and at most {HORIZON:g} s", 0.0, HORIZON, open_low=True)
        check_output("--output", self.output, overwrite=self.overwrite)
        if self.output is not None:
            if self.output.suffix.lower() != ".gif":
                raise ValueError(f"--output must name a GIF, got {str(self.output)!r}")
            if len(self.times()) > MOST_PICTURES + 1:
                raise ValueError(
                    f"--seconds and --speed must give at most {MOST_PICTURES} pictures, got {len(self.times()) - 1}"
                )

    def times(self) -> list[float]:
        """When in the episode a picture is drawn, s."""
        every = self.speed * (1.0 / FPS if self.output is None else FRAME_SECONDS)
        seconds = self.seconds or (HORIZON if self.output is None else FILE_SECONDS)
        count = round((min(HORIZON, self.start + seconds) - self.start) / every)
        return [self.start + n * every for n in range(count + 1)]


@contextmanager
def renderer_of(
    prog: str, episode: Episode, mode: str, title: str, on_key: Callable[[str, bool], None] | None = None
) -> Iterator[Renderer]:
    """Opens a renderer and closes it; an error of the machine, as a missing display, ends the command in one line.

    Args:
        prog: the command as the user types it.
        episode: what is drawn.
        mode: "human" or "rgb_array".
        title: as `Renderer` takes it.
        on_key: as `Renderer` takes it.

    Raises:
        SystemExit: with 2 after an error, with 130 after Ctrl-C.
    """
    simulation = episode.env.simulation
    try:
        renderer = Renderer(simulation.capsule, mode, FPS, simulation.settings.torque_limit, title, on_key)
    except (DependencyNotInstalled, RuntimeError) as error:
        refuse(prog, f"cannot draw: {error}")
    try:
        yield renderer
    except (ImportError, OSError) as error:
        refuse(prog, str(error))
    except KeyboardInterrupt:
        raise SystemExit(128 + signal.SIGINT) from None
    finally:
        renderer.close()


def draw_episode(renderer: Renderer, times: Sequence[float], episode: Episode, rival: Episode | None) -> Iterator[Any]:
    """Draws an episode at these times, s, until it ends or the window is closed; yields what was drawn."""
    for time in times:
        episode.advance(time)
        if rival is not None:
            rival.advance(episode.time)
        yield renderer.draw(**episode.state(), ghost=rival.ghost() if rival else None)
        if episode.end is not None or renderer.closed:
            return


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, PROG, arguments)
    plant = args.plants()[0]
    try:
        episode = Episode(find_agent("NAME_OR_PATH", args.policy), plant)
        rival = None if args.rival is None else Episode(find_agent("--rival", args.rival), plant)
    except ValueError as error:
        refuse(PROG, str(error))
    with renderer_of(PROG, episode, "rgb_array" if args.output else "human", episode.agent.name) as renderer:
        pictures = draw_episode(renderer, args.times(), episode, rival)
        if args.output is not None:
            write_gif(pictures, args.output)
        else:
            deque(pictures, maxlen=0)
    speeds = "; ".join(f"{each.agent.name} {each.mean_speed:.2f} cm/s" for each in (episode, rival) if each)
    end = f": {TERMINATIONS[episode.end]}" if episode.end else ""
    print(f"{speeds} over {episode.time:.1f} s on M = {plant.M:g} kg, mu = {plant.mu:g}{end}")
    if args.output is not None:
        print(f"Written: {args.output} ({args.output.stat().st_size / 1e6:.1f} MB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
