"""Stable-Baselines3: TQC of sb3-contrib with hindsight experience replay, towards goals."""

import argparse
import math
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from sb3_contrib import TQC  # pip install -e ".[sb3]"
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from capsule_gym.sb3 import CapsuleSB3VecEnv

ENVS = 64
# s; long control intervals: rewards act on earlier actions after fewer updates.
DT = 0.04
# Episodes of 4 s in training, and of 15 s in the evaluation.
STEPS = round(4.0 / DT)
EVALUATED_STEPS = round(15.0 / DT)
OPTIONS: dict[str, Any] = {"task": "goal", "goal_env": True, "control_dt": DT}
# Standard deviation of the noise on the actions, and the time over which it is correlated, s.
NOISE = 0.25
NOISE_TIME = 0.25
# Factors of theta, theta_dot, x_dot, stick and the last action.
FACTORS = [2.0, 0.25, 6.0, 1.0, 1.0]
# Whether a mirror changes their signs.
ODD = [True, True, True, False, True]


class GoalsAhead(VecEnvWrapper):
    """Mirrors the episodes with a goal behind the capsule, since the task is symmetric."""

    def mirror(self, observations: Any, signs: np.ndarray) -> dict[str, np.ndarray]:
        """The observations seen in a mirror where the sign is -1."""
        goals = ("achieved_goal", "desired_goal")
        mirrored = {name: observations[name] * signs for name in goals}
        mirrored["observation"] = observations["observation"] * np.where(ODD, signs, 1.0)
        return mirrored

    def mirror_by_goals(self, observations: Any) -> dict[str, np.ndarray]:
        """Mirrors observations by the signs of their goals, which may be those of new episodes."""
        self.signs = np.sign(observations["desired_goal"][:, :1])
        return self.mirror(observations, self.signs)

    def reset(self) -> VecEnvObs:
        """Begins new episodes."""
        return self.mirror_by_goals(self.venv.reset())

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions of the next step."""
        self.venv.step_async(actions * self.signs)

    def step_wait(self) -> VecEnvStepReturn:
        """Steps; returns mirrored observations, rewards, dones and infos."""
        observations, rewards, dones, infos = self.venv.step_wait()
        # The last observation of an episode has the sign of its own goal, not of the next one.
        for i in np.flatnonzero(dones):
            last = infos[i]["terminal_observation"]
            infos[i]["terminal_observation"] = self.mirror(last, self.signs[i])
        return self.mirror_by_goals(observations), rewards, dones, infos


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
        scaled = observations["observation"] * self.factors
        return torch.cat([scaled, torch.tanh(error / self.scales)], dim=1)


def evaluate(model: TQC) -> str:
    """The distances from the goal at the end of 64 episodes, and the share of failures."""
    # These seeds are far from those of training.
    env = GoalsAhead(CapsuleSB3VecEnv(64, 1_000_000, max_episode_steps=EVALUATED_STEPS, **OPTIONS))
    observations: Any = env.reset()
    ends: dict[Any, Any] = {}
    while len(ends) < env.num_envs:
        actions, _ = model.predict(observations, deterministic=True)
        observations, _, dones, infos = env.step(actions)
        ends = {i: infos[i] for i in np.flatnonzero(dones)} | ends
    last = [end["terminal_observation"] for end in ends.values()]
    goals = np.array([each["desired_goal"][0] for each in last])
    errors = 100.0 * np.abs(goals - [each["achieved_goal"][0] for each in last])
    failed = np.mean([not end["TimeLimit.truncated"] for end in ends.values()])
    distances = f"median {np.median(errors):.1f} cm, mean {errors.mean():.1f} cm"
    return f"distance from the goal: {distances}; {failed:.0%} failed"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=80_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    # Short episodes from many angles and rates contain the fast swings that move the platform.
    batch = CapsuleSB3VecEnv(
        ENVS, args.seed, initial_range=(1.047, 8.0), max_episode_steps=STEPS, **OPTIONS
    )
    sigma = np.full(1, NOISE * math.sqrt(2.0 / NOISE_TIME))
    noise = OrnsteinUhlenbeckActionNoise(np.zeros(1), sigma, theta=1.0 / NOISE_TIME, dt=DT)
    network = {"net_arch": [64, 64], "n_quantiles": 10, "features_extractor_class": Features}
    model = TQC(
        "MultiInputPolicy",
        GoalsAhead(batch),
        replay_buffer_class=HerReplayBuffer,
        # The terms of the reward for energy and termination do not depend on the goal; they are in
        # the infos.
        replay_buffer_kwargs={"copy_info_dict": True},
        policy_kwargs=network,
        top_quantiles_to_drop_per_net=1,
        action_noise=noise,
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
    model.learn(args.steps)
    print("after:", evaluate(model))
