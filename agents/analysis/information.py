"""What observing M and mu is worth: the table of the policies that `agents.information` trains."""

from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from agents.information import (
    CEILING,
    MEMORY,
    METRICS,
    ROWS,
    SETS,
    Results,
    read_record,
)
from agents.leaderboard.page import FAILED, failures_with_interval
from agents.leaderboard.rows import RESULTS, load_row
from baselines.drawing import BLUE, GREEN, VERMILION, add_note, new_figure
from baselines.tables import markdown_table
from capsule_gym.evaluation.episodes import TABLE_METRICS
from capsule_gym.evaluation.sets import load_set
from capsule_gym.evaluation.statistics import (
    Estimate,
    adjust,
    estimate,
    lowest_decile,
    paired_difference,
)

ROOT = Path(__file__).resolve().parents[2]
SPEED = TABLE_METRICS["mean_speed"]
BLIND = "nothing"
INFORMATION = {
    BLIND: "nothing more",
    "history": "16 readings",
    MEMORY: "a memory",
    "estimates": "estimates",
    "plant": "M and mu",
}
SAME_CRITIC = "-same-critic"
LEARNERS = {
    "ppo": ("PPO", VERMILION, "s--"),
    "distilled": ("distilled", BLUE, "o-"),
    f"ppo{SAME_CRITIC}": ("PPO, critic without M and mu", VERMILION, "x"),
}
# The row without a learner on each set, against which regret is measured.
OPTIMUM = "optimum"


def document() -> tuple[dict[str, str], dict[str, Callable[[], Any]]]:
    """The table and figures from the record of `agents.information` and the leaderboard."""
    record = read_record()
    for name, row_name in ROWS.items():
        row = load_row(ROOT / RESULTS / f"{row_name}.npz")
        record[name] = {metric: row.score("wide", metric) for metric in METRICS}
    tables = {set_name: table(record, set_name) for set_name in SETS}
    ceilings = [["set", SPEED.label, FAILED]]
    for name, results in record.items():
        set_name, _, kind = name.rpartition("-")
        if kind == CEILING:
            ceilings.append([set_name, _speed(results), failures(results)])
    tables[CEILING] = markdown_table(ceilings)
    figures: dict[str, Callable[[], Any]] = {}
    figures["information"] = partial(draw_speeds, record)
    figures["information_regret"] = partial(draw_regrets, record)
    return tables, figures


def table(record: dict[str, Results], set_name: str) -> str:
    """Speed, regret, lowest decile and failures of the cells of a set."""
    p_values = compare(record)
    p_label = f"p of {len(p_values)} [Holm]"
    columns = ["observed", "learnt by", SPEED.label, "regret (cm/s)", "lowest decile"]
    lines = [[*columns, p_label, FAILED]]
    optimum = record[f"{set_name}-{OPTIMUM}"]
    for information, label in INFORMATION.items():
        for learner, (title, _, _) in LEARNERS.items():
            name = f"{set_name}-{information}-{learner}"
            if name in record:
                cells = _cells(record[name], optimum, p_values.get(name))
                lines.append([label, title, *cells])
    lines.append(["M and mu", "dp-oracle", *_cells(optimum, optimum)])
    return markdown_table(lines)


def compare(record: dict[str, Results]) -> dict[str, float]:
    """The adjusted p-values of differences in speed to the policies that observe nothing more.

    A cell is compared with that of the same set and learner; all comparisons are one family.
    """
    found = {}
    for set_name, information, learner in product(SETS, INFORMATION, LEARNERS):
        name = f"{set_name}-{information}-{learner}"
        blind = f"{set_name}-{BLIND}-{learner.removesuffix(SAME_CRITIC)}"
        if name != blind and {name, blind} <= record.keys():
            speeds = [record[each][SPEED.name] for each in (name, blind)]
            found[name] = paired_difference(*speeds, mean=True).p_value
    adjusted = adjust(list(found.values())).tolist()
    return dict(zip(found, adjusted, strict=True))


def _cells(results: Results, optimum: Results, p_value: float | None = None) -> list[str]:
    """The numbers of a line."""
    regret = paired_difference(optimum[SPEED.name], results[SPEED.name], mean=True)
    decile = lowest_decile(results[SPEED.name])
    shown = "0" if results is optimum else _interval(regret)
    return [_speed(results), shown, SPEED.format(decile), _p_text(p_value), failures(results)]


def _p_text(p_value: float | None) -> str:
    if p_value is None:
        return "-"
    return "<0.001" if p_value < 0.001 else f"{p_value:.3f}"


def _speed(results: Results) -> str:
    """The mean speed with its interval, cm/s."""
    return _interval(estimate(results[SPEED.name], mean=True))


def failures(results: Results) -> str:
    """The failed episodes of all runs."""
    failed = results["failed"]
    return failures_with_interval(int(failed.sum()), failed.size)


def _interval(found: Estimate) -> str:
    return SPEED.with_interval((found.value, found.low, found.high))


def draw_speeds(record: dict[str, Results]) -> Any:
    """Draws mean speed over information, a panel per set."""
    figure = new_figure(3.4)
    panels = figure.subplots(1, len(SETS), sharey=True)
    for axes, set_name in zip(panels, SETS, strict=True):
        for learner, (title, colour, pen) in LEARNERS.items():
            places = []
            means = []
            for place, information in enumerate(INFORMATION):
                results = record.get(f"{set_name}-{information}-{learner}")
                if results is not None:
                    seeds = results[SPEED.name].mean(axis=1)
                    axes.plot(np.full(len(seeds), place), seeds, ".", color=colour, alpha=0.4)
                    places.append(place)
                    means.append(seeds.mean())
            if places:
                axes.plot(places, means, pen, color=colour, label=title)
        speed = record[f"{set_name}-{OPTIMUM}"][SPEED.name].mean()
        axes.axhline(speed, color=GREEN, label="dp-oracle")
        axes.set_xticks(range(len(INFORMATION)), INFORMATION.values(), rotation=20)
        axes.set_title(set_name)
        axes.set_ylim(8.0, None)
    panels[0].set_ylabel(SPEED.label)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    add_note(
        figure,
        "Small dots: training seeds. wide: perfect sensors; real-wide: disturbed sensors, lag and "
        "friction of the motor. On real-wide, dp-oracle has no disturbances and nominal pendulums.",
    )
    return figure


def draw_regrets(record: dict[str, Results]) -> Any:
    """Draws the regret of students on every plant of `wide`, without and with a memory."""
    plants = load_set("wide").plants
    figure = new_figure(3.2)
    panels = figure.subplots(1, 2, sharey=True)
    reference = record[f"wide-{OPTIMUM}"][SPEED.name][0]
    for axes, information in zip(panels, ("nothing", MEMORY), strict=True):
        speeds = record[f"wide-{information}-distilled"][SPEED.name].mean(axis=0)
        points = axes.scatter(
            [plant.mu for plant in plants],
            [plant.M for plant in plants],
            c=reference - speeds,
            s=14.0,
            cmap="viridis",
            vmin=0.0,
            vmax=5.0,
        )
        axes.set_xscale("log")
        axes.set_xlabel("mu")
        axes.set_title(f"observed: {INFORMATION[information]}")
    panels[0].set_ylabel("M (kg)")
    figure.colorbar(points, ax=panels, label="regret (cm/s)", extend="both")
    return figure
