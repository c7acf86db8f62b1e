"""The environments and the agent of a run, made of its configuration; and where Stable-Baselines3's classes are slow.

`make_env` and `make_model` choose between `agents.fast_ppo` and Stable-Baselines3's own classes. To train with an
algorithm of one's own, make `make_env(config, seed)` and hand it to that algorithm.
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
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN, Actor
from torch import nn

from agents.training.presets import Config, OnPolicyConfig, PPOConfig, RunError, TD3Config, TQCConfig
from capsule_gym.sb3 import CapsuleSB3VecEnv
from capsule_gym.task import CONTROL_DT, TASKS

HALF_LOG_2_PI = 0.5 * math.log(2.0 * math.pi)
# As in SB3: keeps a logarithm finite where tanh has saturated.
EPSILON = 1e-6


# --- environments ----------------------------------------------------------------------------------------------------


class EpisodeMetrics(gym.Wrapper[Any, Any, Any, Any]):
    """Adds the episode's "metrics" (`capsule_gym.task.Metrics`) to the info of its last step."""

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """As the environment's."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            steps = self.get_wrapper_attr("spec").max_episode_steps
            info = {**info, "metrics": self.env.unwrapped.episode_metrics(steps)}  # type: ignore[attr-defined]
        return observation, reward, terminated, truncated, info


def fast_ppo(config: Config) -> Any:
    """The package `agents.fast_ppo` where the run uses it, else None. Nothing else imports it."""
    return None if config.stock or not isinstance(config, PPOConfig) else importlib.import_module("agents.fast_ppo")


def usable(config: Config) -> Config:
    """The configuration that can be trained: a run with wrappers, or without `agents.fast_ppo`, trains with --stock.

    Says so on stderr, and which options of the run Stable-Baselines3 does not have.
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


def wrapped_env(wrappers: tuple[str, ...], env_kwargs: Mapping[str, Any], steps: int) -> gym.Env[Any, Any]:
    """One environment with its wrappers, and SB3's `Monitor` below them, as SB3's `make_vec_env` places it.

    Raises:
        RunError: if there is no such subclass of `gymnasium.Wrapper`, or it is not made of an environment alone.
    """
    env_id, _ = TASKS[env_kwargs.get("task", "speed")]
    env: Any = gym.make(f"capsule_gym:{env_id}", max_episode_steps=steps, disable_env_checker=True, **env_kwargs)
    env = EpisodeMetrics(env)
    for name in wrappers:
        try:
            kind: Any = pkgutil.resolve_name(name)
            if not issubclass(kind, gym.Wrapper):
                raise TypeError("it is no subclass of gymnasium.Wrapper")
            env = kind(env)
        except (ImportError, AttributeError, TypeError, ValueError) as error:
            raise RunError(
                f"--wrapper must be MODULE:ATTRIBUTE of a gymnasium.Wrapper, got {name!r}: {error}"
            ) from error
    return Monitor(env)


def make_env(config: Config, seed: int) -> VecNormalize:
    """The training environments with normalised observations.

    Raises:
        TypeError: if an argument of the environment is of the wrong type.
        ValueError: if one is out of range.
    """
    kwargs = config.env_kwargs()
    steps = max(1, round((config.episode_seconds or config.horizon) / kwargs.get("control_dt", CONTROL_DT)))
    venv: VecEnv
    if config.wrapper:
        venv = DummyVecEnv([lambda: wrapped_env(config.wrapper, kwargs, steps)] * config.num_envs)
        if not isinstance(venv.observation_space, gym.spaces.Box) or not isinstance(venv.action_space, gym.spaces.Box):
            raise RunError(f"--wrapper must leave observations and actions Box, got {venv.observation_space}")
        venv.seed(seed)
    elif (fast := fast_ppo(config)) is not None:
        venv = fast.RolloutVecEnv(config, seed, steps, **kwargs)
    else:
        venv = CapsuleSB3VecEnv(config.num_envs, seed, max_episode_steps=steps, **kwargs)
    return VecNormalize(venv, norm_obs=True, norm_reward=False, gamma=config.gamma)


