"""Creates the environments and the agent of a run from its configuration; contains faster parts of Stable-Baselines3.

`make_env` and `make_model` choose between `agents.fast_ppo` and Stable-Baselines3's own classes. To train with another
algorithm, pass it the environments that `make_env(config, seed)` returns.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import pkgutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from sb3_contrib import TQC, RecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize
from torch import nn

from agents.training.config import (
    Config,
    OffPolicyConfig,
    OnPolicyConfig,
    PPOConfig,
    RunError,
    SACConfig,
    TQCConfig,
)
from agents.training.fast_sac import FastSAC
from capsule_gym.sb3 import CapsuleSB3VecEnv
from capsule_gym.tasks import velocity

HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)
# As in SB3: keeps a logarithm finite where tanh has saturated.
EPSILON = 1e-6


# --- environments ----------------------------------------------------------------------------------------------------


class EpisodeMetrics(gym.Wrapper[Any, Any, Any, Any]):
    """Adds the episode's "metrics" (`capsule_gym.task.Metrics`) to the info of the last step."""

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Steps the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            steps = self.get_wrapper_attr("spec").max_episode_steps
            # Only Gymnasium's base class lacks this method of `CapsuleEnv`.
            info = {**info, "metrics": self.env.unwrapped.episode_metrics(steps)}  # type: ignore[attr-defined]
        return observation, reward, terminated, truncated, info


def fast_ppo(config: Config) -> Any:
    """Imports the package `agents.fast_ppo` if the run uses it, else returns None."""
    return None if config.stock or not isinstance(config, PPOConfig) else importlib.import_module("agents.fast_ppo")


def usable(config: Config) -> Config:
    """Returns a configuration that can be trained: with wrappers or without `agents.fast_ppo`, `stock` is set.

    Options that Stable-Baselines3 does not support get their defaults. Prints these options and the reason to stderr.
    """
    reason = "--stock" if config.stock else "--wrapper" if config.wrapper else ""
    if not reason and isinstance(config, PPOConfig) and importlib.util.find_spec("agents.fast_ppo") is None:
        reason = "agents/fast_ppo is missing"
    if not reason:
        return config
    own = config.fast_only if isinstance(config, PPOConfig) else ()
    stock = dataclasses.replace(config, stock=True, **{name: getattr(type(config), name) for name in own})
    lost = [
        f"--{name.replace('_', '-')} {value}"
        for name in own
        if (value := getattr(config, name)) != getattr(stock, name)
    ]
    without = f", without {', '.join(lost)}" if lost else ""
    print(f"{reason}: training with Stable-Baselines3's unmodified classes{without}.", file=sys.stderr)
    return stock


def wrapped_env(config: Config, env_kwargs: Mapping[str, Any], steps: int) -> gym.Env[Any, Any]:
    """Creates one environment with the run's wrappers, inside SB3's `Monitor`.

    Raises:
        RunError: if a wrapper is not a subclass of `gymnasium.Wrapper` that takes only an environment.
    """
    env: Any = gym.make(f"capsule_gym:{config.env}", max_episode_steps=steps, disable_env_checker=True, **env_kwargs)
    env = EpisodeMetrics(env)
    for name in config.wrapper:
        try:
            kind: Any = pkgutil.resolve_name(name)
            if not issubclass(kind, gym.Wrapper):
                raise TypeError("it is not a subclass of gymnasium.Wrapper")
            env = kind(env)
        except (ImportError, AttributeError, TypeError, ValueError) as error:
            raise RunError(
                f"--wrapper must be MODULE:ATTRIBUTE of a gymnasium.Wrapper, got {name!r}: {error}"
            ) from error
    return Monitor(env)


