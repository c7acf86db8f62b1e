"""Minari: whole episodes of the paper's law and of the best agent, with all infos."""

import argparse
from collections.abc import Callable

import gymnasium as gym
import minari
import numpy as np

import capsule_gym

ID = "capsule_gym:CapsuleStickSlip-v0"
ABOUT = {"author": "The capsule_gym authors", "description": "Episodes of 33 s (docs/works_with.md)"}


def record(name: str, episodes: int, act: Callable[[np.ndarray], np.ndarray], env_kwargs: dict) -> None:
    """Records one dataset, of the seeds 0, 1, .."""
    env = minari.DataCollector(gym.make(ID, **env_kwargs), record_infos=True)
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        ended = False
        while not ended:
            observation, _, terminated, truncated, _ = env.step(act(observation))
            ended = terminated or truncated
    env.create_dataset(f"capsule/{name}-v0", algorithm_name=name, requirements=["capsule-gym"], **ABOUT)


def main() -> None:
    """Records both datasets where Minari keeps its own: MINARI_DATASETS_PATH says where."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=5)
    episodes = parser.parse_args().episodes
    agent = capsule_gym.load_policy("residual-on-gait")
    record("residual-on-gait", episodes, agent, agent.env_kwargs)
    record("adaptive", episodes, lambda observation: np.zeros(1, np.float32), {"controller": "baselines:adaptive"})


if __name__ == "__main__":
    main()
