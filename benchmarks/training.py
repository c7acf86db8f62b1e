"""Processor time until an agent moves the capsule at 15 cm/s: `python -m benchmarks.training`.

Contenders are the preset of `train.py`, Stable-Baselines3 and SBX (Stable-Baselines3 in JAX) on
`make_vec_env` with their default hyperparameters and `VecNormalize`, as their documentation
advises, and a loop on one environment with the wrappers, network and hyperparameters of CleanRL's
`ppo_continuous_action.py`. All learn by PPO, with direct torque, in the environment of the preset;
evaluations, on its validation plants, do not count. What is not installed is skipped.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import wrappers

from agents.training.presets import PRESETS
from benchmarks.measurement import machine, report
from capsule_gym.command_line import PositiveCount, check_output, command
from capsule_gym.evaluation.candidates import wrap_policy
from capsule_gym.evaluation.episodes import evaluate, scores
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.tasks.task import ENV_ID

COMMAND = "python -m benchmarks.training"
CONFIG = PRESETS["direct", "ppo"]
ID, ENV_KWARGS = f"capsule_gym:{ENV_ID}", CONFIG.env_kwargs()
# Mean speed on validation plants that ends a training, cm/s, and the processor time after which it
# is given up, s.
SPEED, MOST_SECONDS = 15.0, 300.0
# Agent steps between evaluations; environments of Stable-Baselines3 and SBX, whose documentation
# advises several.
EVERY, NUM_ENVS = 32_768, 8


@dataclass
class Clock:
    """Measures the processor time of a training until its policy is fast enough, without
    evaluations.

    Attributes:
        plants: validation plants.
        seconds: processor time so far, s.
        steps: agent steps so far.
        speed: mean speed in the last evaluation, cm/s.
    """

    plants: EvaluationSet
    seconds: float = 0.0
    steps: int = 0
    speed: float = -np.inf
    _began: float = field(default_factory=time.process_time)

    def check(self, steps: int, policy: Callable[[], Any]) -> bool:
        """Evaluates the policy if an evaluation is due; returns whether the training goes on."""
        if steps - self.steps >= EVERY:
            self.seconds += time.process_time() - self._began
            self.steps, self.speed = (
                steps,
                float(scores(evaluate(policy(), self.plants), "mean_speed").mean()),
            )
            self._began = time.process_time()
        return self.speed < SPEED and self.seconds < MOST_SECONDS


def train_model(library: str, seed: int, clock: Clock) -> None:
    """Trains as `train.py`, or with the defaults of a library, Stable-Baselines3 or SBX, and
    `VecNormalize`.
    """
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    from agents.training.algorithms import make_env, make_model
    from agents.training.export import export

    if library:
        env = VecNormalize(make_vec_env(ID, NUM_ENVS, seed, env_kwargs=ENV_KWARGS))
        if library == "sbx":
            from sbx import PPO
        else:
            from stable_baselines3 import PPO
        model: Any = PPO("MlpPolicy", env, seed=seed, device="cpu")
    else:
        env, config = make_env(CONFIG, seed), replace(CONFIG, seed=seed)
        model = make_model(config, env)

    def act(observations: np.ndarray) -> np.ndarray:
        return model.predict(env.normalize_obs(observations), deterministic=True)[0]

    networks = partial(export, "agent", model, CONFIG, "none")
    policy = (
        partial(wrap_policy, act, name="agent", env_kwargs=ENV_KWARGS)
        if library == "sbx"
        else networks
    )
    steps = 10**9 if library else CONFIG.total_steps
    model.learn(steps, callback=lambda *_: clock.check(model.num_timesteps, policy))


def train_loop(seed: int, clock: Clock) -> None:
    """Trains by a loop like CleanRL's `ppo_continuous_action.py`."""
    import torch
    from torch import nn
    from torch.distributions import Normal

    steps, epochs, batch, gamma, decay, clip, total, rate = (
        2048,
        10,
        64,
        0.99,
        0.95,
        0.2,
        1_000_000,
        3e-4,
    )
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    normalised = wrappers.NormalizeObservation(wrappers.ClipAction(gym.make(ID, **ENV_KWARGS)))
    env: Any = wrappers.NormalizeReward(normalised, gamma=gamma)
    env = wrappers.TransformReward(env, lambda reward: max(-10.0, min(10.0, float(reward))))

    def clipped(observation: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.clip(observation, -10.0, 10.0), dtype=torch.float32)

    def network(scale: float) -> nn.Sequential:
        layers = [
            nn.Linear(env.observation_space.shape[0], 64),
            nn.Linear(64, 64),
            nn.Linear(64, 1),
        ]
        for layer, gain in zip(layers, (2.0**0.5, 2.0**0.5, scale), strict=True):
            nn.init.orthogonal_(layer.weight, gain)
            nn.init.zeros_(layer.bias)
        return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])

    actor, critic, log_std = network(0.01), network(1.0), nn.Parameter(torch.zeros(1))
    parameters = [*actor.parameters(), *critic.parameters(), log_std]
    optimiser = torch.optim.Adam(parameters, lr=rate, eps=1e-5)

    @torch.no_grad()
    def act(observations: np.ndarray) -> np.ndarray:
        rms = normalised.obs_rms
        return actor(
            clipped((observations - rms.mean) / np.sqrt(rms.var + normalised.epsilon))
        ).numpy()

    policy = partial(wrap_policy, act, name="agent", env_kwargs=ENV_KWARGS)
    seen, done, step = env.reset(seed=seed)[0], 0.0, 0
    while clock.check(step, policy):
        # CleanRL anneals the rate over its 1,000,000 steps; a longer training keeps the last one.
        optimiser.param_groups[0]["lr"] = rate * max(steps / total, 1.0 - step / total)
        observations, actions = torch.zeros(steps, len(seen)), torch.zeros(steps, 1)
        log_probs, rewards, going = torch.zeros(steps), torch.zeros(steps), torch.ones(steps + 1)
        for t in range(steps):
            observations[t], going[t] = clipped(seen), 1.0 - done
            with torch.no_grad():
                distribution = Normal(actor(observations[t]), log_std.exp())
                actions[t] = distribution.sample()
                log_probs[t] = distribution.log_prob(actions[t]).sum()
            seen, rewards[t], terminated, truncated, _ = env.step(actions[t].numpy())
            done = float(terminated or truncated)
            seen = env.reset()[0] if done else seen
        going[steps], step = 1.0 - done, step + steps
        with torch.no_grad():
            values = critic(torch.cat([observations, clipped(seen)[None]]))[:, 0]
        advantages = torch.zeros(steps + 1)
        for t in reversed(range(steps)):
            error = rewards[t] + gamma * values[t + 1] * going[t + 1] - values[t]
            advantages[t] = error + gamma * decay * going[t + 1] * advantages[t + 1]
        returns = (advantages + values)[:-1]
        for part in np.concatenate(
            [rng.permutation(steps).reshape(-1, batch) for _ in range(epochs)]
        ):
            distribution, value = (
                Normal(actor(observations[part]), log_std.exp()),
                critic(observations[part])[:, 0],
            )
            ratio = (distribution.log_prob(actions[part]).sum(1) - log_probs[part]).exp()
            advantage = (advantages[part] - advantages[part].mean()) / (
                advantages[part].std() + 1e-8
            )
            policy_loss = -torch.min(
                ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage
            ).mean()
            near = values[part] + (value - values[part]).clamp(-clip, clip)
            errors = torch.max((value - returns[part]) ** 2, (near - returns[part]) ** 2)
            optimiser.zero_grad()
            (policy_loss + 0.25 * errors.mean()).backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimiser.step()


