"""The page of a report, one self-contained HTML file, and the comparison at the end of training."""

from __future__ import annotations

import base64
import html
import io
import json
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tabulate import tabulate

from agents.analysis.data import Learning, Results, gather, read_evaluations, read_learning
from agents.analysis.figures import draw_learning, draw_profiles, draw_transport, panels
from agents.analysis.recording import draw_comparison, record
from agents.evaluate import comparison_table
from agents.evaluation.criteria import CRITERIA
from agents.evaluation.episodes import SHARE_OF_OPTIMUM, TABLE_METRICS, TASK_METRICS, TableMetric, evaluate
from agents.evaluation.policies import CHECKPOINTS, Candidate, all_candidates, find_candidate
from agents.leaderboard.page import build, rows_of
from agents.leaderboard.rows import RESULTS, Row, evaluate_run, load_row, make_row, path_of
from agents.report import COMMAND
from agents.training.config import BEST, EVALUATIONS, MODEL
from baselines.drawing import DPI, VERMILION, add_note, style
from capsule_gym.config import find_task
from capsule_gym.evaluation_sets import NOMINAL_PLANT, SET_NAMES, TASK_SET_NAMES, EvaluationSet, load_set
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY
from capsule_gym.rendering import write_gif
from capsule_gym.task import CONTROL_DT

ROOT = Path(__file__).resolve().parents[2]
# File in the run's folder, written by `compare`; start and length of the part of the episode that it shows, s.
ANIMATION = "animation.gif"
ANIMATION_START, ANIMATION_SECONDS = 10.0, 6.0


class Data(NamedTuple):
    """The data of a report: the rows, the entries of leaderboard.json by row and set, and GIFs by the row's name."""

    results: Results
    summaries: dict[str, dict[str, Any]]
    animations: dict[str, bytes]

    @property
    def subjects(self) -> list[Row]:
        """The rows of the report: all but the baseline, or the baseline if there is no other row."""
        rows, baseline = self.results.rows, self.results.criteria.baseline
        return [row for row in rows if row.name != baseline] or list(rows)


def collect(names: Sequence[str], *, trust_controller: bool = False, trust_pickle: bool = False) -> Data:
    """Reads the rows of the leaderboard, and evaluates other runs.

    Args:
        names: rows of the leaderboard, or paths of runs, of folders with runs seed-0, seed-1, .. inside, or of policy
            files; if empty, all rows.
        trust_controller: as for `capsule_gym.load_policy`.
        trust_pickle: allow to unpickle an agent with an LSTM, which can run any code.

    Raises:
        OSError: if a file cannot be read.
        ValueError: if a policy does not exist, two policies have the same name, or a file is broken.
    """
    board = json.loads((ROOT / "leaderboard.json").read_text(encoding="utf-8"))
    found = [_candidate(name, trust_controller, trust_pickle) for name in names]
    task = found[0].task if found else "speed"
    if others := [each.name for each in found if each.task != task]:
        raise ValueError(
            f"policies of a report must be for the same task, got {found[0].name} for {task} and {others[0]}"
        )
    published = {row["policy"]: row["results"] for row in rows_of(board, task)}
    sets = [each for each in map(load_set, SET_NAMES + TASK_SET_NAMES) if each.task == task]
    rows: list[Row] = []
    curves: dict[str, Learning] = {}
    animations: dict[str, bytes] = {}
    baseline = find_candidate(CRITERIA[task].baseline)
    given = dict(zip(names, found, strict=True)) or {each.name: each for each in all_candidates()}
    for name, candidate in {**given, baseline.name: baseline}.items():
        if name in published:
            rows.append(load_row(path_of(ROOT / RESULTS, name)))
            continue
        path = Path(name)
        row = make_row(candidate, sets, [evaluate_run(policy, sets) for policy in candidate.policies])
        # A recurrent policy has no policy file with its seed.
        seeds = row.header["training_seeds"] or list(range(len(candidate.policies)))
        rows.append(replace(row, header={**row.header, "training_seeds": seeds}))
        one = path / EVALUATIONS
        if learning := {0: read_evaluations(one, task)} if one.is_file() else read_learning(path, task):
            curves[row.name] = learning
        if (path / ANIMATION).is_file():
            animations[row.name] = (path / ANIMATION).read_bytes()
    twins = [name for name, count in Counter(row.name for row in rows).items() if count > 1]
    if twins:
        raise ValueError(f"policies of a report must have different names, got {', '.join(twins)} more than once")
    results = gather(rows, sets, CHECKPOINTS, task)
    own = build([row for row in rows if row.name not in published], sets)
    summaries = published | {row["policy"]: row["results"] for row in rows_of(own, task)}
    return Data(replace(results, learning=results.learning | curves), summaries, animations)


