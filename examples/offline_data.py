"""Minari: offline data of four qualities, recorded on the native batch.

MINARI_DATASETS_PATH=runs/data python examples/offline_data.py --steps 1e6
"""

import argparse
from collections.abc import Callable, Iterator

import gymnasium as gym
import minari  # pip install -e ".[minari]"
import numpy as np
from minari.data_collector import EpisodeBuffer

import capsule_gym

ID = "capsule_gym:CapsuleStickSlip-v0"
BATCH = 200
DESCRIPTIONS = {
    "random": "Uniform random torque; every episode fails.",
    "medium": "The policy efficient with Gaussian noise of standard deviation 0.3 on its action.",
    "expert": "The policy direct-ppo.",
    "mixed": "Equal parts of random, medium and expert.",
}
Act = Callable[[np.ndarray], np.ndarray]


def actor(quality: str) -> Act:
    """A policy for a batch: maps observations of shape (n, entries) to actions of shape (n, 1)."""
    rng = np.random.default_rng(0)

    def random(observations: np.ndarray) -> np.ndarray:
        return rng.uniform(-1.0, 1.0, (len(observations), 1)).astype(np.float32)

    if quality == "random":
        return random
    policy = capsule_gym.load_policy("efficient" if quality == "medium" else "direct-ppo")
    deviation = 0.3 if quality == "medium" else 0.0

    def act(observations: np.ndarray) -> np.ndarray:
        noise = rng.standard_normal((len(observations), 1))
        actions = policy(observations) + deviation * noise
        return np.clip(actions, -1.0, 1.0).astype(np.float32)

    return act


def episodes(act: Act, first_seed: int) -> Iterator[EpisodeBuffer]:
    """Yields complete episodes endlessly, with seeds from `first_seed` on."""
    env = gym.make_vec(ID, num_envs=BATCH)
    while True:
        observation, _ = env.reset(seed=first_seed)
        columns: list[tuple[np.ndarray, ...]] = []
        seen = [observation]
        length = np.zeros(BATCH, int)
        while not length.all():
            action = act(observation)
            observation, reward, terminated, truncated, _ = env.step(action)
            seen.append(observation)
            columns.append((action, reward, terminated, truncated))
            ended = terminated | truncated
            length[ended & (length == 0)] = len(columns)
        observations = np.stack(seen)
        fields = [np.stack(column) for column in zip(*columns, strict=True)]
        for i, steps in enumerate(length):
            own = [field[:steps, i] for field in fields]
            yield EpisodeBuffer(None, first_seed + i, None, observations[: steps + 1, i], *own)
        first_seed += BATCH


def write_dataset(quality: str, steps: float) -> None:
    """Writes one dataset of at least `steps` steps in Minari's folder."""
    mixed = quality == "mixed"
    parts = ("random", "medium", "expert") if mixed else (quality,)
    # The mixed dataset has other episodes than the three datasets.
    first_seed = 1_000_000 if mixed else 0
    buffers = []
    for part in parts:
        recorded = 0
        for buffer in episodes(actor(part), first_seed):
            buffers.append(buffer)
            recorded += len(buffer.rewards)
            if recorded * len(parts) >= steps:
                break
    dataset = minari.create_dataset_from_buffers(
        f"capsule/{quality}-v0",
        buffers,
        env=gym.make(ID),
        algorithm_name=quality,
        author="The capsule_gym authors",
        description=DESCRIPTIONS[quality],
        requirements=["capsule-gym"],
    )
    score = np.mean([buffer.rewards.sum() for buffer in buffers])
    size = f"{dataset.total_episodes} episodes, {dataset.total_steps} steps"
    print(f"{quality}: {size}, mean return {score:.1f} cm")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=float, default=1e6, help="of each dataset")
    args = parser.parse_args()
    for quality in DESCRIPTIONS:
        write_dataset(quality, args.steps)
