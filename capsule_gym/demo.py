"""One episode of a policy or of your own, in a window or as a GIF: `python -m capsule_gym.demo`."""

import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from capsule_gym.checks import check_number, nearest, require, short_repr
from capsule_gym.command_line import Count, Positional, arg, check_output, command
from capsule_gym.envs.env import CapsuleEnv, shown_state
from capsule_gym.evaluation.sets import (
    FURTHER_SET_NAMES,
    SET_NAMES,
    TASK_SET_NAMES,
    EvaluationSet,
    PlantSpec,
    load_set,
)
from capsule_gym.policies.loading import load_policy, policy_names, pretrained
from capsule_gym.policies.policy import Policy
from capsule_gym.policies.scripted import find_scripted, scripted_names
from capsule_gym.rendering import FRAME_SECONDS, Renderer, write_gif
from capsule_gym.tasks.task import HORIZON, Termination

PROG = "python -m capsule_gym.demo"
TERMINATIONS = (
    "the time is up",
    "the ball met the platform",
    "the capsule left the floor",
    "the motion was lost",
)
# The action of a held key: 1.0 would end the episode in a third of a second.
STRENGTH = 0.4


def read_keys(observations: np.ndarray) -> np.ndarray:
    """The action of the arrow keys, or A and D, of the window."""
    import pygame

    held = pygame.key.get_pressed()
    # A growing theta swings the ball to the left.
    left = held[pygame.K_LEFT] or held[pygame.K_a]
    right = held[pygame.K_RIGHT] or held[pygame.K_d]
    return np.array([[STRENGTH * (bool(left) - bool(right))]], np.float32)


# A policy with the attributes of `capsule_gym.Policy` that an episode needs.
KEYBOARD = SimpleNamespace(name="keyboard", env_kwargs={}, start=lambda seeds: read_keys)
NAMES = [*scripted_names(), KEYBOARD.name, *policy_names()]


def find_policy(name_or_path: str) -> Any:
    """Finds a scripted or trained policy by name, or a policy file or run by its path.

    Raises:
        ValueError: if there is no such policy, or its file is broken.
    """
    if name_or_path == KEYBOARD.name:
        return KEYBOARD
    scripted = find_scripted(name_or_path)
    if scripted is not None:
        return scripted
    if name_or_path in pretrained() or os.path.exists(name_or_path):
        return load_policy(name_or_path)
    raise ValueError(
        f"a policy must be one of {', '.join(NAMES)}, or the path of a policy file or of a run's "
        f"folder, got {short_repr(name_or_path)}{nearest(name_or_path, NAMES)}"
    )


class Episode:
    """An episode of one policy.

    Args:
        policy: an object with the attributes `name`, `env_kwargs` and `start` of
            `capsule_gym.Policy`.
        found: the evaluation set, which determines the arguments of the environment.
        plant: M, mu and the start.

    Attributes:
        time: time since the start of the episode, s.
        end: the reason for its end, None while it runs.
    """

    def __init__(self, policy: Any, found: EvaluationSet, plant: PlantSpec) -> None:
        self.policy = policy
        self.time = 0.0
        self.end: Termination | None = None
        # Scripted policies without a task fit any set.
        unnamed = "speed" if isinstance(policy, Policy) else found.task
        found.check_task(policy.env_kwargs.get("task", unnamed), policy.name)
        self._horizon = found.horizon
        self.env = CapsuleEnv(**{**policy.env_kwargs, **found.env_kwargs})
        self._act = policy.start([plant.seed])
        self._observation, _ = self.env.reset(seed=plant.seed, options=plant.reset_options())

    def advance(self, time: float) -> None:
        """Steps until `time`, in s, or until the end of the episode."""
        dt = self.env.simulation.options.control_dt
        while self.end is None and self.time + 0.5 * dt < time:
            action = self._act(self._observation[None])[0]
            self._observation, _, _, _, info = self.env.step(action)
            self.time += dt
            if info["termination"] or self.time + 0.5 * dt > self._horizon:
                self.end = Termination(int(info["termination"]))

    @property
    def speed(self) -> str:
        """The policy's name and its mean speed so far."""
        x = shown_state(self.env.simulation, 0)["x"]
        speed = 100.0 * x / max(self.time, FRAME_SECONDS)
        return f"{self.policy.name} {speed:.2f} cm/s"


