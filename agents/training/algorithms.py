"""Creates the environments and the agent of a run, with Stable-Baselines3's own classes.

To train with another algorithm, pass it the environments that `make_env(config, seed)` returns.
"""

import dataclasses
import math
import pkgutil
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import (
    ActionNoise,
    NormalActionNoise,
    OrnsteinUhlenbeckActionNoise,
)
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize
from torch import nn

from agents.training.config import (
    Algorithm,
    Config,
    OffPolicyConfig,
    PPOConfig,
    RecurrentPPOConfig,
    RunError,
    SACConfig,
    TQCConfig,
)
from capsule_gym.checks import prefix_errors
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.contract import entries_of
from capsule_gym.parameters import Disturbances
from capsule_gym.sb3 import AsymmetricPolicy, CapsuleSB3VecEnv, FixedScale
from capsule_gym.tasks import velocity

CLASSES: dict[Algorithm, type[BaseAlgorithm]] = {
    "ppo": PPO,
    "recurrentppo": RecurrentPPO,
    "sac": SAC,
    "td3": TD3,
    "tqc": TQC,
}


class EpisodeMetrics(gym.Wrapper[Any, Any, Any, Any]):
    """Adds the episode's "metrics" (`capsule_gym.tasks.task.METRICS`) to the last step's info."""

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Steps the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            most_steps = self.get_wrapper_attr("spec").max_episode_steps
            env: Any = self.env.unwrapped
            metrics = env.episode_metrics(most_steps)
            terminated_by_wrapper = terminated and not metrics["failed"]
            if terminated_by_wrapper:
                # As for the environment's own terminations, the speed is that over a whole episode.
                horizon = most_steps * env.simulation.options.control_dt
                metrics |= {"failed": 1.0, "mean_speed": 100.0 * metrics["distance"] / horizon}
            info = {**info, "metrics": metrics}
        return observation, reward, terminated, truncated, info


def wrapped_env(config: Config, env_kwargs: Mapping[str, Any], steps: int) -> gym.Env[Any, Any]:
    """Creates one environment with the run's wrappers, inside SB3's `Monitor`.

    Raises:
        RunError: if a wrapper is not a subclass of `gymnasium.Wrapper` that takes only an
            environment.
    """
    name = f"capsule_gym:{config.env}"
    env: Any = gym.make(name, max_episode_steps=steps, disable_env_checker=True, **env_kwargs)
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
    # Outermost, since wrappers may end an episode.
    return Monitor(EpisodeMetrics(env))


def make_env(config: Config, seed: int, **changes: Any) -> VecNormalize:
    """Creates the training environments.

    Observations are normalised and, for PPO, rewards.

    Args:
        config: the configuration.
        seed: of the environments.
        **changes: other arguments of the environment, for example ranges that were identified.

    A wrong argument of the environment raises a TypeError or ValueError that names it.
    """
    kwargs = _training_kwargs(config) | changes
    steps = max(1, round((config.episode_seconds or config.horizon) / config.control_dt))
    venv = _make_venv(config, seed, kwargs, steps)
    if isinstance(config, PPOConfig):
        env = VecNormalize(venv, gamma=config.gamma, clip_reward=config.clip_reward)
    else:
        env = VecNormalize(venv, norm_reward=False)
    if config.observation_scale is not None:
        statistics: Any = env.obs_rms
        observed = statistics["policy"] if config.asymmetric else statistics
        names = list(entries_of(EnvConfig(**kwargs)))
        fixed: Any = FixedScale(_factors(config.observation_scale, names, observed.mean.shape))
        env.obs_rms = {**statistics, "policy": fixed} if config.asymmetric else fixed
    return env


def _training_kwargs(config: Config) -> dict[str, Any]:
    """The arguments of the training environments.

    `training_limit` and the ranges of commands and latencies are only for training, not for the
    selection of policies.
    """
    kwargs = config.env_kwargs()
    if config.training_limit is not None:
        kwargs["residual_limit"] = config.training_limit
    if config.command_range:
        if config.task != "velocity":
            raise ValueError(f"command_range must be None in {config.env}, which has no commands")
        with prefix_errors("command_range"):
            kwargs["task"] = velocity.with_commands(*config.command_range)
    if config.latency_range is not None:
        disturbances = Disturbances.named(config.disturbances) or Disturbances()
        kwargs["disturbances"] = dataclasses.replace(disturbances, latency=config.latency_range)
    return kwargs


