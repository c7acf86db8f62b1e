"""Whole episodes that the module replays: `python -m web.episodes` compares Python's with the committed ones.

Every driver has one episode, on a plant of the frozen set `drift`, whose M and mu jump twice, or of its task's set.
Each driver in `DISTURBED` has another one on a disturbed plant of the set `real`. Each driver in `SCALES` has two more
with random torques that are held for several steps. The hash of an episode covers the bytes of all steps: each quantity
of the environment, the law's memory, its line of the reference, the task's memory and the history, float64, and then
the observation, float32.

The tables of the optimum's policies are many times as large as the module, but their torques take few bytes. The module
therefore contains recordings: for each of its plants, the index in `TORQUES` of each action. It replays the actions in
its own step.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import capsule_gym
from baselines.policies import ALL_SCRIPTED, Act
from capsule_gym.command_line import parse
from capsule_gym.evaluation_sets import SET_NAMES, EvaluationSet, PlantSpec, load_set
from capsule_gym.files import write_atomically
from capsule_gym.policy import policy_names
from capsule_gym.task import CONTROL_DT, EPISODE_STEPS, TASKS

# Number of plants of each frozen set in the module; their seeds are 0, 1, ..
SEEDS = 100
# Policies that the browser runs from recorded actions, on these plants only.
RECORDED = ("dp-nominal", "dp-oracle")
FILE = Path(__file__).with_name("episodes.json")
RECORDINGS = Path(__file__).with_name("recordings.npz")
# Fills a recording after the last action of an episode.
OVER = 255
# Number of random actions, and steps for which each is held; otherwise the platform would not move.
ACTIONS, HOLD = 97, 5
# Scale of random actions by driver.
SCALES = {"zero": 0.15, "adaptive": 0.05, "gait-identifying": 0.05}
DISTURBED = ("zero", "gait-predictive", "adaptive-predictive")

Episode = dict[str, Any]


def is_trained(name: str) -> bool:
    """Whether a policy of the browser is trained."""
    return name in policy_names()


def controller_names() -> list[str]:
    """The policies that run in the browser; a trained policy is the run with the lowest seed."""
    # Policies of other tasks come last, so that they do not change the plants of the others.
    return [*ALL_SCRIPTED, *sorted(policy_names(), key=lambda name: "task" in env_kwargs(name))]


def env_kwargs(name: str) -> dict[str, Any]:
    """The arguments of a driver's environment."""
    return capsule_gym.load_policy(name).env_kwargs if is_trained(name) else ALL_SCRIPTED[name].env_kwargs


def episodes() -> Iterator[Episode]:
    """Yields the definitions of the episodes: driver, plant, and random actions if any."""

    def held(seed: int, scale: float) -> Episode:
        actions = np.random.default_rng(seed).uniform(-scale, scale, ACTIONS).round(4).tolist()
        return {"actions": actions, "hold": HOLD}

    for n, name in enumerate(controller_names()):
        task = env_kwargs(name).get("task", "speed")
        yield {"name": name, "driver": name, "set": "drift" if task == "speed" else task, "plant": n}
    for n, (name, scale) in enumerate(SCALES.items()):
        for i in (2 * n, 2 * n + 1):
            words = f"held torques on {name}, {i % 2 + 1}"
            yield {"name": words, "driver": name, "set": "wide", "plant": i, **held(i, scale)}
    for n, name in enumerate(DISTURBED):
        torques = held(n, SCALES[name]) if name in SCALES else {}
        yield {"name": f"{name}, disturbed", "driver": name, "set": "real", "plant": n, **torques}


