"""The task `goal`: a lower bound on the time of any controller, and the scripted policy's time.

Only friction changes the horizontal momentum of capsule and ball. With X and Y the position and the height of their
centre of mass, Newton's law on the vertical gives the normal force, and so

    |X''| <= f (g + Y''), f = mu static_ratio,

for any motion of the ball. With U = X - f Y and V = X + f Y, U'' <= f g and V'' >= -f g. The ball is at most l from
the pivot, so that X is within s = m l / (M + m) of the platform's position, and Y within s of 0.
"""

from __future__ import annotations

import numpy as np

from agents.analysis.data import Document
from baselines.evaluation.episodes import evaluate, scores
from baselines.tables import markdown_table
from capsule_gym._core import HOLD, TOLERANCE
from capsule_gym.evaluation_sets import PlantSpec, load_set
from capsule_gym.parameters import Capsule

POLICY = "goal-pulses"
# Times t before the rest, s. Each gives a valid bound, and the largest bound is used.
TIMES = np.linspace(0.0, 15.0, 1501)


def document() -> Document:
    """The scripted policy's time to the goal and its lower bound, as medians over each set."""
    rows = [["set", "goals reached", "time to the goal (s)", "lower bound (s)", "time over bound"]]
    for each in map(load_set, ("goal", "goal-paper")):
        episodes = evaluate(POLICY, each)
        times, success = (scores(episodes, name)[0] for name in ("goal_time", "success"))
        bounds = np.array([least_time(plant, each.env_kwargs["capsule"]) for plant in each.plants])
        medians = (f"{np.median(values):.2f}" for values in (times, bounds, times / bounds))
        rows.append([f"`{each.name}`", f"{100.0 * success.mean():.1f} %", *medians])
    return Document({"bound": markdown_table(rows)})


def least_time(plant: PlantSpec, capsule: Capsule) -> float:
    """A lower bound on the time to the goal in s, including the rest of 1 s, on a level floor with Coulomb friction.

    The platform comes to rest at a time T. U starts at rest, and at T is at least its value with the ball behind the
    platform. For every t <= T, U is at most U(0) + f g (T - t)^2 / 2 at the time T - t, and V is at least
    V(T) - w t - f g t^2 / 2 at this time. V stays within the reach of the ball while the platform rests for 1 s, so
    that its velocity w at T is at most the remaining distance / (1 s) + f g (1 s) / 2.

    Args:
        plant: a plant with a goal.
        capsule: the constants that `plant` does not set.
    """
    f = plant.mu * capsule.static_ratio * max(1.0, capsule.backward_ratio)
    g, s = capsule.g, capsule.m * capsule.l / (plant.M + capsule.m)
    assert plant.goal is not None
    side = 1.0 if plant.goal > 0.0 else -1.0
    nearest = abs(plant.goal) - TOLERANCE
    start = -s * np.sin(side * plant.theta) - f * s * np.cos(plant.theta)
    farthest = s * np.hypot(1.0, f)
    to_rest = np.sqrt(2.0 * max(0.0, nearest - farthest - start) / (f * g))
    left = nearest - s - 2.0 * f * s - start - ((s + farthest) / HOLD + 0.5 * f * g * HOLD) * TIMES
    left -= 0.5 * f * g * TIMES * TIMES
    stopped = (TIMES + np.sqrt(2.0 * np.maximum(0.0, left) / (f * g)))[left >= 0.0]
    return float(max(to_rest, stopped.max(initial=0.0)) + HOLD)
