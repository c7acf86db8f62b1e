"""Sensitivity to disturbances: every row of the speed task under each single disturbance, in four sizes."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from tqdm import tqdm

from baselines.drawing import INK, VERMILION, add_note, new_figure
from baselines.evaluation.episodes import TABLE_METRICS, evaluate, failures, scores, validation_set
from baselines.evaluation.policies import Candidate, all_candidates
from baselines.evaluation.statistics import interquartile_mean
from baselines.tables import markdown_table
from capsule_gym.parameters import DISTURBANCES, REAL, SENSORS, Disturbances

SPEED = TABLE_METRICS["mean_speed"]
# Multiples of the sizes below.
SIZES = (0.5, 1.0, 2.0, 4.0)
# Number and first seed of the episodes, on plants of randomization="paper".
EPISODES, FIRST_SEED = 50, 23_000_000


def _sized_as_real(*names: str) -> dict[str, Any]:
    return {name: getattr(REAL, name) for name in names}


ALL = 'all of "real"'
_WHITE = _sized_as_real(*(f"{name}_noise" for name in SENSORS))
# Each disturbance at size 1, by its name in tables: as in "real" (mean latency), if "real" contains it.
DISTURBED: dict[str, dict[str, Any]] = {
    "white noise": _WHITE,
    "bias": _sized_as_real(*(f"{name}_bias" for name in SENSORS)),
    "drift": _sized_as_real(*(f"{name}_drift" for name in SENSORS)),
    "resolution": {
        **{name.replace("noise", "resolution"): size for name, size in _WHITE.items()},
        "torque_resolution": 0.05,
    },
    "latency": {"latency": float(np.mean(REAL.latency))},
    "motor lag": _sized_as_real("lag"),
    "motor friction": _sized_as_real("motor_friction"),
    "pushes": {"push": 0.5},
    ALL: _sized_as_real(*(name for name in DISTURBANCES if name != "drift_time")),
}
NONE, UNMEASURED = "none", "no x_dot"
# The interquartile mean of the speed (cm/s) and the number of failures, by disturbance and size.
Cells = Mapping[tuple[str, float], tuple[float, int]]


def conditions() -> dict[tuple[str, float], str | Disturbances]:
    """The disturbances by name and size; disturbances without a size have size 1."""
    found: dict[tuple[str, float], str | Disturbances] = {(NONE, 1.0): "none"}
    for name, given in DISTURBED.items():
        for size in SIZES:
            scaled: dict[str, Any] = {
                each: tuple(size * end for end in value) if isinstance(value, tuple) else size * value
                for each, value in given.items()
            }
            found[name, size] = Disturbances(**scaled)
    return {**found, (UNMEASURED, 1.0): Disturbances(unmeasured=("x_dot",))}


def run(candidates: Sequence[Candidate], horizon: float | None = None) -> dict[str, Cells]:
    """Evaluates policies of the speed task under all conditions, a trained one with its first seed.

    Returns:
        The results by the policy's name, sorted by the speed without disturbances, fastest first.
    """
    plants, found = validation_set("paper", "sensitivity", FIRST_SEED, EPISODES), {}
    for candidate in tqdm(candidates, "evaluating", file=sys.stderr, disable=None):
        cells = {}
        for condition, disturbances in conditions().items():
            episodes = evaluate(candidate.policies[0], replace(plants, disturbances=disturbances), horizon=horizon)
            cells[condition] = float(interquartile_mean(scores(episodes, SPEED.name)[0])), failures(episodes)
        found[candidate.name] = cells
    return dict(sorted(found.items(), key=lambda row: -row[1][NONE, 1.0][0]))


def document() -> tuple[dict[str, str], dict[str, Callable[[], Any]]]:
    """The tables and the figure for all rows."""
    results = run(all_candidates())
    fields = {name: ", ".join(f"`{each}={size}`" for each, size in given.items()) for name, given in DISTURBED.items()}
    fields[ALL] = '`disturbances="real"`'
    sizes = markdown_table([["disturbance", "at the size 1"], *([name, text] for name, text in fields.items())])
    return {"sizes": sizes, "speeds": table(results)}, {"sensitivity": lambda: draw(results)}


def table(results: Mapping[str, Cells]) -> str:
    """Speed (cm/s), and failures in brackets, under every disturbance of size 1."""
    columns = [name for name, size in conditions() if size == 1.0]
    lines = [["policy", *columns]]
    for policy, cells in results.items():
        line = [policy]
        for name in columns:
            speed, failed = cells[name, 1.0]
            line.append(SPEED.format(speed) + (f" ({failed})" if failed else ""))
        lines.append(line)
    return markdown_table(lines)


def draw(results: Mapping[str, Cells]) -> Any:
    """Draws every policy under every disturbance, with the speed as a shade and the failures as a dot."""
    names = list(dict.fromkeys(name for name, _ in conditions()))
    widths = [len([1 for name, _ in conditions() if name == each]) for each in names]
    figure = new_figure(1.5 + 0.155 * len(results))
    places = figure.subplots(1, len(names), sharey=True, width_ratios=widths)
    for name, axes in zip(names, places, strict=True):
        sizes = [size for each, size in conditions() if each == name]
        values = np.array([[cells[name, size] for size in sizes] for cells in results.values()])
        image = axes.imshow(values[..., 0], cmap="Blues", vmin=0.0, vmax=20.0, aspect="auto", interpolation="nearest")
        rows, columns = values[..., 1].nonzero()
        areas = 16.0 * values[rows, columns, 1] / EPISODES
        axes.scatter(columns, rows, s=1.0 + areas, color=VERMILION, linewidth=0.0)
        axes.set_xticks(range(len(sizes)), [f"{size:g}".lstrip("0") for size in sizes] if len(sizes) > 1 else [""])
        axes.set_title(name, rotation=50.0, ha="left", fontsize=7.0)
        axes.tick_params(length=0.0, labelsize=7.0)
        axes.grid(visible=False)
    places[0].set_yticks(range(len(results)), list(results), parse_math=False, color=INK)
    figure.colorbar(image, ax=places, shrink=0.6, aspect=30.0, pad=0.01, label="mean speed (cm/s)")
    add_note(
        figure,
        f"Horizontal: multiples of the size in the table. Dots: failures, the largest where all {EPISODES} episodes "
        "failed. Plants of the paper's ranges, 33 s from rest.",
    )
    return figure
