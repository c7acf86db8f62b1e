"""Creates the environments and the agent of a run from its configuration, with Stable-Baselines3's
own classes.

To train with another algorithm, pass it the environments that `make_env(config, seed)` returns.
"""

import dataclasses
import math
import pkgutil
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from sb3_contrib import TQC
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

CLASSES: dict[Algorithm, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "td3": TD3, "tqc": TQC}


class EpisodeMetrics(gym.Wrapper[Any, Any, Any, Any]):
    """Adds the episode's "metrics" (`capsule_gym.tasks.task.METRICS`) to the info of the last
    step.
    """

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Steps the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            steps = self.get_wrapper_attr("spec").max_episode_steps
            env: Any = self.env.unwrapped
            metrics = env.episode_metrics(steps)
            if terminated and not metrics["failed"]:
                # By a wrapper. As for the environment's own terminations, the speed is that over a
                # whole episode.
                seconds = steps * env.simulation.options.control_dt
                metrics |= {"failed": 1.0, "mean_speed": 100.0 * metrics["distance"] / seconds}
            info = {**info, "metrics": metrics}
        return observation, reward, terminated, truncated, info


def wrapped_env(config: Config, env_kwargs: Mapping[str, Any], steps: int) -> gym.Env[Any, Any]:
    """Creates one environment with the run's wrappers, inside SB3's `Monitor`.

    Raises:
        RunError: if a wrapper is not a subclass of `gymnasium.Wrapper` that takes only an
            environment.
    """
    env: Any = gym.make(
        f"capsule_gym:{config.env}", max_episode_steps=steps, disable_env_checker=True, **env_kwargs
    )
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
    """Creates the training environments with normalised observations and, for PPO, normalised
    rewards.

    Args:
        config: the configuration.
        seed: of the environments.
        **changes: other arguments of the environment, for example ranges that were identified.

    A wrong argument of the environment raises a TypeError or ValueError that names it.
    """
    kwargs = {**config.env_kwargs(), **changes}
    # Only for training: policies are selected with `residual_limit`, and the task's commands and
    # sensors.
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
    steps = max(1, round((config.episode_seconds or config.horizon) / config.control_dt))
    venv: VecEnv
    if config.wrapper:
        venv = DummyVecEnv([lambda: wrapped_env(config, kwargs, steps)] * config.num_envs)
        spaces = venv.observation_space, venv.action_space
        if not all(isinstance(space, gym.spaces.Box) for space in spaces):
            raise RunError(
                f"--wrapper must leave observations and actions Box, got {spaces[0]} and {spaces[1]}"
            )
        venv.seed(seed)
    else:
        venv = CapsuleSB3VecEnv(
            config.num_envs, seed, privileged=config.asymmetric, max_episode_steps=steps, **kwargs
        )
    rewards = (
        {"clip_reward": config.clip_reward}
        if isinstance(config, PPOConfig)
        else {"norm_reward": False}
    )
    env = VecNormalize(venv, gamma=config.gamma, **rewards)
    if config.observation_scale is not None:
        statistics: Any = env.obs_rms
        observed = statistics["policy"] if config.asymmetric else statistics
        factors = np.ones(observed.mean.shape)
        of = dict(zip(("theta", "theta_dot", "x_dot"), config.observation_scale, strict=True))
        of |= {"theta_d": of["theta"], "theta_d_dot": of["theta_dot"]}
        # Wrappers may add entries, or remove some; the names of stacked observations end with a
        # number.
        for i, name in zip(range(len(factors)), entries_of(EnvConfig(**kwargs)), strict=False):
            factors[i] = of.get(name.partition(" ")[0], 1.0)
        fixed: Any = FixedScale(factors)
        env.obs_rms = {**statistics, "policy": fixed} if config.asymmetric else fixed
    return env


def schedule(config: Config) -> LinearSchedule:
    """The learning rate over a run."""
    return LinearSchedule(config.learning_rate, config.final_learning_rate, end_fraction=1.0)


def make_model(config: Config, env: VecNormalize) -> BaseAlgorithm:
    """Creates an untrained agent in the environments of `make_env`."""
    network: dict[str, Any] = {"net_arch": [config.hidden, config.hidden]}
    network["activation_fn"] = {"tanh": nn.Tanh, "relu": nn.ReLU}[config.activation]
    kwargs: dict[str, Any] = {"learning_rate": schedule(config), "device": "cpu"}
    names: tuple[str, ...] = ("batch_size", "gamma", "seed")
    policy: Any = "MlpPolicy"
    if isinstance(config, PPOConfig):
        network["log_std_init"] = config.log_std_init
        names += ("n_steps", "n_epochs", "gae_lambda", "ent_coef")
    else:
        assert isinstance(config, OffPolicyConfig)
        kwargs["train_freq"] = 1
        names += ("buffer_size", "learning_starts", "gradient_steps", "tau")
        if config.action_noise > 0.0:
            kwargs["action_noise"] = make_noise(config)
        if config.n_steps > 1:
            # Equivalent to SB3's argument n_steps, which causes a warning when a model is loaded.
            kwargs["replay_buffer_class"] = NStepReplayBuffer
            kwargs["replay_buffer_kwargs"] = {"n_steps": config.n_steps, "gamma": config.gamma}
        names += ("target_entropy",) if isinstance(config, SACConfig) else ()
    kwargs |= {name: getattr(config, name) for name in names}
    if config.asymmetric:
        policy = AsymmetricPolicy
    elif isinstance(config, TQCConfig):
        kwargs["top_quantiles_to_drop_per_net"] = config.dropped_quantiles
        network["n_quantiles"] = config.quantiles
    return CLASSES[config.algo](policy, env, policy_kwargs=network, **kwargs)


def make_noise(config: OffPolicyConfig) -> ActionNoise:
    """Creates the noise on the actions in training."""
    mean, deviation, time = np.zeros(1), config.action_noise, config.noise_time
    if time == 0.0:
        return NormalActionNoise(mean, np.full(1, deviation))
    # The stationary standard deviation of the process is `deviation`.
    sigma = np.full(1, deviation * math.sqrt(2.0 / time))
    return OrnsteinUhlenbeckActionNoise(mean, sigma, theta=1.0 / time, dt=config.control_dt)
