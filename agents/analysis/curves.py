"""Learning curves, and speed against cost of transport, from the leaderboard's results."""

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.criteria import CRITERIA
from agents.leaderboard.candidates import all_candidates
from agents.leaderboard.rows import RESULTS, LeaderboardRow, load_rows
from agents.training.config import EVALUATIONS
from baselines.drawing import BLUE, GREEN, INK, MUTED, add_note, new_figure
from baselines.dynamic_programming.archive import optimal_front
from baselines.tables import markdown_table
from capsule_gym.evaluation.candidates import CHECKPOINTS
from capsule_gym.evaluation.episodes import TABLE_METRICS
from capsule_gym.evaluation.statistics import Estimate, estimate

ROOT = Path(__file__).resolve().parents[2]
SPEED = TABLE_METRICS["mean_speed"]
FAINT = "#c5ccd6"
# Evaluations on validation plants during training, by training seed: steps and values of the task's
# metric.
Learning = dict[int, tuple[np.ndarray, np.ndarray]]


def document() -> tuple[dict[str, str], dict[str, Callable[[], Any]]]:
    """Tables and figures of the leaderboard's stored results, without new evaluations."""
    rows = load_rows(ROOT / RESULTS, [candidate.name for candidate in all_candidates()])
    ranking_set = CRITERIA["speed"].ranking_set

    def order(row: LeaderboardRow) -> tuple[float, str]:
        return -row.score(ranking_set, SPEED.name).mean(), row.name

    rows.sort(key=order)
    learning = read_learning([row.name for row in rows if row.trained], "speed")
    evaluated = {name: runs for name, runs in learning.items() if runs}
    figures: dict[str, Callable[[], Any]] = {}
    figures["curves_transport"] = partial(draw_transport, rows)
    figures["curves_learning"] = partial(draw_learning, evaluated)
    for task in ("goal", "velocity"):
        names = [candidate.name for candidate in all_candidates(task) if candidate.trained]
        runs = read_learning(names, task)
        figures[f"curves_{task}"] = partial(draw_learning, runs, CRITERIA[task].metric.label)
    return {"learning": table(learning)}, figures


def read_learning(names: Sequence[str], task: str) -> dict[str, Learning]:
    """The evaluations of all committed runs of rows, of rows without evaluations an empty dict."""
    found: dict[str, Learning] = {}
    for name in names:
        found[name] = {}
        for path in sorted((CHECKPOINTS / name).glob(f"seed-*/{EVALUATIONS}")):
            seed = int(path.parent.name.removeprefix("seed-"))
            found[name][seed] = read_evaluations(path, task)
    return found


def read_evaluations(path: Path, task: str = "speed") -> tuple[np.ndarray, np.ndarray]:
    """The steps and the values of the task's metric in the evaluations of a run."""
    column = CRITERIA[task].column
    with path.open(newline="", encoding="utf-8") as file:
        # A run may be evaluated twice at the end of a stage; the last line is used.
        lines = {int(line["steps"]): float(line[column]) for line in csv.DictReader(file)}
    steps, values = np.array(sorted(lines.items()), np.float64).T
    return steps, values


