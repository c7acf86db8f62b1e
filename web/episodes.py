"""Whole episodes by hash, which the module replays: `python -m web.episodes` compares Python's with the committed ones.

Every driver has one, on a plant of the frozen set `drift`, whose M and mu jump twice; random torques that each hold for
a while have two each, without a law and with one. A hash is over the bytes of all steps: each quantity of the
environment, the law's memory and its line of the reference, float64, and then the observation, float32.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import capsule_gym
from baselines.policies import SCRIPTED
from capsule_gym.command_line import parse
from capsule_gym.evaluation_sets import PlantSpec, load_set
from capsule_gym.files import write_atomically
from capsule_gym.task import CONTROL_DT, HORIZON
from web.controllers import controller_names, is_trained

FILE = Path(__file__).with_name("episodes.json")
# Random actions and for how many steps each holds, or nothing would move.
ACTIONS, HOLD = 97, 5
# The scale of random actions, by the driver that they are added to.
SCALES = {"zero": 0.15, "adaptive": 0.05, "gait-identifying": 0.05}

Episode = dict[str, Any]


def env_kwargs(name: str) -> dict[str, Any]:
    """The arguments of the environment that a driver acts in."""
    return capsule_gym.load_policy(name).env_kwargs if is_trained(name) else SCRIPTED[name].env_kwargs


def episodes() -> Iterator[Episode]:
    """What has a hash: which driver on which plant, and the random actions where there are any."""
    for n, name in enumerate(controller_names()):
        yield {"name": name, "driver": name, "set": "drift", "plant": n}
    for n, (name, scale) in enumerate(SCALES.items()):
        for i in (2 * n, 2 * n + 1):
            actions = np.random.default_rng(i).uniform(-scale, scale, ACTIONS).round(4).tolist()
            held = {"actions": actions, "hold": HOLD}
            yield {"name": f"held torques on {name}, {i % 2 + 1}", "driver": name, "set": "wide", "plant": i, **held}


def describe_plant(plant: PlantSpec) -> dict[str, Any]:
    """A plant without what is as it always is."""
    return {key: value for key, value in plant.to_dict().items() if key != "seed" and value != []}


def compute(episode: Episode) -> tuple[int, str]:
    """How many steps an episode takes, and its hash, by Python's environment."""
    name, plant = episode["driver"], load_set(episode["set"]).plants[episode["plant"]]
    kwargs = env_kwargs(name)
    env = capsule_gym.CapsuleEnv(**kwargs)
    observation, _ = env.reset(options=plant.reset_options())
    act = (capsule_gym.load_policy(name) if is_trained(name) else SCRIPTED[name]).start([plant.seed])
    digest, terminated, step = hashlib.sha256(), False, 0
    while not terminated and step < round(HORIZON / kwargs.get("control_dt", CONTROL_DT)):
        if "actions" in episode:
            action = np.array([episode["actions"][step // episode["hold"] % len(episode["actions"])]], np.float32)
        else:
            action = act(observation[None])[0]
        observation, _, terminated, _, _ = env.step(action)
        digest.update(env.simulation.world[0, :, 0].tobytes() + observation.tobytes())
        step += 1
    env.close()
    return step, digest.hexdigest()


@dataclass(frozen=True)
class Args:
    """Computes the episodes that the page replays; exit status 1 where they are not the committed ones.

    Examples:
      python -m web.episodes
      python -m web.episodes --write
    """

    write: bool = False
    """Commit new ones: write them to web/episodes.json."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, "python -m web.episodes", arguments)
    found = []
    for episode in episodes():
        steps, digest = compute(episode)
        found.append({**episode, "steps": steps, "sha256": digest})
    if args.write:
        write_atomically(FILE, "[\n" + ",\n".join(json.dumps(episode) for episode in found) + "\n]\n")
    committed = json.loads(FILE.read_text(encoding="utf-8"))
    wrong = [episode["name"] for episode in found if episode not in committed]
    print(
        *(f"{name}: differs from web/episodes.json" for name in wrong),
        f"{len(found)} episodes, {len(wrong)} differ",
        sep="\n",
    )
    return int(bool(wrong or len(found) != len(committed)))


if __name__ == "__main__":
    sys.exit(main())