# --- algorithms ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LinearSchedule:
    """A learning rate that falls linearly, as SB3 asks for one.

    Attributes:
        start: at the start of the run.
        end: at its end.
    """

    start: float
    end: float

    def __call__(self, left: float) -> float:
        """The rate where that share of the run is left; below 0 where the last rollout exceeds the end."""
        return self.end + (self.start - self.end) * max(0.0, min(1.0, left))


def algorithm(config: Config) -> type[BaseAlgorithm]:
    """The class of a run's agent."""
    fast, sac = fast_ppo(config), SAC if config.stock else FastSAC
    classes: dict[str, type[BaseAlgorithm]] = {"ppo": PPO if fast is None else fast.FastPPO, "sac": sac}
    return (classes | {"td3": TD3, "tqc": TQC, "recurrent-ppo": RecurrentPPO})[config.algo]


def make_model(config: Config, env: VecNormalize) -> BaseAlgorithm:
    """A fresh agent.

    Args:
        config: its hyperparameters.
        env: its environments, from `make_env`.
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
    if isinstance(config, OnPolicyConfig):
        network["log_std_init"] = config.log_std_init
        names = ("n_steps", "n_epochs", "gae_lambda", "ent_coef")
    else:
        kwargs["train_freq"] = 1
        names = ("buffer_size", "learning_starts", "gradient_steps", "tau")
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
    elif isinstance(config, TD3Config):
        kwargs["action_noise"] = _action_noise(config)
    elif isinstance(config, TQCConfig):
        kwargs["top_quantiles_to_drop_per_net"] = config.dropped_quantiles
        network["n_quantiles"] = config.quantiles
    if not config.stock:
        # A step of Adam in one call; eps is SB3's.
        network["optimizer_kwargs"] = {"fused": True, **({"eps": 1e-5} if isinstance(config, OnPolicyConfig) else {})}
    model = algorithm(config)(policy, env, policy_kwargs=network, **kwargs)
    if isinstance(config, PPOConfig):
        vars(model)["critic_steps"] = config.critic_steps
    return model


def _action_noise(config: TD3Config) -> ActionNoise:
    """The noise on the actions of TD3 while it trains."""
    mean, deviation, time = np.zeros(1), config.action_noise, config.noise_time
    if time == 0.0:
        return NormalActionNoise(mean, np.full(1, deviation))
    # The stationary standard deviation of the process is `deviation`.
    sigma = np.full(1, deviation * math.sqrt(2.0 / time))
    return OrnsteinUhlenbeckActionNoise(mean, sigma, theta=1.0 / time, dt=CONTROL_DT)


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
    """The hyperbolic tangent by way of the logistic function: torch's own takes several times as long."""

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """The tangent of every entry."""
        return _Tanh.apply(input)


class RecurrentPolicy(RecurrentActorCriticPolicy):
    """sb3-contrib's policy, whose LSTM runs over a sequence in one call also where an episode begins with it."""

    @staticmethod
    def _process_sequence(
        features: torch.Tensor,
        lstm_states: tuple[torch.Tensor, torch.Tensor],
        episode_starts: torch.Tensor,
        lstm: nn.LSTM,
    ) -> tuple[torch.Tensor, tuple[torch.Tensor, torch.Tensor]]:
        """The LSTM's outputs and last state; sb3-contrib's own calls it at every step where any episode begins.

        Its buffer begins a sequence with every episode, so that only the first state is ever to be cleared.
        """
        count = lstm_states[0].shape[1]
        starts = episode_starts.reshape(count, -1)
        assert not starts[:, 1:].any(), "an episode must begin with a sequence, not within it"
        kept = (1.0 - starts[:, 0]).reshape(1, count, 1)
        sequences = features.reshape(count, -1, lstm.input_size).swapaxes(0, 1)
        outputs, states = lstm(sequences, (kept * lstm_states[0], kept * lstm_states[1]))
        return outputs.swapaxes(0, 1).flatten(end_dim=1), states