def make_env(config: Config, seed: int) -> VecNormalize:
    """Creates the training environments with normalised observations.

    Raises:
        TypeError: if an argument of the environment has the wrong type.
        ValueError: if an argument is out of range.
    """
    kwargs = config.env_kwargs()
    # Only for training: policies are selected with `residual_limit`, on the commands of the task.
    if config.training_limit is not None:
        kwargs["residual_limit"] = config.training_limit
    if config.command_range:
        if config.env_task != "velocity":
            raise ValueError(f"command_range must be None in {config.env}, which has no commands")
        kwargs["task"] = velocity.with_commands(*config.command_range)
    steps = max(1, round((config.episode_seconds or config.horizon) / config.control_dt))
    venv: VecEnv
    if config.wrapper:
        venv = DummyVecEnv([lambda: wrapped_env(config, kwargs, steps)] * config.num_envs)
        if not isinstance(venv.observation_space, gym.spaces.Box) or not isinstance(venv.action_space, gym.spaces.Box):
            raise RunError(f"--wrapper must leave observations and actions Box, got {venv.observation_space}")
        venv.seed(seed)
    elif (fast := fast_ppo(config)) is not None:
        venv = fast.RolloutVecEnv(config, seed, steps, **kwargs)
    else:
        venv = CapsuleSB3VecEnv(config.num_envs, seed, max_episode_steps=steps, **kwargs)
    env = VecNormalize(venv, norm_reward=False, gamma=config.gamma)
    if isinstance(config, OffPolicyConfig) and config.observation_scale is not None:
        # Running statistics would magnify `stick`, which is almost constant.
        env.training = False
        statistics: Any = env.obs_rms
        statistics.var[:3] = np.array(config.observation_scale) ** -2.0
    return env


# --- algorithms ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LinearSchedule:
    """A linear learning rate schedule for SB3.

    Attributes:
        start: learning rate at the start of the run.
        end: learning rate at the end of the run.
    """

    start: float
    end: float

    def __call__(self, left: float) -> float:
        """The learning rate at the remaining share `left` of the run, negative if the last rollout exceeds the end."""
        return self.end + (self.start - self.end) * max(0.0, min(1.0, left))


def algorithm(config: Config) -> type[BaseAlgorithm]:
    """The class of a run's agent."""
    fast, sac = fast_ppo(config), SAC if config.stock else FastSAC
    classes: dict[str, type[BaseAlgorithm]] = {"ppo": PPO if fast is None else fast.FastPPO, "sac": sac}
    return (classes | {"td3": TD3, "tqc": TQC, "recurrent-ppo": RecurrentPPO})[config.algo]


def make_model(config: Config, env: VecNormalize) -> BaseAlgorithm:
    """Creates an untrained agent.

    Args:
        config: the agent's hyperparameters.
        env: the agent's environments, from `make_env`.
    """
    venv: Any = env.venv
    network: dict[str, Any] = {"net_arch": [config.hidden, config.hidden]}
    kwargs: dict[str, Any] = {
        "learning_rate": LinearSchedule(config.learning_rate, config.final_learning_rate),
        "batch_size": config.batch_size,
        "gamma": config.gamma,
        "seed": config.seed,
        "device": "cpu",
    }
    policy: Any = "MlpPolicy"
    names: tuple[str, ...]
    if isinstance(config, OnPolicyConfig):
        network["log_std_init"] = config.log_std_init
        names = ("n_steps", "n_epochs", "gae_lambda", "ent_coef")
    else:
        kwargs["train_freq"] = 1
        names = ("buffer_size", "learning_starts", "gradient_steps", "tau")
        assert isinstance(config, OffPolicyConfig)
        if config.action_noise > 0.0:
            kwargs["action_noise"] = make_noise(config)
        if config.n_steps > 1:
            # Equivalent to SB3's argument n_steps, which causes a warning when a model is loaded.
            kwargs["replay_buffer_class"] = NStepReplayBuffer
            kwargs["replay_buffer_kwargs"] = {"n_steps": config.n_steps, "gamma": config.gamma}
        names += ("target_entropy",) if isinstance(config, SACConfig) else ()
    kwargs |= {name: getattr(config, name) for name in names}
    fast = fast_ppo(config)
    if isinstance(config, PPOConfig):
        network["activation_fn"] = nn.Tanh if fast is None else FastTanh
        if fast is not None:
            policy, network["policy_inputs"] = fast.FastPolicy, venv.header.inputs
            network |= {"least_log_std": config.least_log_std, "tanh_mean": config.tanh_mean}
    elif config.algo == "recurrent-ppo":
        policy = "MlpLstmPolicy" if config.stock else RecurrentPolicy
        network |= {"lstm_hidden_size": config.hidden, "enable_critic_lstm": False}
        network["activation_fn"] = nn.Tanh if config.stock else FastTanh
    elif isinstance(config, TQCConfig):
        kwargs["top_quantiles_to_drop_per_net"] = config.dropped_quantiles
        network["n_quantiles"] = config.quantiles
    if not config.stock:
        # The fused Adam makes a step in one call; eps is SB3's default for on-policy algorithms.
        network["optimizer_kwargs"] = {"fused": True, **({"eps": 1e-5} if isinstance(config, OnPolicyConfig) else {})}
    model = algorithm(config)(policy, env, policy_kwargs=network, **kwargs)
    if isinstance(config, PPOConfig):
        vars(model)["critic_steps"] = config.critic_steps
    return model


