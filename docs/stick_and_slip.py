"""Draws media/stick_and_slip.gif: `python docs/stick_and_slip.py`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.demo import Episode, find_policy
from capsule_gym.envs.env import shown_state
from capsule_gym.evaluation.sets import load_set
from capsule_gym.rendering import Renderer, write_gif

FILE = Path(__file__).parent / "media" / "stick_and_slip.gif"
# Length of the controller's cycle, start of the last one of an episode, and time between frames, s.
PERIOD = 6.6
START = 26.4
FRAME_SECONDS = 0.07
# The paper's controller is above the agent.
TITLES = {"adaptive": "the paper's controller", "residual-ppo": "a trained agent"}


def frames() -> Iterator[np.ndarray]:
    """The frames of both episodes on one plant during the last cycle of the controller."""
    nominal = load_set("nominal")
    lanes = []
    for name, title in TITLES.items():
        episode = Episode(find_policy(name), nominal, nominal.plants[0])
        capsule = episode.env.simulation.capsule
        renderer = Renderer(
            capsule, "rgb_array", fps=1.0 / FRAME_SECONDS, torque_limit=1.5, title=title
        )
        lanes.append((episode, renderer))
    for n in range(round(PERIOD / FRAME_SECONDS)):
        drawn: list[Any] = []
        for episode, renderer in lanes:
            present = START + n * FRAME_SECONDS
            episode.advance(time=present)
            drawn.append(renderer.draw(**shown_state(episode.env.simulation, 0)))
        yield np.concatenate(drawn)


if __name__ == "__main__":
    write_gif(frames(), FILE, FRAME_SECONDS, width=500)
