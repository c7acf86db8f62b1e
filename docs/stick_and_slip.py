"""Draws media/stick_and_slip.gif, the paper's controller above an agent: `python
docs/stick_and_slip.py`.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.demo import Episode, find_policy
from capsule_gym.envs.env import shown_state
from capsule_gym.evaluation.sets import load_set
from capsule_gym.rendering import Renderer, write_gif

PERIOD, FRAME_SECONDS = 6.6, 0.07
TITLES = {"adaptive": "the paper's controller", "residual-ppo": "a trained agent"}


def frames() -> Iterator[np.ndarray]:
    """The frames of both episodes on one plant, one above the other, during the second cycle of the
    controller.
    """
    nominal = load_set("nominal")
    episodes = [Episode(find_policy(name), nominal, nominal.plants[0]) for name in TITLES]
    renderers = [
        Renderer(
            episode.env.simulation.capsule,
            "rgb_array",
            1.0 / FRAME_SECONDS,
            1.5,
            TITLES[episode.policy.name],
        )
        for episode in episodes
    ]
    for n in range(round(PERIOD / FRAME_SECONDS)):
        lanes: list[Any] = []
        for episode, renderer in zip(episodes, renderers, strict=True):
            episode.advance(PERIOD + n * FRAME_SECONDS)
            lanes.append(renderer.draw(**shown_state(episode.env.simulation, 0)))
        yield np.concatenate(lanes)


if __name__ == "__main__":
    write_gif(
        frames(), Path(__file__).parent / "media" / "stick_and_slip.gif", FRAME_SECONDS, width=500
    )
