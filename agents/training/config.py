"""The hyperparameters of a run: a dataclass per algorithm, with the options of train.py as fields.

The docstring of a field is its help text. This module does not import torch.
"""

import dataclasses
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

import tyro
from tyro.conf import Fixed, Suppress

from capsule_gym.checks import check_integer, check_number, prefix_errors
from capsule_gym.command_line import Count
from capsule_gym.envs.config import DOCS, EnvConfig
from capsule_gym.identification import Fit
from capsule_gym.parameters import Capsule, Randomization
from capsule_gym.policies.policy import MOST_UNITS
from capsule_gym.tasks.registry import TASKS

# Largest seed of numpy's legacy generator, which SB3 seeds.
LARGEST_SEED = 2**32 - 1
# Files of a run; docs/training.md describes its folder.
CONFIG = "config.json"
RIG = "rig.json"
MODEL = "model.zip"
NORMALISATION = "vecnormalize.pkl"
BEST = "best"
LOGS = "logs"
EVALUATIONS = "evaluations.csv"

# The action: a torque in addition to that of a control law, or the motor torque. The command line
# and config.json call the mode "task"; in Python, the task is that of the environment.
ActionMode = Literal["residual", "direct"]
Environment = Literal["CapsuleStickSlip-v0", "CapsuleGoal-v0", "CapsuleVelocity-v0"]
Algorithm = Literal["ppo", "recurrentppo", "sac", "td3", "tqc"]


def _option(name: str, more: str = "") -> Any:
    """The help text of an environment's option."""
    text = DOCS[name]
    return tyro.conf.arg(help=f"{text[0].upper()}{text[1:]}{more}.")


# Options that older policies do not contain.
LATER_OPTIONS = (
    "total_torque",
    "disturbances",
    "observe_estimates",
    "stack_size",
    "initial_range",
)
# Smallest values of the counts; 1 for all others.
LEAST = {"seed": 0, "batch_size": 2, "learning_starts": 0, "dropped_quantiles": 0}
# Ranges of the other numbers: description, lower and upper end, and whether the lower end is
# excluded.
POSITIVE = ("a finite number > 0", 0.0, math.inf, True)
NONNEGATIVE = ("a finite number >= 0", 0.0, math.inf, False)
SHARE = ("a number in [0, 1]", 0.0, 1.0, False)
MOST = {"seed": LARGEST_SEED, "hidden": MOST_UNITS, "lstm_units": MOST_UNITS}
RANGES: dict[str, tuple[str, float, float, bool]] = {
    "learning_rate": POSITIVE,
    "episode_seconds": POSITIVE,
    "training_limit": POSITIVE,
    "observation_scale": POSITIVE,
    "clip_reward": POSITIVE,
    "final_learning_rate": NONNEGATIVE,
    "ent_coef": NONNEGATIVE,
    "action_noise": NONNEGATIVE,
    "noise_time": NONNEGATIVE,
    "gamma": SHARE,
    "gae_lambda": SHARE,
    "log_std_init": ("a number in [-20, 2]", -20.0, 2.0, False),
    "tau": ("a number in (0, 1]", 0.0, 1.0, True),
    "target_entropy": ("a finite number", -math.inf, math.inf, True),
}


# What an identified rig determines.
RIG_OPTIONS = ("mass_range", "friction_range", "static_ratio", "latency_range")


class RunError(ValueError):
    """Raised if a run cannot be started or resumed.

    The message names the option or the file, and the reason.
    """


def read_rig(path: str) -> dict[str, Any]:
    """The arguments of the environment that stands for an identified rig, from its file.

    Raises:
        RunError: if the file cannot be read.
    """
    try:
        return Fit.load(path).env_kwargs()
    except (OSError, ValueError) as error:
        raise RunError(f"--rig: {error}") from error


