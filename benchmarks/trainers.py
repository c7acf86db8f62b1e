"""What trains in the benchmarks: the presets of the residual task with some fields changed, in turns."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

from agents.training.presets import Config, PPOConfig, SACConfig
from benchmarks.machine import describe
from benchmarks.output import Output, check_at_least_one
from capsule_gym.command_line import Count

# Whose versions matter beside those that every machine names.
PACKAGES = ("stable-baselines3", "torch")

VecEnvKind = Literal["native", "DummyVecEnv", "SubprocVecEnv"]

# What Stable-Baselines3 does where nothing is said, on eight environments.
UNTUNED: dict[str, Any] = {
    "num_envs": 8,
    "n_steps": 2048,
    "batch_size": 64,
    "n_epochs": 10,
    "learning_rate": 3e-4,
    "final_learning_rate": 3e-4,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "ent_coef": 0.0,
    "log_std_init": 0.0,
}
# As many steps in an update as the preset, from four times the environments.
BROAD: dict[str, Any] = {"num_envs": 256, "n_steps": 64, "batch_size": 4096}


@dataclass(frozen=True)
class Trainer:
    """A training that is measured.

    Attributes:
        name: for the table.
        config: its hyperparameters.
        vec_env: the native batch of this package, or environments of `gym.make` in a class of Stable-Baselines3.
        lean: whether SAC is `LeanSAC`, or else that of Stable-Baselines3.
        fused: whether each of SAC's steps of Adam is one call.
    """

    name: str
    config: Config
    vec_env: VecEnvKind = "native"
    lean: bool = True
    fused: bool = True

    @property
    def updates(self) -> float:
        """Gradient steps per environment step."""
        if isinstance(self.config, PPOConfig):
            return self.config.n_epochs / self.config.batch_size
        assert isinstance(self.config, SACConfig)
        return self.config.gradient_steps / self.config.num_envs


def ppo(name: str, vec_env: VecEnvKind = "native", **changes: Any) -> Trainer:
    """The PPO preset with some fields changed."""
    return Trainer(name, dataclasses.replace(PPOConfig(), **changes), vec_env)


def sac(name: str, *, lean: bool = True, fused: bool = True, **changes: Any) -> Trainer:
    """The SAC preset with some fields changed, or another class; updates begin at once."""
    config = dataclasses.replace(SACConfig(), **{"learning_starts": 1000, **changes})
    return Trainer(name, config, lean=lean, fused=fused)


@dataclass(frozen=True, kw_only=True)
class TurnOptions(Output):
    """The options of commands in which trainings take turns."""

    turns: Count = 5
    """Turns of every contender."""
    seconds: float = 2.0
    """Length of a turn, about."""

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
        return f"{describe(machine)}; {self.turns} turns of about {self.seconds:g} s."