CONTENDERS: dict[str, Callable[[int, Clock], None]] = {
    "train.py": partial(train_model, ""),
    "SB3, make_vec_env": partial(train_model, "stable_baselines3"),
    **({"SBX, make_vec_env": partial(train_model, "sbx")} if find_spec("sbx") else {}),
    "CleanRL's loop": train_loop,
}


@command(COMMAND, ValueError)
def main(markdown: Path | None = None, seeds: PositiveCount = 3) -> None:
    """Processor time until an agent moves the capsule at 15 cm/s, for several trainers.

    Examples:
      python -m benchmarks.training --markdown docs/speed_training.md

    Args:
        markdown: Write the table to this file.
        seeds: Training seeds, from 0 on.
    """
    check_output("--markdown", markdown, overwrite=True)
    import torch

    from agents.training.callbacks import validation_plants

    torch.set_num_threads(1)
    rows = [["trainer", *(f"seed {seed}, s" for seed in range(seeds)), "thousands of steps"]]
    for name, train in CONTENDERS.items():
        row, steps = [name], []
        for seed in range(seeds):
            clock = Clock(validation_plants(replace(CONFIG, seed=seed)))
            train(seed, clock)
            reached = clock.speed >= SPEED
            row.append(
                f"{clock.seconds:.0f}"
                if reached
                else f"> {clock.seconds:.0f} ({clock.speed:.1f} cm/s)"
            )
            steps.append(f"{1e-3 * clock.steps:.0f}")
            print(f"{name}, seed {seed}: {row[-1]} s", file=sys.stderr, flush=True)
        rows.append([*row, ", ".join(steps)])
    note = (
        f"Processor time, without evaluations, until the mean speed on validation plants is {SPEED:g} cm/s; > "
        f"where it was not, with the last speed. Direct torque, PPO, one thread of torch. {machine()}."
    )
    report(COMMAND, markdown, rows, note)


if __name__ == "__main__":
    sys.exit(main())