def learning_curve(runs: Learning) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The steps and, at each, the interquartile mean over the seeds with its interval.

    All runs have the same steps.
    """
    (steps,) = {tuple(steps) for steps, _ in runs.values()}
    columns = np.transpose([speeds for _, speeds in runs.values()])
    found = []
    for column in columns:
        summary = estimate(column[:, None])
        found.append((summary.value, summary.low, summary.high))
    value, low, high = np.transpose(found)
    return np.array(steps), value, low, high


def table(learning: Mapping[str, Learning]) -> str:
    """A Markdown table of the speed at the end of training, and the steps to 90 % of this speed."""
    head = ["policy", "training seeds", "steps", f"{SPEED.label} at the end"]
    lines = [[*head, "steps to 90 % of that"]]
    without = []
    for name, runs in learning.items():
        if not runs:
            without.append(name)
            continue
        steps, value, low, high = learning_curve(runs)
        end = steps[-1]
        first = steps[value >= 0.9 * value[-1]][0]
        speed = SPEED.with_interval((value[-1], low[-1], high[-1]))
        lines.append([name, str(len(runs)), f"{end:,.0f}", speed, f"{first:,.0f}"])
    text = markdown_table(lines)
    if without:
        text += f"\n\nWithout committed evaluations: {', '.join(without)}."
    return text


def draw_learning(learning: Mapping[str, Learning], label: str = SPEED.label) -> Any:
    """Draws the metric of all seeds over steps, and its interquartile mean.

    There is a panel per row of `learning`.
    """
    from matplotlib.ticker import LogLocator

    columns = min(4, len(learning))
    lines = math.ceil(len(learning) / columns)
    figure = new_figure(1.4 + 1.2 * lines)
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for axes, (name, runs) in zip(grid.flat, learning.items(), strict=False):
        axes.set_title(name, parse_math=False)
        for steps, values in runs.values():
            # A run with a single evaluation is drawn as a point.
            kind = "." if len(values) == 1 else "-"
            axes.plot(steps / 1e6, values, kind, color=MUTED, alpha=0.3)
        steps, value, low, high = learning_curve(runs)
        axes.fill_between(steps / 1e6, low, high, facecolor=BLUE, alpha=0.2)
        axes.plot(steps / 1e6, value, color=BLUE)
    axes.set_xlim(0.0, None)
    if label == SPEED.label:
        axes.set_ylim(0.0, None)
    else:
        # These fall by a factor of up to a hundred.
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
    for n in range(len(learning), grid.size):
        grid.flat[n].set_visible(False)
        # The panel above an empty place shows the tick labels instead.
        grid.flat[n - columns].tick_params(labelbottom=True)
    figure.supylabel(label, fontsize="medium")
    add_note(
        figure,
        "Horizontal: millions of agent steps. Evaluations on each run's validation plants, never "
        "on a frozen set; grey: the training seeds; blue: their interquartile mean, band: 95 %.",
    )
    return figure


def draw_transport(rows: Sequence[LeaderboardRow]) -> Any:
    """Draws speed against cost of transport on the nominal plant.

    The front is that of dynamic programming.
    """
    from matplotlib.ticker import LogLocator

    figure = new_figure(6.0)
    # Room for the labels on the right, whose width the layout underestimates.
    figure.get_layout_engine().set(rect=(0.0, 0.0, 0.985, 1.0))
    axes = figure.subplots()
    axes.plot(*zip(*optimal_front(), strict=True), ".-", color=GREEN, label="dynamic programming")
    marks, absent = [], []
    for row in rows:
        cost = estimate(row.score("nominal", "cost_of_transport"))
        speed = estimate(row.score("nominal", SPEED.name))
        if math.isfinite(cost.value):
            marks.append((cost.value, speed.value, row))
            draw_policy(axes, row, cost, speed)
        else:
            absent.append(row.name)
    axes.plot([], [], "o-", color=BLUE, label="trained, 95 % over seeds")
    axes.plot([], [], "s", color=INK, label="scripted")
    # Logarithmic: outside its training range, a policy can have thirty times the cost of the
    # others.
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    axes.set(xlabel="cost of transport", ylabel="mean speed (cm/s)")
    name_marks(axes, marks)
    # Outside: every corner inside the axes contains a front, a policy or a label's line.
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=4)
    axes.set_title("Speed against cost of transport, the paper's plant from 100 starts")
    note = (
        "Interquartile means over all episodes on nominal. Dynamic programming: with energy "
        "weights, over 33 s from one start at rest."
    )
    if absent:
        note += f" Without forward progress, and so without a cost: {', '.join(absent)}."
    add_note(figure, note)
    return figure


def name_marks(axes: Any, marks: list[tuple[float, float, LeaderboardRow]]) -> None:
    """Writes names next to the axes, the highest mark's first, with a line to each mark."""
    line = {"arrowstyle": "-", "color": FAINT, "relpos": (0.0, 0.5)}
    marks.sort(key=lambda mark: -mark[1])
    for n, (x, y, row) in enumerate(marks):
        height = 1.0 - (n + 0.5) / len(marks)
        axes.annotate(
            row.name,
            (x, y),
            xytext=(1.01, height),
            textcoords="axes fraction",
            va="center",
            color=colour_of(row),
            parse_math=False,
            arrowprops=line,
            zorder=1,
        )


def colour_of(row: LeaderboardRow) -> str:
    """The colour of a trained or scripted policy."""
    return BLUE if row.trained else INK


def draw_policy(axes: Any, row: LeaderboardRow, cost: Estimate, speed: Estimate) -> None:
    """Draws the mark of a policy, with its intervals if it is trained."""
    colour = colour_of(row)
    if row.trained and np.isfinite([cost.low, cost.high, speed.low, speed.high]).all():
        axes.plot([cost.low, cost.high], [speed.value] * 2, color=colour)
        axes.plot([cost.value] * 2, [speed.low, speed.high], color=colour)
    axes.plot(cost.value, speed.value, "o" if row.trained else "s", color=colour)
