"""Hyperparameters: one small dataclass per algorithm, one tuned instance per algorithm and task.

The fields are the command line of train.py, so each is explained where it stands.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from agents.training.errors import RunError
from capsule_gym.options import DOCS, Options
from capsule_gym.parameters import RANDOMIZATIONS, check_number

CONFIG = "config.json"
# Of numpy's generators, which SB3 seeds.
LARGEST_SEED = 2**32 - 1


def option(default: Any, help_text: str, choices: tuple[str, ...] | None = None) -> Any:
    """A dataclass field that says on the command line what it means."""
    return field(default=default, metadata={"help": help_text, "choices": choices})


@dataclass(frozen=True, kw_only=True)
class Config:
    """What every training run has."""

    algo: ClassVar[str]

    task: str = option("residual", "residual torque on a control law, or direct torque", ("residual", "direct"))
    seed: int = option(0, "seed of everything: the same seed gives the same model on one machine")
    total_steps: int = option(6_000_000, "environment steps")
    num_envs: int = option(64, "environments that are stepped together")
    controller: str | None = option("baselines:adaptive", "control law under a residual torque, as module:attribute")
    residual_limit: float = option(
        2.0 * Options.torque_limit, f"{DOCS['residual_limit']}; twice the torque limit is full authority"
    )
    torque_limit: float = option(Options.torque_limit, DOCS["torque_limit"])
    randomization: str = option("paper", "where M and mu of an episode come from", tuple(RANDOMIZATIONS))
    observe_parameters: bool = option(Options.observe_parameters, DOCS["observe_parameters"])
    energy_weight: float = option(Options.energy_weight, DOCS["energy_weight"])
    termination_penalty: float = option(30.0, DOCS["termination_penalty"])
    learning_rate: float = option(1e-3, "step size of Adam at the start")
    final_learning_rate: float = option(1e-4, "step size of Adam at the end; linear in between")
    gamma: float = option(0.995, "discount factor per agent step")
    hidden: int = option(64, "units in each of the two hidden layers")
    batch_size: int = option(2048, "samples in a gradient step")
    evaluate_every: int = option(500_000, "environment steps between evaluations and checkpoints")
    evaluation_episodes: int = option(32, "episodes in each of them, with draws of their own")
    torch_threads: int = option(1, "threads of torch")
    env_threads: int = option(Options.threads, "threads of the environment")

    def env_kwargs(self) -> dict[str, Any]:
        """The arguments of the environment that this run trains in."""
        kwargs = {name: getattr(self, name) for name in DOCS if hasattr(self, name)}
        return kwargs | {"controller": None, "residual_limit": self.torque_limit} if self.task == "direct" else kwargs

    def to_dict(self) -> dict[str, Any]:
        """The fields as plain types."""
        return dataclasses.asdict(self)

    def check(self) -> None:
        """Refuses hyperparameters that no run can have; what the environment takes is the environment's to check.

        Raises:
            TypeError: if a field is of the wrong type.
            ValueError: if a field is out of range.
        """
        self._check_counts(
            "total_steps",
            "num_envs",
            "hidden",
            "evaluate_every",
            "evaluation_episodes",
            "torch_threads",
            "env_threads",
        )
        self._check_counts("batch_size", least=2)
        self._check_counts("seed", least=0, most=LARGEST_SEED)
        self._check_range("learning_rate", "a finite number > 0", 0.0, open_low=True)
        self._check_range("final_learning_rate", "a finite number >= 0", 0.0)
        self._check_range("gamma", "a number in [0, 1]", 0.0, 1.0)

    def _check_counts(self, *names: str, least: int = 1, most: int = sys.maxsize) -> None:
        """Refuses fields that are no integers in that range."""
        for name in names:
            value = getattr(self, name)
            accepted = f"an integer >= {least}" + (f" and <= {most}" if most < sys.maxsize else "")
            if isinstance(value, bool) or not isinstance(value, int):
                raise TypeError(f"{name} must be {accepted}, got {value!r}")
            if not least <= value <= most:
                raise ValueError(f"{name} must be {accepted}, got {value!r}")

    def _check_range(self, name: str, accepted: str, low: float, high: float = math.inf, **open_end: bool) -> None:
        """Refuses a field that is no finite number in that range."""
        check_number(name, getattr(self, name), accepted, low, high, **open_end)


@dataclass(frozen=True, kw_only=True)
class PPOConfig(Config):
    """Proximal policy optimisation."""

    algo: ClassVar[str] = "ppo"

    n_steps: int = option(256, "steps of each environment between updates")
    n_epochs: int = option(6, "passes over the collected steps in an update")
    gae_lambda: float = option(0.98, "decay of the generalised advantage estimate")
    ent_coef: float = option(0.0, "weight of the entropy bonus")
    log_std_init: float = option(-0.5, "logarithm of the initial standard deviation of the action")

    def check(self) -> None:
        """As for all; and a rollout must hold the two samples that advantages are normalised over."""
        super().check()
        self._check_counts("n_steps", "n_epochs")
        if self.n_steps * self.num_envs < 2:
            raise ValueError(f"n_steps must be >= 2 where num_envs is 1, got {self.n_steps!r}")
        self._check_range("gae_lambda", "a number in [0, 1]", 0.0, 1.0)
        self._check_range("ent_coef", "a finite number >= 0", 0.0)
        self._check_range("log_std_init", "a number in [-20, 2]", -20.0, 2.0)


@dataclass(frozen=True, kw_only=True)
class SACConfig(Config):
    """Soft actor-critic."""

    algo: ClassVar[str] = "sac"

    total_steps: int = option(400_000, "environment steps")
    num_envs: int = option(32, "environments that are stepped together")
    learning_rate: float = option(7e-4, "step size of Adam at the start")
    batch_size: int = option(512, "samples in a gradient step")
    evaluate_every: int = option(50_000, "environment steps between evaluations and checkpoints")
    buffer_size: int = option(400_000, "transitions that the replay buffer holds")
    learning_starts: int = option(10_000, "random steps before the first update")
    gradient_steps: int = option(8, "updates after each step of all environments")
    tau: float = option(0.01, "rate at which the target networks follow")

    def check(self) -> None:
        """As for all; and the replay buffer must hold a step of all environments."""
        super().check()
        self._check_counts("gradient_steps")
        self._check_counts("learning_starts", least=0)
        self._check_counts("buffer_size", least=self.num_envs)
        self._check_range("tau", "a number in (0, 1]", 0.0, 1.0, open_low=True)


PRESETS: dict[tuple[str, str], Config] = {
    ("residual", "ppo"): PPOConfig(),
    ("direct", "ppo"): PPOConfig(task="direct", controller=None),
    ("residual", "sac"): SACConfig(),
    ("direct", "sac"): SACConfig(task="direct", controller=None),
}


def read_config(run: Path) -> Config:
    """The configuration of an earlier run.

    Args:
        run: its folder.

    Raises:
        RunError: if there is none, or it is broken.
    """
    path = run / CONFIG
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RunError(f"--resume must name the folder of a run, got {str(run)!r}, which has no {CONFIG}") from None
    except (OSError, ValueError) as error:
        raise RunError(f"{path} cannot be read: {error}") from error
    try:
        preset = PRESETS[content["task"], content["algo"]]
        config = type(preset)(**content["hyperparameters"])
        config.check()
    except KeyError as error:
        raise RunError(f"{path} is no configuration of a run: it lacks or does not know {error}") from error
    except (TypeError, ValueError) as error:
        raise RunError(f"{path} is no configuration of a run: {error}") from error
    return config
