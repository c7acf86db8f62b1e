"""One episode of a trained or scripted policy, in a window or as a GIF: `python -m capsule_gym.demo`."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

from gymnasium.error import DependencyNotInstalled

from capsule_gym.checks import check_number, nearest, written
from capsule_gym.command_line import Count, Positional, arg, check_output, parse, refuse
from capsule_gym.env import CapsuleEnv, shown_state
from capsule_gym.evaluation_sets import EPISODE_SETTINGS, FURTHER_SET_NAMES, SET_NAMES, PlantSpec, load_set
from capsule_gym.policy import load_policy, policy_names, pretrained
from capsule_gym.rendering import FRAME_SECONDS, Renderer, write_gif
from capsule_gym.task import HORIZON, Termination

PROG = "python -m capsule_gym.demo"
# The scripted policies of `baselines`, which include control laws, and the names of all policies.
SCRIPTED: dict[str, Any] = import_module("baselines.policies").SCRIPTED
NAMES = [*SCRIPTED, *policy_names()]
SETS = SET_NAMES + FURTHER_SET_NAMES
TERMINATIONS = {
    Termination.none: "the time is up",
    Termination.pendulum: "the ball met the platform",
    Termination.contact: "the capsule left the floor",
    Termination.diverged: "the motion was lost",
}


def find_policy(name_or_path: str) -> Any:
    """Finds a scripted or trained policy, one of its runs ("residual-ppo/seed-2"), or a policy file or run by its path.

    Raises:
        ValueError: if there is no such policy, or its file is broken.
    """
    if name_or_path in SCRIPTED:
        return SCRIPTED[name_or_path]
    if name_or_path in pretrained() or os.path.exists(name_or_path):
        return load_policy(name_or_path)
    raise ValueError(
        f"a policy must be one of {', '.join(NAMES)}, or the path of a policy file or of a run's folder, got "
        f"{written(name_or_path)}{nearest(name_or_path, NAMES)}"
    )


class Episode:
    """An episode of one policy; `end` is the reason for its end, None while it runs.

    Args:
        policy: an object with the attributes `name`, `env_kwargs` and `start` of `capsule_gym.Policy`.
        plant: M, mu and the start.
        settings: the evaluation set's arguments of the environment; None for an ideal plant of the paper.
    """

    def __init__(self, policy: Any, plant: PlantSpec, settings: Mapping[str, Any] | None = None) -> None:
        self.policy = policy
        own = {"capsule": None, "disturbances": "none"} if settings is None else settings
        self.env = CapsuleEnv(**{**policy.env_kwargs, **EPISODE_SETTINGS, **own})
        self._dt = self.env.simulation.options.control_dt
        self.begin(plant)

    def begin(self, plant: PlantSpec) -> None:
        """Begins an episode on a plant."""
        self._act = self.policy.start([plant.seed])
        self._observation, _ = self.env.reset(seed=plant.seed, options=plant.reset_options())
        self._steps = 0
        self.end: Termination | None = None

    @property
    def time(self) -> float:
        """Time since the start of the episode, s."""
        return self._steps * self._dt

    def advance(self, time: float) -> None:
        """Steps until `time`, in s, or until the end of the episode."""
        while self.end is None and self.time + 0.5 * self._dt < time:
            action = self._act(self._observation[None])[0]
            self._observation, _, _, _, info = self.env.step(action)
            self._steps += 1
            if info["termination"] or self.time + 0.5 * self._dt > HORIZON:
                self.end = Termination(int(info["termination"]))

    def state(self) -> dict[str, Any]:
        """The present state, as arguments of `Renderer.draw`."""
        return shown_state(self.env.simulation, 0)

    @property
    def speed(self) -> str:
        """The policy's name and its mean speed so far."""
        return f"{self.policy.name} {100.0 * self.state()['x'] / max(self.time, self._dt):.2f} cm/s"

    def ghost(self) -> tuple[str, float, float]:
        """The present state, as the argument `ghost` of `Renderer.draw`."""
        state = self.state()
        return self.policy.name, state["theta"], state["x"]

    def renderer(self, mode: str, title: str, on_key: Callable[[str, bool], None] | None = None) -> Renderer:
        """A renderer of this episode; takes the arguments of `Renderer`."""
        limit = self.env.simulation.settings.torque_limit
        return Renderer(self.env.simulation.capsule, mode, round(1.0 / FRAME_SECONDS), limit, title, on_key)