def compute(episode: Episode) -> tuple[int, str]:
    """Runs an episode in Python's environment; returns the number of steps and the hash."""
    name, found = episode["driver"], load_set(episode["set"])
    plant, kwargs = found.plants[episode["plant"]], {**env_kwargs(name), **found.env_kwargs}
    env = capsule_gym.CapsuleEnv(**kwargs)
    observation, _ = env.reset(seed=plant.seed, options=plant.reset_options())
    act = (capsule_gym.load_policy(name) if is_trained(name) else ALL_SCRIPTED[name]).start([plant.seed])
    digest, terminated, step = hashlib.sha256(), False, 0
    horizon = TASKS[found.task][1] * CONTROL_DT
    while not terminated and step < round(horizon / kwargs.get("control_dt", CONTROL_DT)):
        if "actions" in episode:
            action = np.array([episode["actions"][step // episode["hold"] % len(episode["actions"])]], np.float32)
        else:
            action = act(observation[None])[0]
        observation, _, terminated, _, _ = env.step(action)
        digest.update(env.simulation.world[0, :, 0].tobytes() + observation.tobytes())
        step += 1
    env.close()
    return step, digest.hexdigest()


def record(name: str, plants: Sequence[PlantSpec]) -> np.ndarray:
    """Records the actions of one of `RECORDED` on plants, as indices in `TORQUES`.

    Returns:
        Shape (plants, `EPISODE_STEPS`), uint8; `OVER` after the end of an episode.
    """
    # Imported here, since numba takes most of a second to import.
    from agents.evaluation.episodes import evaluate
    from baselines.dynamic_programming.policy import TORQUES

    policy, taken = ALL_SCRIPTED[name], []

    def start(seeds: Sequence[int]) -> Act:
        act = policy.start(seeds)

        def noted(observations: np.ndarray) -> np.ndarray:
            actions = act(observations)
            taken.append(actions[:, 0])
            return actions

        return noted

    episodes = evaluate(replace(policy, start=start), EvaluationSet(name, tuple(plants)))
    places = np.full((len(plants), EPISODE_STEPS), OVER, np.uint8)
    for row, actions, episode in zip(places, np.array(taken).T, episodes, strict=True):
        # Rounded up, since an episode may end within its last step.
        steps = math.ceil(episode["duration"] / CONTROL_DT - 1e-6)
        row[:steps] = np.searchsorted(TORQUES, actions[:steps])
    return places


def known_recordings() -> dict[str, dict[str, np.ndarray]]:
    """Reads the committed recordings, by policy and set, in the format of `record`."""
    with np.load(RECORDINGS) as file:
        return {name: {each: file[f"{name} {each}"] for each in SET_NAMES} for name in RECORDED}


@dataclass(frozen=True)
class Args:
    """Computes the episodes of the live page and the optimum's actions; the exit status is 1 if they differ.

    Examples:
      python -m web.episodes
      python -m web.episodes --write
    """

    write: bool = False
    """Write them to web/episodes.json and web/recordings.npz."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, "python -m web.episodes", arguments)
    found = []
    for episode in episodes():
        steps, digest = compute(episode)
        found.append({**episode, "steps": steps, "sha256": digest})
    recorded: dict[str, Any] = {}
    for name in RECORDED:
        for each in SET_NAMES:
            print(f"{name} on {each} ..", file=sys.stderr, flush=True)
            recorded[f"{name} {each}"] = record(name, load_set(each).plants[:SEEDS])
    if args.write:
        write_atomically(FILE, "[\n" + ",\n".join(json.dumps(episode) for episode in found) + "\n]\n")
        content = io.BytesIO()
        np.savez_compressed(content, **recorded)
        write_atomically(RECORDINGS, content.getvalue())
    committed = json.loads(FILE.read_text(encoding="utf-8"))
    wrong = [f"{episode['name']}: differs from {FILE.name}" for episode in found if episode not in committed]
    with np.load(RECORDINGS) as known:
        differing = [key for key, places in recorded.items() if not np.array_equal(places, known[key])]
    wrong += [f"{key}: differs from {RECORDINGS.name}" for key in differing]
    print(*wrong, f"{len(found)} episodes and {len(recorded)} recordings, {len(wrong)} differ", sep="\n")
    return int(bool(wrong or len(found) != len(committed)))


if __name__ == "__main__":
    sys.exit(main())
