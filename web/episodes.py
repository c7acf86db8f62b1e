"""Whole episodes that the module replays: `python -m web.episodes` compares them with Python's.

Every driver has an episode, on a plant of the frozen set `drift`, whose M and mu jump twice, or of
its task's set. Some have another one on a disturbed plant of the set `real`, or with `actions`,
each held for several steps, since the platform would not move otherwise. The hash covers, after
every step, the observation and what `info` shows.

The tables of `dp-oracle` are many times as large as the module, but its torques take few bytes. The
module therefore contains recordings: for each of its plants, the index in `TORQUES` of each action.
It replays the actions in its own step.
"""

import hashlib
import itertools
import json
import sys
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import capsule_gym
from baselines.dynamic_programming.policy import TORQUES
from baselines.policies import ALL_SCRIPTED
from capsule_gym.command_line import command
from capsule_gym.core.layout import Row
from capsule_gym.evaluation.sets import SET_NAMES, PlantSpec, batch_options, load_set
from capsule_gym.files import replacing, write_atomically
from capsule_gym.policies.loading import policy_names
from capsule_gym.tasks.task import EPISODE_STEPS

# Number of plants of each frozen set in the module; their seeds are 0, 1, ..
SEEDS = 100
# Policies that the browser runs from recorded actions, on these plants only.
RECORDED = ("dp-oracle",)
FILE = Path(__file__).with_name("episodes.json")
RECORDINGS = Path(__file__).with_name("recordings.npz")
# Fills a recording after the last action of an episode.
OVER = 255


@cache
def drivers() -> dict[str, Any]:
    """The policies in the browser by name; of a trained one the run with the lowest seed."""
    found: dict[str, Any] = dict(ALL_SCRIPTED)
    trained = [capsule_gym.load_policy(name) for name in policy_names()]
    # Policies of other tasks come last.
    trained.sort(key=lambda policy: "task" in policy.env_kwargs)
    for policy in trained:
        found[policy.name] = policy
    return found


def compute(episode: dict[str, Any]) -> dict[str, Any]:
    """Runs an episode in Python's environment; returns it with the number of steps and the hash."""
    policy = drivers()[episode["driver"]]
    found = load_set(episode["set"])
    plant = found.plants[episode["plant"]]
    env = capsule_gym.CapsuleEnv(**{**policy.env_kwargs, **found.env_kwargs})
    observation, _ = env.reset(seed=plant.seed, options=plant.reset_options())
    if "actions" in episode:
        act = repeated(episode["actions"], episode["hold"])
    else:
        act = policy.start([plant.seed])
    rows = compared_rows(env)
    digest = hashlib.sha256()
    steps = 0
    terminated = False
    while not terminated and steps < env.simulation.layout.steps:
        actions = act(observation[None])
        observation, _, terminated, _, _ = env.step(actions[0])
        digest.update(env.simulation.world[0, rows, 0].tobytes())
        digest.update(observation.tobytes())
        steps += 1
    return {**episode, "steps": steps, "sha256": digest.hexdigest()}


def repeated(actions: Sequence[float], hold: int) -> Callable[[np.ndarray], np.ndarray]:
    """A policy that takes these actions in turn, each for `hold` steps."""
    held = itertools.cycle(np.repeat(np.array(actions, np.float32), hold))
    return lambda observations: np.array([[next(held)]])


def compared_rows(env: capsule_gym.CapsuleEnv) -> list[int]:
    """The rows that `info` shows, the memories of law and task, a varied plant's last reading."""
    layout = env.simulation.layout
    rows = [*range(Row.clock + 1), *range(layout.law_memory, layout.task_end)]
    if env.simulation.settings.varied:
        rows += range(Row.read_theta, Row.read_x_dot + 1)
    return rows


def record_actions(name: str, plants: Sequence[PlantSpec]) -> np.ndarray:
    """Records the actions of one of `RECORDED` on plants, as indices in `TORQUES`.

    Returns:
        Shape (plants, `EPISODE_STEPS`), uint8; `OVER` after the end of an episode.
    """
    policy = ALL_SCRIPTED[name]
    count = len(plants)
    env = capsule_gym.CapsuleVectorEnv(count, autoreset_mode="DISABLED", **policy.env_kwargs)
    observations, _ = env.reset(options=batch_options(plants))
    act = policy.start([plant.seed for plant in plants])
    running = np.ones(count, bool)
    recorded = np.full((count, EPISODE_STEPS), OVER, np.uint8)
    for step in range(EPISODE_STEPS):
        actions = act(observations)
        recorded[running, step] = np.searchsorted(TORQUES, actions[running, 0])
        observations, _, terminated, _, _ = env.step(actions)
        running &= ~terminated
    return recorded


def record_all() -> dict[str, np.ndarray]:
    """The recordings of the module by policy and set."""
    recorded = {}
    for name, set_name in itertools.product(RECORDED, SET_NAMES):
        plants = load_set(set_name).plants[:SEEDS]
        recorded[f"{name} {set_name}"] = record_actions(name, plants)
    return recorded


def committed_episodes() -> list[dict[str, Any]]:
    """The episodes with their numbers of steps and hashes."""
    return json.loads(FILE.read_text("utf-8"))


def planned_episodes() -> list[dict[str, Any]]:
    """The committed episodes, and one of each driver that has none."""
    planned = committed_episodes()
    driven = {episode["driver"] for episode in planned}
    for plant, (name, policy) in enumerate(drivers().items()):
        if name not in driven:
            set_name = policy.env_kwargs.get("task", "drift")
            planned.append({"name": name, "driver": name, "set": set_name, "plant": plant})
    return planned


def write_files(episodes: Sequence[dict[str, Any]], recorded: dict[str, np.ndarray]) -> None:
    """Writes the episodes, one on a line, and the recordings."""
    lines = ",\n".join(json.dumps(episode) for episode in episodes)
    write_atomically(FILE, f"[\n{lines}\n]\n")
    with replacing(RECORDINGS) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **recorded)


@command("python -m web.episodes")
def main(write: bool = False) -> int:
    """Computes the episodes and the optimum's actions; the exit status is 1 if they differ.

    Examples:
      python -m web.episodes --write

    Args:
        write: Write them to web/episodes.json and web/recordings.npz.
    """
    episodes = [compute(episode) for episode in planned_episodes()]
    recorded = record_all()
    if write:
        write_files(episodes, recorded)
    committed = committed_episodes()
    saved = np.load(RECORDINGS)
    differing = [episode["name"] for episode in episodes if episode not in committed]
    for name, actions in recorded.items():
        if not np.array_equal(actions, saved[name]):
            differing.append(name)
    for name in differing:
        print(f"{name}: differs")
    compared = len(episodes) + len(recorded)
    print(f"{compared} compared, {len(differing)} differ")
    return int(bool(differing))


if __name__ == "__main__":
    sys.exit(main())