@dataclass(frozen=True, kw_only=True)
class PlantArgs:
    """The plant."""

    set: Annotated[str, arg(metavar="NAME_OR_PATH", help=f"One of {', '.join(SETS)}, or the path of a file.")] = "paper"
    seed: Count = 0
    """Seed of the plant in the set."""
    M: float | None = None
    """Mass of the platform in kg, instead of the set's."""
    mu: float | None = None
    """Friction coefficient, instead of the set's."""

    def settings(self) -> dict[str, Any]:
        """The arguments of `Episode` that the episodes of the set share."""
        return load_set(self.set).env_kwargs

    def plants(self) -> tuple[PlantSpec, ...]:
        """The plants of the set, the chosen one first; a given M or mu applies to all and removes their changes."""
        plants = load_set(self.set).plants
        seeds = [plant.seed for plant in plants]
        if self.seed not in seeds:
            raise ValueError(f"--seed must be one of the set's, {min(seeds)} to {max(seeds)}, got {self.seed}")
        first = seeds.index(self.seed)
        given: dict[str, Any] = {name: value for name in ("M", "mu") if (value := getattr(self, name)) is not None}
        changed = given and {**given, "changes": ()}
        return tuple(replace(plant, **changed) for plant in plants[first:] + plants[:first])


@dataclass(frozen=True, kw_only=True)
class Args(PlantArgs):
    """Shows an episode of a trained or scripted policy: in a window, or with -o as a GIF in a file.

    Examples:
      python -m capsule_gym.demo direct-ppo
      python -m capsule_gym.demo residual-on-gait --rival adaptive --set drift --seed 3
      python -m capsule_gym.demo direct-ppo/seed-2 --M 0.6 --mu 0.05 --seconds 10 -o out.gif
    """

    policy: Annotated[
        Positional[str],
        arg(
            metavar="NAME_OR_PATH",
            help=f"{', '.join(NAMES)}; one run as NAME/seed-0; or the path of a policy file or of a run's folder.",
        ),
    ]
    rival: Annotated[str | None, arg(metavar="NAME_OR_PATH", help="A second policy, shown as an outline.")] = None
    output: Annotated[Path | None, arg(metavar="FILE", aliases=["-o"])] = None
    """Write a GIF to this file instead of opening a window."""
    overwrite: bool = False
    """Let --output replace an existing file."""
    seconds: float = HORIZON
    """Length of the shown part of the episode, s."""

    def check(self) -> None:
        """Raises an error for a time out of range and for files that cannot be written."""
        check_number("--seconds", self.seconds, f"above 0 and at most {HORIZON:g} s", 0.0, HORIZON, open_low=True)
        check_output("--output", self.output, overwrite=self.overwrite)
        if self.output is not None and self.output.suffix.lower() != ".gif":
            raise ValueError(f"--output must name a GIF, got {str(self.output)!r}")


@contextmanager
def errors_in_one_line(prog: str) -> Iterator[None]:
    """Ends a command with 2 after a wrong name or an error of the machine (no display), with 130 after Ctrl-C."""
    try:
        yield
    except (DependencyNotInstalled, ImportError, OSError, RuntimeError, ValueError) as error:
        refuse(prog, str(error))
    except KeyboardInterrupt:
        raise SystemExit(128 + signal.SIGINT) from None


def draw_episode(renderer: Renderer, seconds: float, episode: Episode, rival: Episode | None) -> Iterator[Any]:
    """Draws an episode for `seconds`, until it ends or until the window is closed; yields the frames, if any."""
    for n in range(round(seconds / FRAME_SECONDS) + 1):
        episode.advance(n * FRAME_SECONDS)
        if rival is not None:
            rival.advance(episode.time)
        yield renderer.draw(**{**episode.state(), **({"ghost": rival.ghost()} if rival else {})})
        if episode.end is not None or renderer.closed:
            return


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    with errors_in_one_line(PROG):
        plant = args.plants()[0]
        episode = Episode(find_policy(args.policy), plant, args.settings())
        rival = None if args.rival is None else Episode(find_policy(args.rival), plant, args.settings())
        renderer = episode.renderer("rgb_array" if args.output else "human", episode.policy.name)
        pictures = draw_episode(renderer, args.seconds, episode, rival)
        if args.output is not None:
            write_gif(pictures, args.output)
        for _ in pictures:
            pass
    speeds = "; ".join(each.speed for each in (episode, rival) if each)
    end = f": {TERMINATIONS[episode.end]}" if episode.end is not None else ""
    print(f"{speeds} over {episode.time:.1f} s on M = {plant.M:g} kg, mu = {plant.mu:g}{end}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
