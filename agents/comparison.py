"""The comparison at the end of training: a table, a figure, an animation and a report in the run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents import report
from agents.evaluate import comparison_table
from agents.evaluation.criteria import CRITERIA
from agents.evaluation.episodes import evaluate
from agents.evaluation.policies import Policy, find_candidate
from agents.training.export import load_best
from baselines.drawing import BLUE, DPI, MUTED, new_figure, style
from capsule_gym import CapsuleEnv
from capsule_gym.config import find_task
from capsule_gym.evaluation_sets import NOMINAL_PLANT, EvaluationSet, PlantSpec, load_set
from capsule_gym.files import replacing, write_atomically
from capsule_gym.rendering import FRAME_SECONDS, write_gif
from capsule_gym.task import CONTROL_DT

# Length of the animation, and of the shown part of angle and torque at the end of an episode, s.
SHOWN = 6.6


def compare(run: Path, set_name: str | None = None) -> None:
    """Evaluates a run's best model and the baseline on the same frozen episodes; prints and draws the comparison.

    Writes comparison.png, animation.gif and report.html to the run's folder. The default set is the task's ranking set.
    """
    policy = load_best(run)
    criteria = CRITERIA[policy.env_kwargs.get("task", "speed")]
    evaluation_set, (baseline,) = load_set(set_name or criteria.ranking_set), find_candidate(criteria.baseline).policies
    own, theirs = (evaluate(each, evaluation_set) for each in (policy, baseline))
    seconds = find_task(evaluation_set.task).episode_steps * CONTROL_DT
    print(f"\nOn the set {evaluation_set.name} ({len(own)} episodes of {seconds:g} s, the same for both):\n")
    print(comparison_table("agent", own, criteria.baseline, theirs) + "\n")
    print("Drawing, and evaluating the agent on every set for its report, takes some seconds.\n", flush=True)
    plant = NOMINAL_PLANT if evaluation_set.task == "speed" else evaluation_set.plants[0]
    names = {criteria.baseline: baseline, "agent": policy}
    recordings = {name: record(each, plant, evaluation_set, seconds)[0] for name, each in names.items()}
    draw(recordings, run / "comparison.png", plant)
    write_gif(record(policy, plant, evaluation_set, SHOWN, frames=True)[1], run / "animation.gif")
    write_atomically(run / "report.html", report.render([str(run)], trust_controller=True, trust_pickle=True))
    for what, name in {"Figure": "comparison.png", "Animation": "animation.gif", "Report": "report.html"}.items():
        print(f"{what + ':':10} {run / name}")


def record(
    policy: Policy, plant: PlantSpec, evaluation_set: EvaluationSet, seconds: float, *, frames: bool = False
) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    """Runs a policy on one plant of a set for `seconds`, or until its episode ends.

    Returns:
        Samples per agent step, each of shape (steps + 1,): t (s), theta (rad), theta_dot (rad/s), x (m), x_dot (m/s),
        torque (N m); and pictures in intervals of `FRAME_SECONDS`, each (height, width, 3), uint8, if asked for.
    """
    env = CapsuleEnv(**{**policy.env_kwargs, **evaluation_set.env_kwargs}, render_mode="rgb_array")
    act, dt = policy.start([plant.seed]), env.simulation.options.control_dt
    observation, info = env.reset(seed=plant.seed, options=plant.reset_options())
    samples, ended = [(0.0, *info["state"], info["torque"])], False
    pictures: list[Any] = []
    while not ended and len(samples) <= round(seconds / dt):
        if frames and samples[-1][0] + 0.5 * dt > len(pictures) * FRAME_SECONDS:
            pictures.append(env.render())
        observation, _, ended, _, info = env.step(act(observation[None])[0])
        samples.append((len(samples) * dt, *info["state"], info["torque"]))
    env.close()
    return dict(zip(("t", "theta", "theta_dot", "x", "x_dot", "torque"), np.array(samples).T, strict=True)), pictures


def draw(recordings: Mapping[str, Mapping[str, np.ndarray]], path: Path, plant: PlantSpec) -> None:
    """Draws displacement over the episode, and angle and torque over its last seconds, as a PNG.

    Args:
        recordings: samples of two recordings on the plant by the policies' names, the baseline first.
        path: the PNG; written atomically.
        plant: the plant.
    """
    title = f"{'Nominal plant' if plant == NOMINAL_PLANT else 'Plant'} (M = {plant.M:g} kg, μ = {plant.mu:g})"
    end = max(each["t"][-1] for each in recordings.values())
    with style():
        figure = new_figure(5.5)
        displacement, angle, torque = figure.subplots(3, 1, height_ratios=(1.5, 1.0, 1.0))
        for (name, each), colour in zip(recordings.items(), (MUTED, BLUE), strict=True):
            speed = 100.0 * (each["x"][-1] - each["x"][0]) / each["t"][-1]
            displacement.plot(each["t"], 100.0 * each["x"], color=colour, label=f"{name}: {speed:.2f} cm/s")
            angle.plot(each["t"], np.degrees(each["theta"]), color=colour)
            torque.step(each["t"], each["torque"], color=colour, linewidth=1.0, where="pre")
        if plant.goal is not None:
            displacement.axhline(100.0 * plant.goal, color=MUTED, linewidth=0.8, linestyle=":", label="goal")
        displacement.set(title=title, ylabel="displacement x (cm)", xlim=(0.0, end))
        displacement.legend(loc="upper left")
        window: dict[str, Any] = {"xlim": (max(0.0, end - SHOWN), end)}
        angle.set(ylabel="angle θ (deg)", **window)
        torque.set(xlabel="time (s)", ylabel="torque u (N m)", **window)
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=DPI)