@dataclass(frozen=True, kw_only=True)
class Config:
    """Hyperparameters of every algorithm."""

    algo: ClassVar[Algorithm]

    # These fields determine the preset, so `train.Choice` has their options.
    action_mode: Annotated[ActionMode, Fixed, Suppress] = "residual"
    env: Annotated[Environment, Fixed, Suppress] = "CapsuleStickSlip-v0"
    seed: Count = 0
    """Random seed; the same seed gives the same model on one machine."""
    total_steps: Count = 6_000_000
    """Environment steps."""
    num_envs: Count = 64
    """Number of parallel environments."""
    controller: str | None = "baselines:adaptive"
    """Control law under a residual torque, as module:attribute."""
    residual_limit: Annotated[
        float, _option("residual_limit", "; twice the torque limit can cancel any law")
    ] = 2.0 * EnvConfig.torque_limit
    training_limit: float | None = None
    """Residual limit in training, N m; None for that of the policy, residual_limit."""
    total_torque: Annotated[bool, _option("total_torque")] = EnvConfig.total_torque
    torque_limit: Annotated[float, _option("torque_limit")] = EnvConfig.torque_limit
    randomization: Literal[
        "default", "none", "paper", "wide", "broad", "sticky", "real", "real-wide"
    ] = "paper"
    """Distribution of the plants; "default": that of the environment."""
    mass_range: tuple[float, float] | None = None
    """Ends of the range of M, kg; None for those of the distribution."""
    friction_range: tuple[float, float] | None = None
    """Ends of the range of mu; None for those of the distribution."""
    command_range: tuple[float, float] | None = None
    """Ends of the range of the commands in training, m/s; None for those of the task."""
    static_ratio: float | None = None
    """Static over kinetic friction coefficient of the floor; None for the environment's default."""
    disturbances: Annotated[Literal["none", "real"], _option("disturbances")] = "none"
    rig: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """Identified rig, a file of `Fit.save`: plant, ranges and disturbances are those of its 95 %
    intervals."""
    latency_range: tuple[float, float] | None = None
    """Ends of the range of the sensors' latency in training, s; None for that of the
    disturbances."""
    observe_parameters: Annotated[bool, _option("observe_parameters")] = (
        EnvConfig.observe_parameters
    )
    observe_estimates: Annotated[bool, _option("observe_estimates")] = EnvConfig.observe_estimates
    stack_size: Annotated[Count, _option("stack_size")] = 1
    initial_range: Annotated[tuple[float, float] | None, _option("initial_range")] = None
    control_dt: Annotated[float, _option("control_dt")] = EnvConfig.control_dt
    energy_weight: Annotated[float, _option("energy_weight")] = EnvConfig.energy_weight
    termination_penalty: Annotated[float, _option("termination_penalty")] = 30.0
    episode_seconds: float | None = None
    """Length of an episode of training, s; the environment's by default."""
    learning_rate: float = 1e-3
    """Step size of Adam at the start."""
    final_learning_rate: float = 1e-4
    """Step size of Adam at the end; linear in between."""
    gamma: float = 0.995
    """Discount factor per agent step."""
    hidden: Count = 64
    """Units in each of the two hidden layers."""
    activation: Literal["tanh", "relu"] = "tanh"
    """Activation of the hidden layers."""
    observation_scale: tuple[float, float, float] | None = None
    """Factors of the observed angle (rad), angular velocity (rad/s) and x_dot (m/s), those of a
    reference included; without them the observation is normalised by its running statistics."""
    batch_size: Count = 2048
    """Samples in a gradient step."""
    evaluate_every: Count = 500_000
    """Environment steps between evaluations and checkpoints."""
    evaluation_episodes: Count = 128
    """Episodes in an evaluation, on validation plants."""
    wrapper: Annotated[
        tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="MODULE:ATTRIBUTE")
    ] = ()
    """A gymnasium.Wrapper around each environment, the first one innermost; repeatable."""

    def env_kwargs(self) -> dict[str, Any]:
        """The arguments of the training environment."""
        fields = {field.name for field in dataclasses.fields(self)}
        kwargs: dict[str, Any] = {name: getattr(self, name) for name in DOCS if name in fields}
        if self.task != "speed":
            kwargs["task"] = self.task
        if self.randomization == "default":
            del kwargs["randomization"]
        if self.rig is not None:
            kwargs |= read_rig(self.rig)
        for name in LATER_OPTIONS:
            if kwargs[name] == getattr(EnvConfig, name):
                del kwargs[name]
        if self.static_ratio is not None:
            kwargs["capsule"] = Capsule(static_ratio=self.static_ratio)
        if self.mass_range or self.friction_range:
            distribution = Randomization.named(EnvConfig(**kwargs).randomization)
            M = self.mass_range or distribution.M
            mu = self.friction_range or distribution.mu
            with prefix_errors("mass_range and friction_range"):
                kwargs["randomization"] = dataclasses.replace(distribution, M=M, mu=mu)
        if self.action_mode == "direct":
            kwargs["controller"] = None
            kwargs["residual_limit"] = min(self.residual_limit, self.torque_limit)
        return kwargs

    @property
    def asymmetric(self) -> bool:
        """Whether the critic observes more than the actor."""
        return getattr(self, "privileged", False) and not self.wrapper

    @property
    def task(self) -> str:
        """The task of the environment: speed, goal or velocity."""
        return next(task.name for task in TASKS.values() if task.env_id == self.env)

    @property
    def horizon(self) -> float:
        """The length of the environment's episode, s."""
        return TASKS[self.task].horizon

    def to_dict(self) -> dict[str, Any]:
        """The fields as plain types, with the names of config.json."""
        fields = dataclasses.asdict(self)
        if self.rig is not None:
            # The copy in the folder of the run, which may be moved.
            fields["rig"] = RIG
        return {"task": fields.pop("action_mode"), **fields}

    def check(self) -> None:
        """Checks the hyperparameters; the environment checks its own arguments.

        A wrong field raises a TypeError or ValueError that names it.
        """
        if self.action_mode == "direct" and self.controller is not None:
            raise ValueError(f"controller must be None with direct torque, got {self.controller!r}")
        if self.rig is not None:
            for name in RIG_OPTIONS:
                if getattr(self, name) is not None:
                    raise ValueError(f"{name} must be None with rig, got {getattr(self, name)!r}")
        for field in dataclasses.fields(self):
            name = field.name
            value = getattr(self, name)
            if field.type == Count:
                least = LEAST.get(name, 1)
                accepted = f"an integer >= {least}"
                if name in MOST:
                    accepted += f" and <= {MOST[name]}"
                check_integer(name, value, accepted, least, MOST.get(name, sys.maxsize))
            elif name in RANGES and value is not None:
                accepted, low, high, open_low = RANGES[name]
                for number in value if isinstance(value, tuple) else (value,):
                    check_number(name, number, accepted, low, high, open_low=open_low)


