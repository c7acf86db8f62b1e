"""What trains in the benchmarks: presets with some fields changed, and Stable-Baselines3's own algorithms."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, Literal

from agents.training.presets import PRESETS, Config, PPOConfig, SACConfig
from benchmarks.machine import describe
from benchmarks.output import Output, check_at_least_one
from capsule_gym.command_line import Count

# Whose versions matter beside those that every machine names.
PACKAGES = ("stable-baselines3", "torch")

VecEnvKind = Literal["native", "DummyVecEnv"]

# The preset of the release before rollouts and updates were compiled. All of it: today's may change.
FORMER: dict[str, Any] = {
    "num_envs": 64,
    "n_steps": 256,
    "batch_size": 2048,
    "n_epochs": 6,
    "learning_rate": 1e-3,
    "final_learning_rate": 1e-4,
    "gamma": 0.995,
    "gae_lambda": 0.98,
    "ent_coef": 0.0,
    "hidden": 64,
    "log_std_init": -0.5,
    "termination_penalty": 30.0,
}
# What Stable-Baselines3 does where nothing is said, on eight environments.
UNTUNED: dict[str, Any] = {
    **FORMER,
    "num_envs": 8,
    "n_steps": 2048,
    "batch_size": 64,
    "n_epochs": 10,
    "learning_rate": 3e-4,
    "final_learning_rate": 3e-4,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "log_std_init": 0.0,
}


@dataclass(frozen=True)
class Trainer:
    """A training that is measured.

    Attributes:
        name: for the table.
        config: its hyperparameters.
        own: whether the algorithm is this package's, or else that of Stable-Baselines3.
        vec_env: the native batch of this package, or environments of `gym.make` one by one; these for the algorithms of
            Stable-Baselines3 alone.
        fused: whether each of SAC's steps of Adam is one call.
    """

    name: str
    config: Config
    own: bool = True
    vec_env: VecEnvKind = "native"
    fused: bool = True

    @property
    def updates(self) -> float:
        """Gradient steps per environment step."""
        if isinstance(self.config, PPOConfig):
            return self.config.n_epochs / self.config.batch_size
        assert isinstance(self.config, SACConfig)
        return self.config.gradient_steps / self.config.num_envs


@dataclass(frozen=True)
class Run:
    """A training that came to its end, as far as it is compared.

    Attributes:
        name: of its `Trainer`.
        seed: of the training.
        steps: environment steps until each evaluation of the deterministic policy.
        seconds: of processor time until then, evaluations not counted.
        mean_speed: what each came to, the interquartile mean over its episodes, cm/s.
        failed: share of these episodes that failed.
    """

    name: str
    seed: int
    steps: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    mean_speed: list[float] = field(default_factory=list)
    failed: list[float] = field(default_factory=list)

    @property
    def rate(self) -> float:
        """Environment steps per second."""
        return self.steps[-1] / self.seconds[-1]

    def at(self, part: float) -> float:
        """The mean speed where that part of the steps is done, by the nearest evaluation."""
        wanted = part * self.steps[-1]
        return min(zip(self.steps, self.mean_speed, strict=True), key=lambda point: abs(point[0] - wanted))[1]

    def seconds_to(self, speed: float) -> float:
        """Until the first evaluation that is as fast, or infinity."""
        pairs = zip(self.seconds, self.mean_speed, strict=True)
        return next((second for second, found in pairs if found >= speed), math.inf)


def ppo(name: str, *, own: bool = True, vec_env: VecEnvKind = "native", **changes: Any) -> Trainer:
    """The PPO preset of the direct task with some fields changed."""
    return Trainer(name, dataclasses.replace(PRESETS["direct", "ppo"], **changes), own, vec_env)


def sac(name: str, *, own: bool = True, fused: bool = True, **changes: Any) -> Trainer:
    """The SAC preset with some fields changed; updates begin at once."""
    config = dataclasses.replace(PRESETS["residual", "sac"], **{"learning_starts": 1000, **changes})
    return Trainer(name, config, own, fused=fused)


@dataclass(frozen=True, kw_only=True)
class TurnOptions(Output):
    """The options of commands in which trainings take turns."""

    turns: Count = 5
    """Turns of every contender."""
    seconds: float = 2.0
    """Length of a turn, about, in processor time."""

    def check(self) -> None:
        """Refuses what cannot be measured or written.

        Raises:
            ValueError: if something cannot.
        """
        super().check()
        check_at_least_one("--turns", self.turns)
        if not self.seconds > 0.0:
            raise ValueError(f"--seconds must be above 0, got {self.seconds:g}")

    def note(self, machine: dict[str, Any]) -> str:
        """What must be known to read the table."""
        return f"{describe(machine)}; {self.turns} turns of about {self.seconds:g} s of processor time."
