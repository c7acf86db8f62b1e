"""Stable-Baselines3: TQC of sb3-contrib with hindsight experience replay, towards goals."""

import argparse
import math
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from sb3_contrib import TQC
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from capsule_gym.sb3 import CapsuleSB3VecEnv

# Long control intervals: rewards act on earlier actions after fewer updates. Episodes of 4 s, evaluated for 15 s.
ENVS, DT = 64, 0.04
STEPS, EVALUATED_STEPS = round(4.0 / DT), round(15.0 / DT)
OPTIONS: dict[str, Any] = {"goal_env": True, "control_dt": DT}
# Standard deviation of the noise on the actions, and the time over which it is correlated, s.
NOISE, NOISE_TIME = 0.25, 0.25
# Factors of theta, theta_dot, x_dot, stick and the last action, and whether a mirror changes their signs.
FACTORS, ODD = [2.0, 0.25, 6.0, 1.0, 1.0], [1, 1, 1, 0, 1]


def mirror(observations: dict[str, np.ndarray], signs: np.ndarray) -> dict[str, np.ndarray]:
    """The observations seen in a mirror where the sign is -1."""
    return {name: part * signs ** (ODD if name == "observation" else 1) for name, part in observations.items()}


class GoalsAhead(VecEnvWrapper):
    """Mirrors the episodes with a goal behind the capsule, since the task is symmetric."""

    def reset(self) -> VecEnvObs:
        """Begins new episodes."""
        observations: Any = self.venv.reset()
        self.signs = np.sign(observations["desired_goal"][:, :1])
        return mirror(observations, self.signs)

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions of the next step."""
        self.venv.step_async(actions * self.signs)

    def step_wait(self) -> VecEnvStepReturn:
        """Steps."""
        observations: Any
        observations, rewards, dones, infos = self.venv.step_wait()
        for i in np.flatnonzero(dones):
            infos[i]["terminal_observation"] = mirror(infos[i]["terminal_observation"], self.signs[i])
        self.signs = np.sign(observations["desired_goal"][:, :1])
        return mirror(observations, self.signs), rewards, dones, infos


class Features(BaseFeaturesExtractor):
    """The observation, scaled, and the distance from the goal at three scales."""

    factors: torch.Tensor
    scales: torch.Tensor

    def __init__(self, space: gym.spaces.Dict) -> None:
        super().__init__(space, len(FACTORS) + 3)
        self.register_buffer("factors", torch.tensor(FACTORS))
        self.register_buffer("scales", torch.tensor([0.2, 0.03, 0.005]))

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features of shape (n, entries)."""
        error = (observations["desired_goal"] - observations["achieved_goal"])[:, :1]
        return torch.cat([observations["observation"] * self.factors, torch.tanh(error / self.scales)], dim=1)


def evaluate(model: TQC) -> str:
    """The distances from the goal at the end of 64 episodes without exploration, and the share of failures."""
    options = {**OPTIONS, "autoreset_mode": "DISABLED", "max_episode_steps": EVALUATED_STEPS}
    envs = gym.make_vec("capsule_gym:CapsuleGoal-v0", num_envs=64, **options)
    # These seeds are far from those of training.
    observations, _ = envs.reset(seed=1_000_000)
    signs = np.sign(observations["desired_goal"][:, :1])
    terminated = truncated = np.zeros(64, bool)
    while not (terminated | truncated).all():
        actions, _ = model.predict(mirror(observations, signs), deterministic=True)
        observations, _, terminated, truncated, info = envs.step(actions * signs)
    errors = 100.0 * np.abs(info["error"])
    distances = f"median {np.median(errors):.1f} cm, mean {errors.mean():.1f} cm"
    return f"distance from the goal: {distances}; {terminated.mean():.0%} failed"


class Evaluation(BaseCallback):
    """Prints an evaluation every 20,000 steps."""

    def _on_step(self) -> bool:
        if self.num_timesteps % 20_000 < ENVS:
            assert isinstance(self.model, TQC)
            print(f"{self.num_timesteps:9,} steps: {evaluate(self.model)}", flush=True)
        return True


def main() -> None:
    """Trains and evaluates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=80_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    # Short episodes from many angles and rates contain the fast swings that move the platform.
    batch = CapsuleSB3VecEnv(
        ENVS, args.seed, task="goal", initial_range=(1.047, 8.0), max_episode_steps=STEPS, **OPTIONS
    )
    env = GoalsAhead(batch)
    sigma = np.full(1, NOISE * math.sqrt(2.0 / NOISE_TIME))
    model = TQC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        # The terms of the reward for energy and termination do not depend on the goal; they are in the infos.
        replay_buffer_kwargs={"copy_info_dict": True},
        policy_kwargs={"net_arch": [64, 64], "n_quantiles": 10, "features_extractor_class": Features},
        top_quantiles_to_drop_per_net=1,
        action_noise=OrnsteinUhlenbeckActionNoise(np.zeros(1), sigma, theta=1.0 / NOISE_TIME, dt=DT),
        buffer_size=200_000,
        # Hindsight needs whole episodes.
        learning_starts=ENVS * (STEPS + 1),
        gradient_steps=8,
        learning_rate=lambda left: 1e-3 * left,
        gamma=0.98,
        tau=0.02,
        # The rewards of a step are small, at most 0.2.
        ent_coef="auto_0.005",
        target_entropy=-3.0,
        seed=args.seed,
        device="cpu",
    )
    print("before:", evaluate(model))
    model.learn(args.steps, callback=Evaluation())
    print("after:", evaluate(model))


if __name__ == "__main__":
    main()