@dataclass(frozen=True)
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
    clip_reward: float = 10.0
    """Largest absolute value of a normalised reward."""
    privileged: bool = False
    """The critic also observes the true plant and, where sensors are disturbed, the true state; not
    under wrappers."""


@dataclass(frozen=True)
class RecurrentPPOConfig(PPOConfig):
    """Proximal policy optimisation with an LSTM before the hidden layers of actor and critic."""

    algo: ClassVar[Algorithm] = "recurrentppo"

    lstm_units: Count = 64
    """Units of the LSTM of the actor, and of that of the critic."""

    def check(self) -> None:
        """Also checks that the critic observes what the actor does."""
        super().check()
        if self.privileged:
            raise ValueError(f"privileged must be False with recurrentppo, got {self.privileged!r}")


@dataclass(frozen=True)
class OffPolicyConfig(Config):
    """Algorithms that learn from a replay buffer."""

    buffer_size: Count = 400_000
    """Transitions that the replay buffer holds."""
    learning_starts: Count = 10_000
    """Random steps before the first update."""
    gradient_steps: Count = 8
    """Updates after each step of all environments."""
    n_steps: Count = 1
    """Steps whose rewards the target of a value sums before it adds the value of the state after
    them."""
    tau: float = 0.01
    """Rate of the moving average that the target networks are."""
    activation: Literal["tanh", "relu"] = "relu"
    action_noise: float = 0.0
    """Standard deviation of the noise that training adds to the actions."""
    noise_time: float = 0.0
    """Time over which that noise is correlated, s: uncorrelated noise hardly swings the
    pendulum."""


@dataclass(frozen=True)
class SACConfig(OffPolicyConfig):
    """Soft actor-critic."""

    algo: ClassVar[Algorithm] = "sac"

    target_entropy: float = -1.0
    """Entropy of the action that the entropy coefficient aims at."""


@dataclass(frozen=True)
class TD3Config(OffPolicyConfig):
    """Twin delayed deep deterministic policy gradient."""

    algo: ClassVar[Algorithm] = "td3"


@dataclass(frozen=True)
class TQCConfig(SACConfig):
    """Truncated quantile critics."""

    algo: ClassVar[Algorithm] = "tqc"

    quantiles: Count = 25
    """Quantiles of the return that each of the two critics estimates."""
    dropped_quantiles: Count = 2
    """Largest quantiles per critic that the target leaves out."""

    def check(self) -> None:
        """Also checks that at least one quantile remains in the target."""
        super().check()
        if self.dropped_quantiles >= self.quantiles:
            accepted = f"an integer < {self.quantiles}"
            raise ValueError(
                f"dropped_quantiles must be {accepted}, got {self.dropped_quantiles!r}"
            )


ALGORITHMS: dict[Algorithm, type[Config]] = {
    kind.algo: kind for kind in (PPOConfig, RecurrentPPOConfig, SACConfig, TD3Config, TQCConfig)
}


def read_config(run: Path) -> Config:
    """Reads the configuration in the folder of a run.

    Raises:
        RunError: if the file does not exist or is invalid.
    """
    path = run / CONFIG
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        given = content["hyperparameters"]
        # JSON has no tuples.
        given |= {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
        if content["task"] not in get_args(ActionMode):
            raise ValueError(f"task must be one of {get_args(ActionMode)}, got {content['task']!r}")
        action_mode = given.pop("task", Config.action_mode)
        config = ALGORITHMS[content["algo"]](action_mode=action_mode, **given)
        if config.rig is not None:
            config = dataclasses.replace(config, rig=str(run / RIG))
        config.check()
    except FileNotFoundError:
        found = f"{str(run)!r}, which has no {CONFIG}"
        raise RunError(f"--resume must name the folder of a run, got {found}") from None
    except (OSError, AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise RunError(f"{path} is not the configuration of a run: {reason}") from error
    return config