def _make_venv(config: Config, seed: int, kwargs: dict[str, Any], steps: int) -> VecEnv:
    """Creates the environments without normalisation, with the run's wrappers."""
    if not config.wrapper:
        return CapsuleSB3VecEnv(
            config.num_envs, seed, privileged=config.asymmetric, max_episode_steps=steps, **kwargs
        )
    venv = DummyVecEnv([lambda: wrapped_env(config, kwargs, steps)] * config.num_envs)
    spaces = (venv.observation_space, venv.action_space)
    if not all(isinstance(space, gym.spaces.Box) for space in spaces):
        found = " and ".join(map(str, spaces))
        raise RunError(f"--wrapper must leave observations and actions Box, got {found}")
    venv.seed(seed)
    return venv


def _factors(
    scale: tuple[float, float, float], names: list[str], shape: tuple[int, ...]
) -> np.ndarray:
    """The factors of an observation's entries, of this shape; `names` are those without wrappers.

    Wrappers may add entries, or remove some.
    """
    theta, theta_dot, x_dot = scale
    factor_of = {
        "theta": theta,
        "theta_d": theta,
        "theta_dot": theta_dot,
        "theta_d_dot": theta_dot,
        "x_dot": x_dot,
    }
    factors = np.ones(shape)
    for i, name in enumerate(names[: len(factors)]):
        # The names of stacked observations end with a number.
        factors[i] = factor_of.get(name.partition(" ")[0], 1.0)
    return factors


def schedule(config: Config) -> LinearSchedule:
    """The learning rate over a run."""
    return LinearSchedule(config.learning_rate, config.final_learning_rate, end_fraction=1.0)


def make_model(config: Config, env: VecNormalize) -> BaseAlgorithm:
    """Creates an untrained agent in the environments of `make_env`."""
    network: dict[str, Any] = {
        "net_arch": [config.hidden, config.hidden],
        "activation_fn": {"tanh": nn.Tanh, "relu": nn.ReLU}[config.activation],
    }
    names = ["batch_size", "gamma", "seed"]
    kwargs: dict[str, Any] = {}
    policy: Any = AsymmetricPolicy if config.asymmetric else "MlpPolicy"
    if isinstance(config, RecurrentPPOConfig):
        policy = "MlpLstmPolicy"
        network["lstm_hidden_size"] = config.lstm_units
    if isinstance(config, PPOConfig):
        network["log_std_init"] = config.log_std_init
        names += ["n_steps", "n_epochs", "gae_lambda", "ent_coef"]
    else:
        assert isinstance(config, OffPolicyConfig)
        names += ["buffer_size", "learning_starts", "gradient_steps", "tau"]
        kwargs["train_freq"] = 1
        if config.action_noise > 0.0:
            kwargs["action_noise"] = make_noise(config)
        if config.n_steps > 1:
            # Equivalent to SB3's argument n_steps, which causes a warning when a model is loaded.
            kwargs["replay_buffer_class"] = NStepReplayBuffer
            kwargs["replay_buffer_kwargs"] = {"n_steps": config.n_steps, "gamma": config.gamma}
    if isinstance(config, SACConfig):
        names.append("target_entropy")
    if isinstance(config, TQCConfig):
        kwargs["top_quantiles_to_drop_per_net"] = config.dropped_quantiles
        network["n_quantiles"] = config.quantiles
    for name in names:
        kwargs[name] = getattr(config, name)
    return CLASSES[config.algo](
        policy,
        env,
        learning_rate=schedule(config),
        policy_kwargs=network,
        device="cpu",
        **kwargs,
    )


def make_noise(config: OffPolicyConfig) -> ActionNoise:
    """Creates the noise on the actions in training."""
    mean = np.zeros(1)
    if config.noise_time == 0.0:
        return NormalActionNoise(mean, np.full(1, config.action_noise))
    # The stationary standard deviation of the process is `action_noise`.
    sigma = np.full(1, config.action_noise * math.sqrt(2.0 / config.noise_time))
    theta = 1.0 / config.noise_time
    return OrnsteinUhlenbeckActionNoise(mean, sigma, theta, dt=config.control_dt)