def draw_episode(
    renderer: Renderer, episode: Episode, rival: Episode | None, seconds: float, speed: float
) -> Iterator[Any]:
    """Draws an episode until it ends or the window is closed; yields the frames, if any."""
    for n in range(round(seconds / speed / FRAME_SECONDS) + 1):
        episode.advance(n * FRAME_SECONDS * speed)
        state = shown_state(episode.env.simulation, 0)
        if rival is not None:
            rival.advance(episode.time)
            other = shown_state(rival.env.simulation, 0)
            state["ghost"] = rival.policy.name, other["theta"], other["x"]
        yield renderer.draw(**state)
        if episode.end is not None or renderer.closed:
            return


def _find_plant(chosen: EvaluationSet, seed: int, M: float | None, mu: float | None) -> PlantSpec:
    """The plant with a seed; a given M or mu replaces the set's, whose changes are removed."""
    plants = {plant.seed: plant for plant in chosen.plants}
    require(seed in plants, "--seed", f"one of the set's, {min(plants)} to {max(plants)}", seed)
    plant = plants[seed]
    if M is not None:
        plant = replace(plant, M=M, changes=())
    if mu is not None:
        plant = replace(plant, mu=mu, changes=())
    return plant


PolicyName = Annotated[
    Positional[str],
    arg(
        metavar="NAME_OR_PATH",
        help=f"{', '.join(NAMES)}; one run as NAME/seed-0; or the path of a policy file or of a "
        "run's folder.",
    ),
]
SetName = Annotated[
    str,
    arg(
        name="set",
        metavar="NAME_OR_PATH",
        help=f"One of {', '.join(SET_NAMES + FURTHER_SET_NAMES + TASK_SET_NAMES)}, or the path of "
        "a file.",
    ),
]


@command(PROG, DependencyNotInstalled, ImportError, OSError, RuntimeError, ValueError)
def main(
    policy: PolicyName,
    rival: Annotated[str | None, arg(metavar="NAME_OR_PATH")] = None,
    found: SetName = "paper",
    seed: Count = 0,
    M: float | None = None,
    mu: float | None = None,
    output: Annotated[Path | None, arg(metavar="FILE", aliases=["-o"])] = None,
    overwrite: bool = False,
    seconds: float = HORIZON,
    speed: float = 1.0,
) -> None:
    """Shows an episode of a policy: in a window, or with -o as a GIF in a file.

    The policy keyboard takes the arrow keys, or A and D.

    Examples:
      python -m capsule_gym.demo direct-ppo
      python -m capsule_gym.demo keyboard --rival adaptive --speed 0.5
      python -m capsule_gym.demo residual-real --rival adaptive --set drift --seed 3
      python -m capsule_gym.demo direct-ppo/seed-2 --M 0.6 --mu 0.05 --seconds 10 -o out.gif

    Args:
        policy: Name of a policy or run, or path of its file or folder.
        rival: A second policy, shown as an outline.
        found: Name of an evaluation set, or path of a file.
        seed: Seed of the plant in the set.
        M: Mass of the platform in kg, instead of the set's, whose changes are removed.
        mu: Friction coefficient, instead of the set's, whose changes are removed.
        output: Write a GIF to this file instead of opening a window.
        overwrite: Let --output replace an existing file.
        seconds: Length of the shown part of the episode, s.
        speed: Shown seconds of the episode per second, from 0.1 to 20.
    """
    accepted = f"above 0 and at most {HORIZON:g} s"
    check_number("--seconds", seconds, accepted, 0.0, HORIZON, open_low=True)
    check_number("--speed", speed, "a number from 0.1 to 20", 0.1, 20.0)
    check_output("--output", output, overwrite=overwrite)
    if output is not None:
        is_gif = output.suffix.lower() == ".gif"
        require(is_gif, "--output", "the name of a GIF", str(output))
        if KEYBOARD.name in (policy, rival):
            reason = "with --output, which opens no window"
            raise ValueError(f"a policy must not be {KEYBOARD.name!r} {reason}")
    chosen = load_set(found)
    plant = _find_plant(chosen, seed, M, mu)
    episode = Episode(find_policy(policy), chosen, plant)
    outline = None if rival is None else Episode(find_policy(rival), chosen, plant)
    simulation = episode.env.simulation
    renderer = Renderer(
        simulation.capsule,
        "rgb_array" if output else "human",
        round(1.0 / FRAME_SECONDS),
        simulation.settings.torque_limit,
        episode.policy.name,
    )
    frames = draw_episode(renderer, episode, outline, seconds, speed)
    if output is not None:
        write_gif(frames, output)
    for _ in frames:
        pass
    result = episode.speed
    if outline is not None:
        result += f"; {outline.speed}"
    result += f" over {episode.time:.1f} s on M = {plant.M:g} kg, mu = {plant.mu:g}"
    if episode.end is not None:
        result += f": {TERMINATIONS[episode.end]}"
    print(result)


if __name__ == "__main__":
    sys.exit(main())