def _candidate(name: str, trust_controller: bool, trust_pickle: bool) -> Candidate:
    """Finds a policy by its name, or by the path of a run, whose last part becomes its name."""
    path = Path(name)
    if (path / BEST / MODEL).is_file() and not (path / BEST / POLICY).is_file():
        if not trust_pickle:
            raise ValueError(
                f"{path} contains an agent with an LSTM, and unpickling it can run any code; --trust-pickle allows it"
            )
        # Imported here, since torch takes seconds to import.
        from agents.training.export import load_best

        return Candidate(path.name, (load_best(path),), "a recurrent agent")
    return replace(find_candidate(name, trust_controller=trust_controller), name=path.resolve().name)


def write(path: Path, names: Sequence[str] = (), *, trust_controller: bool = False, trust_pickle: bool = False) -> None:
    """Writes the report of policies, atomically; arguments and errors are those of `collect`."""
    data = collect(names, trust_controller=trust_controller, trust_pickle=trust_pickle)
    title = ", ".join(row.name for row in data.subjects) if names else "Leaderboard of capsule_gym"
    write_atomically(path, render(data, title))


def render(data: Data, title: str) -> str:
    """Renders the page as HTML."""
    results, metric = data.results, data.results.criteria.metric
    speed = results.task == "speed"
    plant = " on the nominal plant" if speed else ""
    profiled = " and ".join(results.shown_sets)
    constant = [each for each in results.sets if not any(plant.changes for plant in each.plants)]
    drawn = ", ".join(each.name for each in constant)
    name, chosen = results.criteria.baseline, results.criteria.ranking_set
    baseline = f"{name} on the set {chosen}", data.summaries[name][chosen][metric.name]["iqm"]
    versions = ", ".join(f"{name} {number}" for name, number in results.rows[0].header["versions"].items())
    hashes = ", ".join(f"{each.name} {each.hash[:12]}" for each in results.sets)
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        f"<p>{_sentence(data, data.subjects[0])}</p>",
        *(_image(f"{name} in motion{plant}", "gif", content) for name, content in data.animations.items()),
        _figure("Learning curve on validation plants", draw_learning, results.learning, metric, baseline)
        if results.learning
        else "",
        f"<h2>Evaluation sets</h2>\n{_tables(data)}",
        _figure("Speed against cost of transport on nominal", draw_transport, results.rows) if speed else "",
        _figure(f"Performance profile on {profiled}", draw_profiles, results.rows, results.shown_sets) if speed else "",
        _figure(f"Every plant of {drawn}", draw_plants, results.rows, constant, metric),
        "<footer><p>Numbers are interquartile means with 95 % intervals, for other training runs, where there are "
        "several, on other plants; shares are means. The mean speed of a failed episode is its distance over "
        f"the episode's whole length. Written by <code>{COMMAND}</code> with {html.escape(versions)}. "
        f"Sets: {hashes}.</p></footer>",
    ]
    body = "\n".join(part for part in parts if part)
    css = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>\n{css}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def draw_plants(rows: Sequence[Row], sets: Sequence[EvaluationSet], metric: TableMetric) -> Any:
    """Draws a metric on every plant of sets with constant parameters, and marks failed episodes."""
    M, mu = (np.array([getattr(plant, name) for each in sets for plant in each.plants]) for name in ("M", "mu"))
    values, failed = (
        {row.name: np.concatenate([row.score(each.name, name).mean(axis=0) for each in sets]) for row in rows}
        for name in (metric.name, "failed")
    )
    top = max(1e-9, *(float(each.max()) for each in values.values()))
    figure, places = panels(list(values), 1.2, columns=3, height=1.7)
    used = []
    for name, axes in zip(values, places, strict=False):
        marks = axes.scatter(M, mu, c=values[name], s=9.0, vmin=0.0, vmax=top, linewidths=0.0)
        lost = failed[name] > 0.0
        axes.plot(M[lost], mu[lost], "x", color=VERMILION, markersize=4.5, markeredgewidth=0.9)
        axes.set_yscale("log")
        used.append(axes)
    figure.colorbar(marks, ax=used, aspect=30.0).set_label(metric.label)
    figure.supylabel("friction coefficient μ", fontsize=8.0)
    add_note(
        figure,
        "Horizontal: mass of the platform M (kg). A point per episode, averaged over the training seeds. A cross: an "
        "episode that failed with at least one of them.",
    )
    return figure