class FastSAC(SAC):
    """SAC whose `train` makes the same updates with fewer calls, about 1.7 times as fast.

    Networks of 64 units are so small that an update is mostly the cost of calling torch. Hence one draw from the replay
    buffer for all updates of a call; gradients only of the parameters that are stepped (SB3 also computes the critics'
    for the actor's loss, and clears them); the entropy coefficient's gradient in closed form; the log probability from
    the drawn noise, without objects for distributions; losses read once, at the end. The algorithm is SB3's, up to
    rounding: with one update per call and the same seed the parameters agree.

    Not supported, because this project does not use them: dictionary observations, a fixed entropy coefficient, gSDE,
    n-step returns, batch normalisation.
    """

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Makes `gradient_steps` updates, each with `batch_size` transitions."""
        assert self.replay_buffer is not None and self.ent_coef_optimizer is not None and self.log_ent_coef is not None
        assert isinstance(self.target_entropy, float) and not self.use_sde
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer, self.critic.optimizer, self.ent_coef_optimizer])
        actor, critic, target = (
            list[torch.Tensor](network.parameters()) for network in (self.actor, self.critic, self.critic_target)
        )
        data = self.replay_buffer.sample(batch_size * gradient_steps, env=self._vec_normalize_env)
        columns = (data.observations, data.actions, data.next_observations, data.dones, data.rewards)
        losses = []
        for batch in zip(*(column.split(batch_size) for column in columns), strict=True):
            observations, actions, next_observations, dones, rewards = batch
            proposed, log_prob = sample(self.actor, observations)
            with torch.no_grad():
                coefficient = self.log_ent_coef.exp()
                entropy_error = -(log_prob + self.target_entropy).mean()
                entropy_loss = self.log_ent_coef * entropy_error
                next_actions, next_log_prob = sample(self.actor, next_observations)
                values = torch.cat([next_observations, next_actions], dim=1)
                value = torch.minimum(*(network(values) for network in self.critic_target.q_networks))
                wanted = rewards + (1.0 - dones) * self.gamma * (value - coefficient * next_log_prob)
            self.log_ent_coef.grad = entropy_error.reshape(1)
            self.ent_coef_optimizer.step()

            pairs = torch.cat([observations, actions], dim=1)
            first, second = (network(pairs) for network in self.critic.q_networks)
            critic_loss = 0.5 * (nn.functional.mse_loss(first, wanted) + nn.functional.mse_loss(second, wanted))
            step(self.critic.optimizer, critic, critic_loss)

            pairs = torch.cat([observations, proposed], dim=1)
            value = torch.minimum(*(network(pairs) for network in self.critic.q_networks))
            actor_loss = (coefficient * log_prob - value).mean()
            step(self.actor.optimizer, actor, actor_loss)

            with torch.no_grad():
                torch._foreach_lerp_(target, critic, self.tau)
            losses.append(torch.stack([coefficient[0], actor_loss.detach(), critic_loss.detach(), entropy_loss[0]]))
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        names = ("ent_coef", "actor_loss", "critic_loss", "ent_coef_loss")
        for name, mean in zip(names, torch.stack(losses).mean(dim=0).tolist(), strict=True):
            self.logger.record(f"train/{name}", mean)


def sample(actor: Actor, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Actions of the present policy and their log probabilities, each of shape (batch, 1)."""
    latent = actor.latent_pi(observations)
    mean = actor.mu(latent)
    # The layer without gSDE, which `train` has made sure of.
    log_std = actor.log_std(latent).clamp(LOG_STD_MIN, LOG_STD_MAX)
    noise = torch.randn_like(mean)
    actions = torch.tanh(mean + log_std.exp() * noise)
    density = -0.5 * noise.square() - log_std - HALF_LOG_2_PI - torch.log(1.0 - actions.square() + EPSILON)
    return actions, density.sum(dim=1, keepdim=True)


def step(optimizer: torch.optim.Optimizer, parameters: list[torch.Tensor], loss: torch.Tensor) -> None:
    """One step of an optimizer down the gradient of a loss."""
    for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters), strict=True):
        parameter.grad = gradient
    optimizer.step()
