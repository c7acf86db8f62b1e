"""PPO on one environment, as CleanRL's `ppo_continuous_action.py`."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium import wrappers
from torch import nn
from torch.distributions import Normal

# Agent steps between updates.
STEPS = 2048
EPOCHS = 10
BATCH = 64
GAMMA = 0.99
LAMBDA = 0.95
CLIP = 0.2
# Agent steps over which the learning rate falls.
TOTAL_STEPS = 1_000_000
LEARNING_RATE = 3e-4
VALUE_COEFFICIENT = 0.25
LARGEST_GRADIENT = 0.5

Act = Callable[[np.ndarray], np.ndarray]


class Rollout(NamedTuple):
    """`STEPS` agent steps: each tensor has a row for each."""

    observations: torch.Tensor
    actions: torch.Tensor
    log_probs: torch.Tensor
    values: torch.Tensor
    advantages: torch.Tensor


def clipped(observation: np.ndarray) -> torch.Tensor:
    """A normalised observation, limited."""
    return torch.as_tensor(np.clip(observation, -10.0, 10.0), dtype=torch.float32)


def limit(reward: Any) -> float:
    """A normalised reward, limited."""
    return max(-10.0, min(10.0, float(reward)))


def network(inputs: int, scale: float) -> nn.Sequential:
    """Two hidden layers of 64, with orthogonal weights; `scale` is the gain of the last layer."""
    layers = [nn.Linear(inputs, 64), nn.Linear(64, 64), nn.Linear(64, 1)]
    for layer, gain in zip(layers, (2.0**0.5, 2.0**0.5, scale), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    first, second, last = layers
    return nn.Sequential(first, nn.Tanh(), second, nn.Tanh(), last)


class Agent:
    """The networks of the actions' mean and of the value, and the deviation of the actions."""

    def __init__(self, inputs: int) -> None:
        self.actor = network(inputs, 0.01)
        self.critic = network(inputs, 1.0)
        self.log_std = nn.Parameter(torch.zeros(1))
        self.parameters = [*self.actor.parameters(), *self.critic.parameters(), self.log_std]

    def distribution(self, observations: torch.Tensor) -> Normal:
        """The distribution of the actions."""
        return Normal(self.actor(observations), self.log_std.exp())

    def loss(self, batch: Rollout) -> torch.Tensor:
        """PPO's loss: the clipped objective, and the clipped error of the values."""
        log_probs = self.distribution(batch.observations).log_prob(batch.actions).sum(1)
        ratio = (log_probs - batch.log_probs).exp()
        spread = batch.advantages.std() + 1e-8
        advantages = (batch.advantages - batch.advantages.mean()) / spread
        bounded = ratio.clamp(1.0 - CLIP, 1.0 + CLIP)
        objective = torch.min(ratio * advantages, bounded * advantages).mean()
        returns = batch.advantages + batch.values
        values = self.critic(batch.observations)[:, 0]
        near = batch.values + (values - batch.values).clamp(-CLIP, CLIP)
        errors = torch.max((values - returns) ** 2, (near - returns) ** 2)
        return -objective + VALUE_COEFFICIENT * errors.mean()


class Collector:
    """Steps an environment; remembers its observation from one rollout to the next."""

    def __init__(self, env: Any, seed: int) -> None:
        self.env = env
        self.seen, _ = env.reset(seed=seed)
        self.done = 0.0

    @torch.no_grad()
    def collect(self, agent: Agent) -> Rollout:
        """Takes `STEPS` agent steps."""
        observations = torch.zeros(STEPS, len(self.seen))
        actions = torch.zeros(STEPS, 1)
        log_probs = torch.zeros(STEPS)
        rewards = torch.zeros(STEPS)
        going = torch.ones(STEPS + 1)
        for t in range(STEPS):
            observations[t] = clipped(self.seen)
            going[t] = 1.0 - self.done
            distribution = agent.distribution(observations[t])
            actions[t] = distribution.sample()
            log_probs[t] = distribution.log_prob(actions[t]).sum()
            self.seen, rewards[t], terminated, truncated, _ = self.env.step(actions[t].numpy())
            self.done = float(terminated or truncated)
            if self.done:
                self.seen, _ = self.env.reset()
        going[STEPS] = 1.0 - self.done
        values = agent.critic(torch.cat([observations, clipped(self.seen)[None]]))[:, 0]
        advantages = torch.zeros(STEPS + 1)
        for t in reversed(range(STEPS)):
            error = rewards[t] + GAMMA * values[t + 1] * going[t + 1] - values[t]
            advantages[t] = error + GAMMA * LAMBDA * going[t + 1] * advantages[t + 1]
        return Rollout(observations, actions, log_probs, values[:-1], advantages[:-1])


def train(env: Any, seed: int, check: Callable[[int, Act], bool]) -> None:
    """Trains an agent until `check`, of the agent steps and the agent's function, is false."""
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    observing = wrappers.NormalizeObservation(wrappers.ClipAction(env))
    rewarding: Any = wrappers.NormalizeReward(observing, gamma=GAMMA)
    limited: Any = wrappers.TransformReward(rewarding, limit)
    agent = Agent(env.observation_space.shape[0])
    optimiser = torch.optim.Adam(agent.parameters, lr=LEARNING_RATE, eps=1e-5)

    @torch.no_grad()
    def act(observations: np.ndarray) -> np.ndarray:
        rms = observing.obs_rms
        scaled = (observations - rms.mean) / np.sqrt(rms.var + observing.epsilon)
        return agent.actor(clipped(scaled)).numpy()

    collector = Collector(limited, seed)
    step = 0
    while check(step, act):
        # CleanRL's trainings end with the last rate; a longer one keeps it.
        left = max(STEPS / TOTAL_STEPS, 1.0 - step / TOTAL_STEPS)
        optimiser.param_groups[0]["lr"] = LEARNING_RATE * left
        rollout = collector.collect(agent)
        step += STEPS
        for _ in range(EPOCHS):
            for part in rng.permutation(STEPS).reshape(-1, BATCH):
                batch = Rollout(*(each[part] for each in rollout))
                optimiser.zero_grad()
                agent.loss(batch).backward()
                nn.utils.clip_grad_norm_(agent.parameters, LARGEST_GRADIENT)
                optimiser.step()
