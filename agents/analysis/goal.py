"""The task `goal`: a lower bound on the time of any controller, the scripted policy's time, and two of its episodes.

Only friction changes the horizontal momentum of capsule and ball. With X and Y the position and the height of their
centre of mass, Newton's law on the vertical gives the normal force, and so

    |X''| <= f (g + Y''), f = mu static_ratio,

for any motion of the ball. With U = X - f Y and V = X + f Y, U'' <= f g and V'' >= -f g. The ball is at most l from
the pivot, so that X is within s = m l / (M + m) of the platform's position, and Y within s of 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from agents.analysis.data import Document
from agents.analysis.figures import write_with
from agents.analysis.recording import TASK_POLICIES, record
from agents.evaluation.episodes import evaluate, scores
from baselines.drawing import BLUE, MUTED, VERMILION, add_note, new_figure
from baselines.policies import TASK_SCRIPTED
from baselines.tables import markdown_table
from capsule_gym._core import HOLD, TOLERANCE
from capsule_gym.evaluation_sets import EvaluationSet, PlantSpec, load_set
from capsule_gym.parameters import Capsule
from capsule_gym.task import TORQUE_LIMIT

POLICY = "goal-pulses"
# Plants of the figure's episodes: with mu in the middle of the task's range, and on the paper's floor.
PLANTS = {"goal": TASK_POLICIES[POLICY][0], "goal-paper": PlantSpec(0.5, 0.01, seed=0, goal=0.3)}
SHOWN = 4.0
# Times t before the rest, s. Each gives a valid bound, and the largest bound is used.
TIMES = np.linspace(0.0, 15.0, 1501)


def document() -> Document:
    """The table and the figure."""
    figures = {"figures/goal": write_with(draw, PLANTS)}
    return Document({"bound": table([load_set(name) for name in PLANTS])}, figures)


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


def table(sets: Sequence[EvaluationSet]) -> str:
    """A Markdown table of the scripted policy's time to the goal and its lower bound, as medians over each set."""
    rows = [["set", "goals reached", "time to the goal (s)", "lower bound (s)", "time over bound"]]
    for each in sets:
        episodes = evaluate(POLICY, each)
        times, success = (scores(episodes, name)[0] for name in ("goal_time", "success"))
        bounds = np.array([least_time(plant, each.env_kwargs["capsule"]) for plant in each.plants])
        medians = (f"{np.median(values):.2f}" for values in (times, bounds, times / bounds))
        rows.append([f"`{each.name}`", f"{100.0 * success.mean():.1f} %", *medians])
    return markdown_table(rows)


def draw(plants: Mapping[str, PlantSpec]) -> Any:
    """Draws position, velocity, angle and torque over time, one column per episode.

    Args:
        plants: plants with goals, by the set that defines the floor.
    """
    figure, policy = new_figure(5.4), TASK_SCRIPTED[POLICY]
    grid = figure.subplots(4, len(plants), sharex=True, sharey="row", squeeze=False)
    for column, (name, plant) in enumerate(plants.items()):
        settings = {**policy.env_kwargs, **load_set(name).env_kwargs}
        recording = record(replace(policy, env_kwargs=settings), plant, seconds=SHOWN)
        assert plant.goal is not None
        position, velocity, angle, torque = grid[:, column]
        position.set_title(f"M = {plant.M:g} kg, μ = {plant.mu:g}, goal at {100.0 * plant.goal:g} cm")
        position.axhspan(*(100.0 * (plant.goal + side * TOLERANCE) for side in (-1.0, 1.0)), color=VERMILION, alpha=0.5)
        position.plot(recording.t, 100.0 * recording.x, color=BLUE)
        velocity.plot(recording.t, 100.0 * recording.x_dot, color=BLUE)
        angle.plot(recording.t, np.degrees(recording.theta), color=BLUE)
        torque.step(recording.t, recording.torque, color=BLUE, linewidth=0.8, where="pre")
        rests = (recording.x_dot == 0.0) & (np.abs(recording.x - plant.goal) <= TOLERANCE)
        came = recording.t[np.flatnonzero(~rests)[-1]]
        for axes in grid[:, column]:
            axes.axvspan(came, came + HOLD, color=VERMILION, alpha=0.12, linewidth=0.0)
        for limit in (-TORQUE_LIMIT, TORQUE_LIMIT):
            torque.axhline(limit, color=MUTED, linewidth=0.6)
        torque.set(xlabel="time (s)", xlim=(0.0, SHOWN))
    for axes, label in zip(grid[:, 0], ("x (cm)", "x' (cm/s)", "θ (deg)", "u (N m)"), strict=True):
        axes.set_ylabel(label)
    add_note(
        figure,
        "Orange line: within 2 mm of the goal. Orange band: the platform rests there for 1 s, and the goal is reached.",
    )
    return figure
