"""What a run is begun with. Hyperparameters: a small dataclass per algorithm, a tuned instance per algorithm and task.

The fields are the command line of train.py, the text under each is its help. Nothing here imports torch.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from tyro.conf import Fixed, Suppress

from capsule_gym.command_line import Count
from capsule_gym.task import ENERGY_WEIGHT, TORQUE_LIMIT

# The files of a run that decide its policy.
CONFIG, MODEL, NORMALISATION = "config.json", "model.zip", "normalisation.json"

Task = Literal["residual", "direct"]
Algorithm = Literal["ppo", "sac"]


@dataclass(frozen=True, kw_only=True)
class Config:
    """What every training run has."""

    algo: ClassVar[Algorithm]

    # It chooses the preset, and so is no option of its own.
    task: Annotated[Task, Fixed, Suppress] = "residual"
    seed: Count = 0
    """Seed of everything: the same seed gives the same model on one machine."""
    total_steps: Count = 6_000_000
    """Environment steps."""
    num_envs: Count = 64
    """Environments that are stepped together."""
    controller: str | None = "baselines:adaptive"
    """Control law under a residual torque, as module:attribute."""
    residual_limit: float = 2.0 * TORQUE_LIMIT
    """Torque of the action 1, N m; twice the torque limit is full authority."""
    torque_limit: float = TORQUE_LIMIT
    """Largest motor torque, N m."""
    randomization: Literal["none", "paper", "wide"] = "paper"
    """Where M and mu of an episode come from."""
    observe_parameters: bool = False
    """Let the agent see M and mu."""
    energy_weight: float = ENERGY_WEIGHT
    """Centimetres of reward that a joule costs."""
    termination_penalty: float = 30.0
    """Centimetres of reward that a failed episode costs."""
    learning_rate: float = 1e-3
    """Step size of Adam at the start."""
    final_learning_rate: float = 1e-4
    """Step size of Adam at the end; linear in between."""
    gamma: float = 0.995
    """Discount factor per agent step."""
    hidden: Count = 64
    """Units in each of the two hidden layers."""
    batch_size: Count = 2048
    """Samples in a gradient step."""
    evaluate_every: Count = 500_000
    """Environment steps between evaluations and checkpoints."""
    evaluation_episodes: Count = 32
    """Episodes in each of them, with draws of their own."""
    torch_threads: Count = 1
    """Threads of torch."""
    env_threads: Count = 1
    """Threads of the environment."""

    def env_kwargs(self) -> dict[str, Any]:
        """The arguments of the environment that this run trains in."""
        names = (
            "residual_limit",
            "torque_limit",
            "randomization",
            "observe_parameters",
            "energy_weight",
            "termination_penalty",
        )
        kwargs = {name: getattr(self, name) for name in names}
        if self.task == "direct":
            return {**kwargs, "controller": None, "residual_limit": self.torque_limit}
        return {**kwargs, "controller": self.controller}

    def to_dict(self) -> dict[str, Any]:
        """The fields as plain types."""
        return dataclasses.asdict(self)


@dataclass(frozen=True, kw_only=True)
class PPOConfig(Config):
    """Proximal policy optimisation."""

    algo: ClassVar[Algorithm] = "ppo"

    n_steps: Count = 256
    """Steps of each environment between updates."""
    n_epochs: Count = 6
    """Passes over the collected steps in an update."""
    gae_lambda: float = 0.98
    """Decay of the generalised advantage estimate."""
    ent_coef: float = 0.0
    """Weight of the entropy bonus."""
    log_std_init: float = -0.5
    """Logarithm of the initial standard deviation of the action."""


@dataclass(frozen=True, kw_only=True)
class SACConfig(Config):
    """Soft actor-critic."""

    algo: ClassVar[Algorithm] = "sac"

    total_steps: Count = 400_000
    """Environment steps."""
    num_envs: Count = 32
    """Environments that are stepped together."""
    learning_rate: float = 7e-4
    """Step size of Adam at the start."""
    batch_size: Count = 512
    """Samples in a gradient step."""
    evaluate_every: Count = 50_000
    """Environment steps between evaluations and checkpoints."""
    buffer_size: Count = 400_000
    """Transitions that the replay buffer holds."""
    learning_starts: Count = 10_000
    """Random steps before the first update."""
    gradient_steps: Count = 8
    """Updates after each step of all environments."""
    tau: float = 0.01
    """Rate at which the target networks follow."""


PRESETS: dict[tuple[Task, Algorithm], Config] = {
    ("residual", "ppo"): PPOConfig(),
    ("direct", "ppo"): PPOConfig(task="direct", controller=None),
    ("residual", "sac"): SACConfig(),
    ("direct", "sac"): SACConfig(task="direct", controller=None),
}
