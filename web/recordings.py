"""What the optimum's policies did on the frozen plants: `python -m web.recordings` compares it with what they do.

Their tables are many times the module's size; their torques are few bytes. So the module has these instead: for every
frozen plant the place in `TORQUES` of each action of the episode, which it acts out in its own step.
"""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from baselines.policies import SCRIPTED, Act
from capsule_gym.command_line import parse
from capsule_gym.evaluation_sets import SET_NAMES, EvaluationSet, PlantSpec, load_set
from capsule_gym.files import write_atomically
from capsule_gym.task import CONTROL_DT, EPISODE_STEPS
from web.controllers import RECORDED

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
    # Here, since numba comes with them, which takes most of a second to import.
    from agents.evaluation.episodes import evaluate
    from baselines.dynamic_programming.policy import TORQUES

    policy, taken = SCRIPTED[name], []

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
        # An episode may end within its last step.
        steps = math.ceil(episode["duration"] / CONTROL_DT - 1e-6)
        row[:steps] = np.searchsorted(TORQUES, actions[:steps])
    return places


def known_recordings() -> dict[str, dict[str, np.ndarray]]:
    """The committed recordings, by policy and set; each as of `record`."""
    with np.load(FILE) as file:
        return {name: {each: file[f"{name} {each}"] for each in SET_NAMES} for name in RECORDED}


@dataclass(frozen=True)
class Args:
    """Records the optimum's policies anew; exit status 1 where they do not do what is committed.

    Examples:
      python -m web.recordings
      python -m web.recordings --write
    """

    write: bool = False
    """Commit new ones: write them to web/recordings.npz."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, "python -m web.recordings", arguments)
    found: dict[str, Any] = {}
    for name in RECORDED:
        for each in SET_NAMES:
            print(f"{name} on {each} ..", file=sys.stderr, flush=True)
            found[f"{name} {each}"] = record(name, load_set(each).plants)
    if args.write:
        content = io.BytesIO()
        np.savez_compressed(content, **found)
        write_atomically(FILE, content.getvalue())
    with np.load(FILE) as known:
        wrong = [key for key, places in found.items() if not np.array_equal(places, known[key])]
    for key in wrong:
        print(f"{key}: differs from web/recordings.npz")
    print(f"{len(found)} recordings of 100 episodes, {len(wrong)} differ")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