def _sentence(data: Data, row: Row) -> str:
    """The description of a policy, its metric next to the baseline's, and its failure rate on each set."""
    criteria = data.results.criteria
    metric, chosen = criteria.metric, criteria.ranking_set
    own, theirs = (data.summaries[name][chosen] for name in (row.name, criteria.baseline))
    values = [metric.with_interval(each[metric.name]) for each in (own, theirs)]
    failures = ", ".join(
        f"{each['failures']} of {each['episodes']} on <code>{name}</code>"
        for name, each in data.summaries[row.name].items()
    )
    description = re.sub("`([^`]+)`", r"<code>\1</code>", html.escape(row.header["description"]))
    return (
        f"<strong>{html.escape(row.name)}</strong> ({description}): {metric.label} {values[0]} on the set "
        f"<code>{chosen}</code>, where <code>{criteria.baseline}</code> has {values[1]}. Failed episodes: {failures}."
    )


def _image(heading: str, kind: str, content: bytes) -> str:
    """An embedded image with a heading."""
    source = f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
    return f'<h2>{html.escape(heading)}</h2>\n<img class="{kind}" src="{source}" alt="{html.escape(heading)}">'


def _figure(heading: str, draw: Callable[..., Any], *arguments: Any) -> str:
    content = io.BytesIO()
    with style():
        draw(*arguments).savefig(content, format="png", dpi=DPI)
    return _image(heading, "png", content.getvalue())


def _tables(data: Data) -> str:
    """All metrics of all policies, one table per set."""
    shown = [summary for each in data.summaries.values() for summary in each.values()]
    every = (*TASK_METRICS, *TABLE_METRICS.values(), SHARE_OF_OPTIMUM)
    metrics = [metric for metric in every if any(metric.name in summary for summary in shown)]
    tables = []
    for name in (each.name for each in data.results.sets):
        rows = [["policy", "failed", *(each.label for each in metrics)]]
        for row in data.results.rows:
            summary = data.summaries[row.name][name]
            cells = [
                metric.with_interval(summary[metric.name]) if metric.name in summary else "-" for metric in metrics
            ]
            rows.append([row.name, f"{summary['failures']}/{summary['episodes']}", *cells])
        table = tabulate(rows, headers="firstrow", tablefmt="html", disable_numparse=True, stralign="right")
        tables.append(f'<h3>{name}</h3>\n<div class="wide">\n{table}\n</div>')
    return "\n".join(tables)


def compare(run: Path, set_name: str | None = None) -> None:
    """Evaluates a run's best model and the baseline on the same frozen episodes; prints and draws the comparison.

    Writes comparison.png, animation.gif and report.html to the run's folder. The default set is the task's ranking set.
    """
    # Imported here, since torch takes seconds to import.
    from agents.training.export import load_best

    policy = load_best(run)
    criteria = CRITERIA[policy.env_kwargs.get("task", "speed")]
    evaluation_set, (baseline,) = load_set(set_name or criteria.ranking_set), find_candidate(criteria.baseline).policies
    own, theirs = (evaluate(each, evaluation_set) for each in (policy, baseline))
    seconds = find_task(evaluation_set.task).episode_steps * CONTROL_DT
    print(f"\nOn the set {evaluation_set.name} ({len(own)} episodes of {seconds:g} s, the same for both):\n")
    print(comparison_table("agent", own, criteria.baseline, theirs) + "\n")
    print("Drawing, and evaluating the agent on every set for its report, takes some seconds.\n", flush=True)
    speed = evaluation_set.task == "speed"
    plant, start = (NOMINAL_PLANT, ANIMATION_START) if speed else (evaluation_set.plants[0], 0.0)
    recordings = [record(baseline, plant, seconds=seconds), record(policy, plant, seconds=seconds, name="agent")]
    draw_comparison(recordings, run / "comparison.png", plant)
    moving = record(policy, plant, seconds=start + ANIMATION_SECONDS, frames_from=start, name="agent")
    if moving.frames:
        write_gif(moving.frames, run / ANIMATION)
    write(run / "report.html", [str(run)], trust_controller=True, trust_pickle=True)
    for what, name in {"Figure": "comparison.png", "Animation": ANIMATION, "Report": "report.html"}.items():
        print(f"{what + ':':10} {run / name}")
