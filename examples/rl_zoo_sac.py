"""RL Baselines3 Zoo: SAC, with the preset "direct sac" of agents/training/presets.py."""

import math
from typing import Any

import numpy as np
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise

# Factors of theta, theta_dot, x_dot, stick and the last action, and the bounds of the observation space.
SCALE = np.array([2.0, 0.25, 6.0, 1.0, 1.0], np.float32)
LOW, HIGH = np.array([[-np.pi / 2.0, -20.0, -2.0, 0.0, -1.0], [np.pi / 2.0, 20.0, 2.0, 1.0, 1.0]], np.float32)
# Standard deviation of the noise on the actions, its correlation time and the agent's step, s.
ACTION_NOISE, NOISE_TIME, CONTROL_DT = 0.25, 0.25, 0.02

hyperparams: dict[str, dict[str, Any]] = {
    "CapsuleStickSlip-v0": {
        # Training starts anywhere, in episodes of 4 s.
        "env_kwargs": {"initial_range": [1.047, 8.0], "max_episode_steps": 200, "termination_penalty": 10.0},
        "env_wrapper": [{"gymnasium.wrappers.RescaleObservation": {"min_obs": SCALE * LOW, "max_obs": SCALE * HIGH}}],
        "n_envs": 32,
        "n_timesteps": 500_000,
        "policy": "MlpPolicy",
        "policy_kwargs": "dict(net_arch=[64, 64])",
        # The Zoo's schedule decreases the learning rate to 0.
        "learning_rate": "lin_1e-3",
        "batch_size": 256,
        "buffer_size": 400_000,
        "learning_starts": 2000,
        "gradient_steps": 8,
        "n_steps": 3,
        "gamma": 0.995,
        "tau": 0.005,
        "target_entropy": -3.0,
        "action_noise": OrnsteinUhlenbeckActionNoise(
            np.zeros(1), np.full(1, ACTION_NOISE * math.sqrt(2.0 / NOISE_TIME)), theta=1.0 / NOISE_TIME, dt=CONTROL_DT
        ),
    }
}
