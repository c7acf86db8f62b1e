"""Hyperparameters: one small dataclass per algorithm, one tuned instance per algorithm and task.

The fields are the command line of train.py, so each is explained where it stands.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, ClassVar

from capsule_gym.options import DOCS, Options
from capsule_gym.parameters import RANDOMIZATIONS


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


@dataclass(frozen=True, kw_only=True)
class PPOConfig(Config):
    """Proximal policy optimisation."""

    algo: ClassVar[str] = "ppo"

    n_steps: int = option(256, "steps of each environment between updates")
    n_epochs: int = option(6, "passes over the collected steps in an update")
    gae_lambda: float = option(0.98, "decay of the generalised advantage estimate")
    ent_coef: float = option(0.0, "weight of the entropy bonus")
    log_std_init: float = option(-0.5, "logarithm of the initial standard deviation of the action")


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


PRESETS: dict[tuple[str, str], Config] = {
    ("residual", "ppo"): PPOConfig(),
    ("direct", "ppo"): PPOConfig(task="direct", controller=None),
    ("residual", "sac"): SACConfig(),
    ("direct", "sac"): SACConfig(task="direct", controller=None),
}
