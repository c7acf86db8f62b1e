"""What the optimum's policies did on the frozen plants: `python -m web.recordings` compares it with what they do.

Their tables are many times the module's size; their torques are few bytes. So the module has these instead: for every
frozen plant the place in `TORQUES` of each action of the episode, which it acts out in its own step.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import capsule_gym
from agents.drivers import RECORDED
from agents.evaluation.sets import SET_NAMES, PlantSpec, load_set
from baselines.policies import SCRIPTED
from capsule_gym.command_line import parse
from capsule_gym.files import write_bytes_atomically
from capsule_gym.task import EPISODE_STEPS

FILE = Path(__file__).with_name("recordings.npz")
# Behind the last action of an episode.
OVER = 255


def record(name: str, plants: Sequence[PlantSpec]) -> np.ndarray:
    """The actions of a policy, as places in `TORQUES`.

    Args:
        name: one of `RECORDED`.
        plants: one episode each.

    Returns:
        Shape (plants, `EPISODE_STEPS`), uint8; `OVER` behind the end of an episode.
    """
    # Here, since numba comes with it, which takes most of a second to import.
    from baselines.optimum.policy import TORQUES

    policy, count = SCRIPTED[name], len(plants)
    env = capsule_gym.CapsuleVectorEnv(count, autoreset_mode="DISABLED", **policy.env_kwargs)
    seeds, each = [plant.seed for plant in plants], [plant.reset_options() for plant in plants]
    options: dict[str, Any] = {key: np.array([one[key] for one in each]) for key in ("M", "mu", "state")}
    options["changes"] = [one["changes"] for one in each]
    observations, _ = env.reset(seed=seeds, options=options)
    act = policy.start(seeds)
    places = np.full((count, EPISODE_STEPS), OVER, np.uint8)
    running = np.ones(count, bool)
    for step in range(EPISODE_STEPS):
        actions = act(observations)
        places[running, step] = np.searchsorted(TORQUES, actions[running, 0])
        observations, _, terminated, _, _ = env.step(actions)
        running &= ~terminated
        if not running.any():
            break
    env.close()
    return places


def known_recordings() -> dict[str, dict[str, np.ndarray]]:
    """The committed recordings, by policy and set; each as of `record`."""
    with np.load(FILE) as file:
        return {name: {each: file[f"{name} {each}"] for each in SET_NAMES} for name in RECORDED}


@dataclass(frozen=True)
class Options:
    """Records the optimum's policies anew; exit status 1 where they do not do what is committed.

    Examples:
      python -m web.recordings
      python -m web.recordings --write
    """

    write: bool = False
    """Commit new ones: write them to web/recordings.npz."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, "python -m web.recordings", arguments)
    found: dict[str, Any] = {}
    for name in RECORDED:
        for each in SET_NAMES:
            print(f"{name} on {each} ..", file=sys.stderr, flush=True)
            found[f"{name} {each}"] = record(name, load_set(each).plants)
    if options.write:
        content = io.BytesIO()
        np.savez_compressed(content, **found)
        write_bytes_atomically(FILE, content.getvalue())
    known = known_recordings()
    wrong = [key for key, places in found.items() if not np.array_equal(places, known[key.split()[0]][key.split()[1]])]
    print(*(f"{key}: differs from web/recordings.npz" for key in wrong), sep="\n", end="\n" if wrong else "")
    print(f"{len(found)} recordings of 100 episodes, {len(wrong)} differ")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