def make_noise(config: OffPolicyConfig) -> ActionNoise:
    """Creates the noise on the actions in training."""
    mean, deviation, time = np.zeros(1), config.action_noise, config.noise_time
    if time == 0.0:
        return NormalActionNoise(mean, np.full(1, deviation))
    # The stationary standard deviation of the process is `deviation`.
    sigma = np.full(1, deviation * math.sqrt(2.0 / time))
    return OrnsteinUhlenbeckActionNoise(mean, sigma, theta=1.0 / time, dt=config.control_dt)


# --- faster parts of Stable-Baselines3 -------------------------------------------------------------------------------


class _Tanh(torch.autograd.Function):
    """tanh(x) = 2 / (1 + exp(-2 x)) - 1, to float32's rounding."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor) -> torch.Tensor:
        y = torch.mul(x, 2.0).sigmoid_().mul_(2.0).sub_(1.0)
        ctx.save_for_backward(y)
        return y

    @staticmethod
    def backward(ctx: Any, slope: torch.Tensor) -> torch.Tensor:
        (y,) = ctx.saved_tensors
        return torch.ops.aten.tanh_backward(slope, y)


class FastTanh(nn.Tanh):
    """The hyperbolic tangent, computed by the logistic function: several times as fast as torch's tanh."""

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """Applies the hyperbolic tangent to every entry."""
        return _Tanh.apply(input)


class RecurrentPolicy(RecurrentActorCriticPolicy):
    """sb3-contrib's policy with one call of the LSTM per sequence, also if an episode begins with the sequence."""

    @staticmethod
    def _process_sequence(
        features: torch.Tensor,
        lstm_states: tuple[torch.Tensor, torch.Tensor],
        episode_starts: torch.Tensor,
        lstm: nn.LSTM,
    ) -> tuple[torch.Tensor, tuple[torch.Tensor, torch.Tensor]]:
        """The LSTM's outputs and last state; sb3-contrib calls the LSTM step by step as soon as any episode begins.

        In sb3-contrib's buffer every episode begins a sequence, so that only the first state may have to be cleared.
        """
        count = lstm_states[0].shape[1]
        starts = episode_starts.reshape(count, -1)
        assert not starts[:, 1:].any(), "an episode must begin with a sequence, not within it"
        kept = (1.0 - starts[:, 0]).reshape(1, count, 1)
        sequences = features.reshape(count, -1, lstm.input_size).swapaxes(0, 1)
        outputs, states = lstm(sequences, (kept * lstm_states[0], kept * lstm_states[1]))
        return outputs.swapaxes(0, 1).flatten(end_dim=1), states
