"""The trainers that `python -m benchmarks.training` compares."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import wrappers
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn
from torch.distributions import Normal

from agents.training.algorithms import make_env, make_model
from agents.training.callbacks import validation_plants
from agents.training.export import recurrent_policy
from agents.training.presets import PRESETS
from baselines.evaluation.episodes import evaluate, scores
from baselines.evaluation.policies import wrap_policy
from capsule_gym.task import ENV_ID

CONFIG = PRESETS["direct", "ppo"]
ID, ENV_KWARGS = f"capsule_gym:{ENV_ID}", CONFIG.env_kwargs()
# Agent steps between evaluations.
EVERY = 32_768
# Environments of Stable-Baselines3 and SBX; their documentation advises several for PPO.
NUM_ENVS = 8


class Clock(BaseCallback):
    """Measures the processor time of a training until its policy is fast enough, without evaluations.

    Attributes:
        seconds: processor time so far, s.
        steps: agent steps so far.
        speed: mean speed in the last evaluation, cm/s.
    """

    def __init__(self, seed: int, speed: float, seconds: float) -> None:
        super().__init__()
        self.least_speed, self.most_seconds = speed, seconds
        self.plants = validation_plants(replace(CONFIG, seed=seed))
        self.seconds, self.steps, self.speed = 0.0, 0, -np.inf
        self.evaluated_at, self.began = 0, time.process_time()

    @property
    def over(self) -> bool:
        """Whether the training has reached its aim, or is given up."""
        return self.speed >= self.least_speed or self.seconds >= self.most_seconds

    def check(self, steps: int, policy: Callable[[], Any]) -> None:
        """Evaluates the policy if an evaluation is due."""
        if steps - self.evaluated_at >= EVERY:
            self.seconds += time.process_time() - self.began
            self.steps = self.evaluated_at = steps
            self.speed = float(scores(evaluate(policy(), self.plants), "mean_speed").mean())
            self.began = time.process_time()

    def _on_rollout_end(self) -> None:
        normalised: Any = self.model.get_vec_normalize_env()
        model: Any = self.model
        self.check(self.num_timesteps, lambda: recurrent_policy("agent", model, normalised, ENV_KWARGS))

    def _on_step(self) -> bool:
        return not self.over


def train_preset(seed: int, clock: Clock) -> None:
    """Trains as `train.py`."""
    config = replace(CONFIG, seed=seed)
    make_model(config, make_env(config, seed)).learn(config.total_steps, callback=clock)


def train_sb3(seed: int, clock: Clock, algorithm: Any = PPO) -> None:
    """Trains with the defaults of Stable-Baselines3 or SBX."""
    env = VecNormalize(make_vec_env(ID, NUM_ENVS, seed, env_kwargs=ENV_KWARGS))
    algorithm("MlpPolicy", env, seed=seed, device="cpu").learn(10**9, callback=clock)


def train_sbx(seed: int, clock: Clock) -> None:
    """Trains with SBX."""
    import sbx

    train_sb3(seed, clock, sbx.PPO)


def make_layers(inputs: int, scale: float) -> nn.Sequential:
    """A network of two hidden layers of 64 units, with orthogonal weights; `scale` is that of the last layer."""
    layers = [nn.Linear(inputs, 64), nn.Linear(64, 64), nn.Linear(64, 1)]
    for layer, gain in zip(layers, (2.0**0.5, 2.0**0.5, scale), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


def train_cleanrl(seed: int, clock: Clock) -> None:
    """Trains by a loop like CleanRL's `ppo_continuous_action.py`, with its hyperparameters, on one environment."""
    steps, epochs, batch, gamma, decay, clip, total, rate = 2048, 10, 64, 0.99, 0.95, 0.2, 1_000_000, 3e-4
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    env: gym.Env[Any, Any] = wrappers.ClipAction(gym.make(ID, **ENV_KWARGS))
    env = normalised = wrappers.NormalizeObservation(env)
    env = wrappers.TransformObservation(env, lambda seen: np.clip(seen, -10, 10), env.observation_space)
    env = wrappers.TransformReward(
        wrappers.NormalizeReward(env, gamma=gamma), lambda reward: max(-10.0, min(10.0, float(reward)))
    )
    size = int(np.prod(env.observation_space.shape or ()))
    actor, critic, log_std = make_layers(size, 0.01), make_layers(size, 1.0), nn.Parameter(torch.zeros(1))
    parameters = [*actor.parameters(), *critic.parameters(), log_std]
    optimiser = torch.optim.Adam(parameters, lr=rate, eps=1e-5)

    def act(observations: np.ndarray) -> np.ndarray:
        rms = normalised.obs_rms
        inputs = np.clip((observations - rms.mean) / np.sqrt(rms.var + normalised.epsilon), -10, 10)
        with torch.no_grad():
            return actor(torch.as_tensor(inputs, dtype=torch.float32)).numpy()

    seen, _ = env.reset(seed=seed)
    observation, done = torch.as_tensor(seen, dtype=torch.float32), 0.0
    for step in range(0, 10**9, steps):
        # CleanRL anneals the rate over its 1,000,000 steps; a longer training keeps the last one.
        optimiser.param_groups[0]["lr"] = rate * max(steps / total, 1.0 - step / total)
        observations, actions = torch.zeros(steps, size), torch.zeros(steps, 1)
        log_probs, rewards, values, dones = (torch.zeros(steps) for _ in range(4))
        for t in range(steps):
            observations[t], dones[t] = observation, done
            with torch.no_grad():
                distribution = Normal(actor(observation), log_std.exp())
                actions[t] = distribution.sample()
                log_probs[t], values[t] = distribution.log_prob(actions[t]).sum(), critic(observation)[0]
            seen, reward, terminated, truncated, _ = env.step(actions[t].numpy())
            rewards[t], done = float(reward), float(terminated or truncated)
            if done:
                seen, _ = env.reset()
            observation = torch.as_tensor(seen, dtype=torch.float32)
        advantages, last = torch.zeros(steps), torch.zeros(())
        with torch.no_grad():
            following, lasts = critic(observation)[0], 1.0 - done
        for t in reversed(range(steps)):
            error = rewards[t] + gamma * following * lasts - values[t]
            advantages[t] = last = error + gamma * decay * lasts * last
            following, lasts = values[t], 1.0 - float(dones[t])
        returns = advantages + values
        for part in (part for _ in range(epochs) for part in rng.permutation(steps).reshape(-1, batch)):
            distribution, value = Normal(actor(observations[part]), log_std.exp()), critic(observations[part])[:, 0]
            ratio = (distribution.log_prob(actions[part]).sum(1) - log_probs[part]).exp()
            advantage = advantages[part]
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            policy_loss = -torch.min(ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage).mean()
            clipped = values[part] + (value - values[part]).clamp(-clip, clip)
            errors = torch.max((value - returns[part]) ** 2, (clipped - returns[part]) ** 2)
            optimiser.zero_grad()
            (policy_loss + 0.25 * errors.mean()).backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimiser.step()
        clock.check(step + steps, lambda: wrap_policy(act, name="agent", env_kwargs=ENV_KWARGS))
        if clock.over:
            return


CONTENDERS: dict[str, Callable[[int, Clock], None]] = {
    "train.py": train_preset,
    "SB3, make_vec_env": train_sb3,
    "SBX, make_vec_env": train_sbx,
    "CleanRL's loop": train_cleanrl,
}
