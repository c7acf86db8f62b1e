"""Sensitivity to disturbances: every row of the speed task under each single disturbance."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from tqdm import tqdm

from agents.leaderboard.candidates import all_candidates
from baselines.tables import markdown_table
from capsule_gym.evaluation.candidates import Candidate
from capsule_gym.evaluation.episodes import (
    TABLE_METRICS,
    evaluate,
    failures,
    scores,
    validation_set,
)
from capsule_gym.evaluation.statistics import interquartile_mean
from capsule_gym.parameters import DISTURBANCES, REAL, SENSORS, Disturbances

SPEED = TABLE_METRICS["mean_speed"]
# Number and first seed of the episodes, on plants of randomization="paper".
EPISODES = 50
FIRST_SEED = 23_000_000


def _sized_as_real(*names: str) -> dict[str, Any]:
    return {name: getattr(REAL, name) for name in names}


def _of_sensors(kind: str) -> dict[str, Any]:
    return _sized_as_real(*(f"{name}_{kind}" for name in SENSORS))


def _resolutions() -> dict[str, Any]:
    # Readings are as coarse as their noise.
    sizes = {f"{name}_resolution": getattr(REAL, f"{name}_noise") for name in SENSORS}
    return {**sizes, "torque_resolution": 0.05}


ALL = 'all of "real"'
# Each disturbance by its name in tables: as in "real" (mean latency), if "real" contains it.
DISTURBED: dict[str, dict[str, Any]] = {
    "white noise": _of_sensors("noise"),
    "bias": _of_sensors("bias"),
    "drift": _of_sensors("drift"),
    "resolution": _resolutions(),
    "latency": {"latency": float(np.mean(REAL.latency))},
    "motor lag": _sized_as_real("lag"),
    "motor friction": _sized_as_real("motor_friction"),
    "pushes": {"push": 0.5},
    ALL: _sized_as_real(*(name for name in DISTURBANCES if name != "drift_time")),
}
NONE = "none"
# The interquartile mean of the speed (cm/s) and the number of failures, by disturbance.
Cells = Mapping[str, tuple[float, int]]


def conditions() -> dict[str, str | Disturbances]:
    """The disturbances by name."""
    disturbed = {name: Disturbances(**given) for name, given in DISTURBED.items()}
    return {NONE: "none", **disturbed, "no x_dot": Disturbances(unmeasured=("x_dot",))}


def run(candidates: Sequence[Candidate], horizon: float | None = None) -> dict[str, Cells]:
    """Evaluates policies of the speed task under all conditions, a trained one with its first seed.

    Returns:
        The results by the policy's name, sorted by the speed without disturbances, fastest first.
    """
    plants = validation_set("paper", "sensitivity", FIRST_SEED, EPISODES)
    found = {}
    for candidate in tqdm(candidates, "evaluating", file=sys.stderr, disable=None):
        cells = {}
        for condition, disturbances in conditions().items():
            disturbed = replace(plants, disturbances=disturbances)
            episodes = evaluate(candidate.policies[0], disturbed, horizon=horizon)
            speeds = scores(episodes, SPEED.name)[0]
            cells[condition] = float(interquartile_mean(speeds)), failures(episodes)
        found[candidate.name] = cells
    return dict(sorted(found.items(), key=lambda row: -row[1][NONE][0]))


def document() -> tuple[dict[str, str], dict[str, Any]]:
    """The tables for all rows; there is no figure."""
    sizes = [["disturbance", "size"]]
    for name, given in DISTURBED.items():
        fields = ", ".join(f"`{each}={size}`" for each, size in given.items())
        sizes.append([name, '`disturbances="real"`' if name == ALL else fields])
    speeds = table(run(all_candidates()))
    return {"sizes": markdown_table(sizes), "speeds": speeds}, {}


def table(results: Mapping[str, Cells]) -> str:
    """Speed (cm/s), and failures in brackets, under every disturbance."""
    lines = [["policy", *conditions()]]
    for policy, cells in results.items():
        line = [policy]
        for speed, failed in cells.values():
            failures_in_brackets = f" ({failed})" if failed else ""
            line.append(SPEED.format(speed) + failures_in_brackets)
        lines.append(line)
    return markdown_table(lines)
