"""Whole episodes that the module replays: `python -m web.episodes` compares Python's with the
committed ones.

Every driver has an episode, on a plant of the frozen set `drift`, whose M and mu jump twice, or of
its task's set. Some have another one on a disturbed plant of the set `real`, or with `actions`,
each held for several steps, since the platform would not move otherwise. The hash covers, after
every step, the observation and what `info` shows.

The tables of the optimum's policies are many times as large as the module, but their torques take
few bytes. The module therefore contains recordings: for each of its plants, the index in `TORQUES`
of each action. It replays the actions in its own step.
"""

import hashlib
import json
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import capsule_gym
from baselines.dynamic_programming.policy import TORQUES
from baselines.policies import ALL_SCRIPTED
from capsule_gym.command_line import command
from capsule_gym.core.layout import Row
from capsule_gym.evaluation.sets import SET_NAMES, PlantSpec, load_set
from capsule_gym.files import replacing, write_atomically
from capsule_gym.policies.policy import policy_names
from capsule_gym.tasks.task import EPISODE_STEPS

# Number of plants of each frozen set in the module; their seeds are 0, 1, ..
SEEDS = 100
# Policies that the browser runs from recorded actions, on these plants only.
RECORDED = ("dp-nominal", "dp-oracle")
# Policies that the browser does not have.
LEFT_OUT = ("lqr", "mpc")
FILE = Path(__file__).with_name("episodes.json")
RECORDINGS = Path(__file__).with_name("recordings.npz")
# Fills a recording after the last action of an episode.
OVER = 255


@cache
def drivers() -> dict[str, Any]:
    """The policies in the browser by name, scripted and trained; of a trained one the run with the
    lowest seed.
    """
    trained = map(capsule_gym.load_policy, policy_names())
    # Policies of other tasks come last.
    scripted = {name: policy for name, policy in ALL_SCRIPTED.items() if name not in LEFT_OUT}
    return scripted | {
        each.name: each for each in sorted(trained, key=lambda policy: "task" in policy.env_kwargs)
    }


def compute(episode: dict[str, Any]) -> dict[str, Any]:
    """Runs an episode in Python's environment; returns it with the number of steps and the hash."""
    policy, found = drivers()[episode["driver"]], load_set(episode["set"])
    plant, kwargs = found.plants[episode["plant"]], {**policy.env_kwargs, **found.env_kwargs}
    env = capsule_gym.CapsuleEnv(**kwargs)
    observation, _ = env.reset(seed=plant.seed, options=plant.reset_options())
    layout = env.simulation.layout
    # The rows that `info` shows, the memories of law and task, and a varied plant's last reading.
    rows = [*range(Row.clock + 1), *range(layout.law_memory, layout.task_end)]
    if env.simulation.settings.varied:
        rows += range(Row.read_theta, Row.read_x_dot + 1)
    act = policy.start([plant.seed])
    digest, terminated, step = hashlib.sha256(), False, 0
    while not terminated and step < layout.steps:
        if "actions" in episode:
            action = np.array(
                [episode["actions"][step // episode["hold"] % len(episode["actions"])]], np.float32
            )
        else:
            action = act(observation[None])[0]
        observation, _, terminated, _, _ = env.step(action)
        digest.update(env.simulation.world[0, rows, 0].tobytes() + observation.tobytes())
        step += 1
    return {**episode, "steps": step, "sha256": digest.hexdigest()}


def record_actions(name: str, plants: Sequence[PlantSpec]) -> np.ndarray:
    """Records the actions of one of `RECORDED` on plants, as indices in `TORQUES`.

    Returns:
        Shape (plants, `EPISODE_STEPS`), uint8; `OVER` after the end of an episode.
    """
    policy = ALL_SCRIPTED[name]
    env = capsule_gym.CapsuleVectorEnv(len(plants), autoreset_mode="DISABLED", **policy.env_kwargs)
    options = [plant.reset_options() for plant in plants]
    observations, _ = env.reset(
        options={key: [each[key] for each in options] for key in options[0]}
    )
    act, running = policy.start([plant.seed for plant in plants]), np.ones(len(plants), bool)
    places = np.full((len(plants), EPISODE_STEPS), OVER, np.uint8)
    for step in range(EPISODE_STEPS):
        actions = act(observations)
        places[running, step] = np.searchsorted(TORQUES, actions[running, 0])
        observations, _, terminated, _, _ = env.step(actions)
        running &= ~terminated
    return places


@command("python -m web.episodes")
def main(write: bool = False) -> int:
    """Computes the episodes of the live page and the optimum's actions; the exit status is 1 if
    they differ.

    Examples:
      python -m web.episodes --write

    Args:
        write: Write them to web/episodes.json and web/recordings.npz.
    """
    committed = json.loads(FILE.read_text(encoding="utf-8"))
    for n, (name, policy) in enumerate(drivers().items()):
        if all(episode["driver"] != name for episode in committed):
            found_set = policy.env_kwargs.get("task", "drift")
            committed.append({"name": name, "driver": name, "set": found_set, "plant": n})
    found = [compute(episode) for episode in committed]
    pairs = [(name, load_set(each)) for name in RECORDED for each in SET_NAMES]
    recorded = {
        f"{name} {each.name}": record_actions(name, each.plants[:SEEDS]) for name, each in pairs
    }
    if write:
        write_atomically(
            FILE, "[\n" + ",\n".join(json.dumps(episode) for episode in found) + "\n]\n"
        )
        with replacing(RECORDINGS) as temporary:
            np.savez_compressed(temporary, allow_pickle=False, **recorded)
        committed = found
    saved = np.load(RECORDINGS)
    wrong = [f"{episode['name']}: differs" for episode in found if episode not in committed]
    wrong += [
        f"{key}: differs"
        for key, taken in recorded.items()
        if not np.array_equal(taken, saved[key])
    ]
    print(*wrong, f"{len(found) + len(recorded)} compared, {len(wrong)} differ", sep="\n")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
