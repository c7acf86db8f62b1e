"""One episode at a time, driven by what is named: a trained policy, a control law, or nobody."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from capsule_gym.committed import NOBODY, committed, driver_names, find_law
from capsule_gym.env import CapsuleEnv, shown_state
from capsule_gym.evaluation_sets import EPISODE_SETTINGS, PlantSpec
from capsule_gym.parameters import nearest
from capsule_gym.policy import load_policy
from capsule_gym.rendering import Ghost
from capsule_gym.task import CONTROL_DT, HORIZON, Termination

Act = Callable[[np.ndarray], np.ndarray]

ENDS = {
    Termination.none: "the time is up",
    Termination.pendulum: "the ball met the platform",
    Termination.contact: "the capsule left the floor",
    Termination.diverged: "the motion was lost",
}


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
    if name_or_path in committed() or Path(name_or_path).exists():
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
        return shown_state(self.env.simulation, 0)

    def ghost(self) -> Ghost:
        """The present state as another robot's ghost."""
        theta, _, x, _ = self._info["state"].tolist()
        return Ghost(self.driver.name, theta, x)
