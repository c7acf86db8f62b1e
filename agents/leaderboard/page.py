"""Output of the rows: leaderboard.json, LEADERBOARD.md, the README's message and table, and tables of other pages.

All depend only on the content of leaderboard.json, so that they can be checked without a simulation.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from agents.evaluation.criteria import CRITERIA, Criteria
from agents.leaderboard.rows import Row
from baselines.evaluation.episodes import LABELS, SHARE_OF_OPTIMUM, TABLE_METRICS, TASK_METRICS, TableMetric, summarise
from baselines.evaluation.policies import CHECKPOINTS, find_candidate
from baselines.evaluation.statistics import estimate, paired_difference
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.files import to_json, without_nonfinite

COMMAND = "python -m agents.leaderboard"
TABLES = "docs/leaderboard_tables.md"
# The main table: its groups of rows, its sets, and the row to whose speed those of the others are compared.
GROUPS = {
    "Open loop": ("open-loop", "open-loop-real"),
    "The paper": ("adaptive", "feedback-linearising-optimal-profile"),
    "Simple feedback": ("pd", "oscillator", "gait-guarded", "gait-predictive"),
    "Model-based": ("lqr", "mpc", "dp-nominal", "dp-oracle"),
    "Learned": ("direct-ppo", "residual-ppo", "direct-real", "residual-real", "dp-distilled-wide"),
}
RANKING_SET, REAL = "paper", "real"
MAIN_SETS = (RANKING_SET, "wide", REAL, "real-wide", "sticky")
REFERENCE = "open-loop"
METRICS = {metric.name: metric for metric in (*TASK_METRICS, *TABLE_METRICS.values(), SHARE_OF_OPTIMUM)}
SPEED, COST = METRICS["mean_speed"], METRICS["cost_of_transport"]
RATIO = f"ratio to {REFERENCE}"
COLUMNS = ("policy", *MAIN_SETS, RATIO, COST.label, "senses", "told")
# Columns and rows of the README's table.
HEAD_COLUMNS = ("policy", RANKING_SET, REAL, COST.label, "senses", "told")
HEAD = ("open-loop", "adaptive", "pd", "gait-predictive", "lqr", "dp-oracle", "direct-ppo", "residual-real")
# Tables of other pages: rows and sets.
SECTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "disturbances": (("gait-predictive", "residual-real", "residual-real-wide"), (REAL, "real-wide")),
    "algorithms": (("direct-ppo", "direct-sac"), (RANKING_SET,)),
    "energy": (("direct-ppo", "efficient"), (RANKING_SET,)),
    "wide": (("direct-ppo", "direct-ppo-wide", "gait-guarded", "dp-distilled-wide"), (RANKING_SET, "wide")),
    "sticky": (("sticky", "gait-guarded", "dp-oracle", "dp-distilled-wide"), ("sticky",)),
    "paper": (
        ("adaptive", "adaptive-as-published", "adaptive-optimal-profile", "epc", "feedback-linearising")
        + ("feedback-linearising-optimal-profile",),
        (RANKING_SET,),
    ),
}
# The message: policies with perfect sensors, policies that keep their speed with real ones, and the learned of these.
PERFECT = ("lqr", "mpc", "dp-nominal", "dp-oracle", "direct-ppo", "residual-ppo")
KEPT, LEARNED = ("lqr", "gait-predictive", "direct-real", "residual-real"), ("direct-real", "residual-real")
# A line of the table in agents/checkpoints/README.md.
TRAINED = re.compile(r"^\| `([\w-]+)` \|[^|]*\| `([^`]+)` \|$", re.MULTILINE)


def _rounded(value: Any, digits: int) -> Any:
    """Rounds the floats in nested dicts to `digits` significant digits."""
    if isinstance(value, dict):
        return {key: _rounded(entry, digits) for key, entry in value.items()}
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def training_commands() -> dict[str, str]:
    """The command that trains each checkpoint, from the table in its README."""
    path = CHECKPOINTS / "README.md"
    return dict(TRAINED.findall(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def build(rows: Sequence[Row], sets: Sequence[EvaluationSet]) -> dict[str, Any]:
    """The content of leaderboard.json: the rows of each task, the best mean on its ranking set first.

    The sets are the columns. They must include the ranking set of each task with rows.

    Raises:
        ValueError: if a row was evaluated on other sets.
    """
    versions: dict[str, set[str]] = {}
    for row in rows:
        for package, number in row.header["versions"].items():
            versions.setdefault(package, set()).add(number)
    tasks = {}
    for task in dict.fromkeys(each.task for each in sets):
        own = [each for each in sets if each.task == task]
        ranked = _ranked([row for row in rows if row.task == task], own, CRITERIA[task])
        tasks[task] = {"sets": {each.name: each.hash for each in own}, "rows": ranked}
    # If the rows were evaluated with different versions, all versions are listed.
    numbers = {package: ", ".join(sorted(found)) for package, found in versions.items()}
    return without_nonfinite({**tasks.pop("speed", {"sets": {}, "rows": []}), "versions": numbers, "tasks": tasks})


def _ranked(rows: Sequence[Row], sets: Sequence[EvaluationSet], criteria: Criteria) -> list[dict[str, Any]]:
    """The rows of one task, the best mean on its ranking set first."""
    commands, metric, by_name = training_commands(), criteria.metric.name, {row.name: row for row in rows}
    content = []
    for row in rows:
        entry = {name: row.header[name] for name in ("policy", "description", "training_seeds", "revision", "files")}
        entry |= dict(zip(("senses", "told"), find_candidate(row.name).inputs, strict=True))
        if row.trained:
            entry |= {"base": row.header["base"], "trained_by": commands.get(row.name)}
        results = {}
        for each in sets:
            kept = (*METRICS, *LABELS, "failed")
            episodes = [{name: episode[name] for name in kept if name in episode} for episode in row.episodes(each)]
            results[each.name] = summarise(episodes)
            del results[each.name]["training_seeds"]
            for name, weight in criteria.weights.items():
                if name in METRICS:
                    results[each.name][name] |= _over_seeds(row, each.name, name, ascending=weight < 0.0)
        numbers = {"results": results, "disturbed": row.header["disturbed"]}
        if base := by_name.get(row.header["base"] or ""):
            pairs = {each.name: (row.score(each.name, metric), base.score(each.name, metric)) for each in sets}
            numbers["minus_base"] = {name: paired_difference(*pair, mean=True).to_dict() for name, pair in pairs.items()}
        content.append({**entry, **_rounded(numbers, 6)})
    return sorted(
        content, key=lambda row: criteria.rank(row["results"][criteria.ranking_set][metric]["mean"], row["policy"])
    )


def _over_seeds(row: Row, set_name: str, metric: str, *, ascending: bool) -> dict[str, float]:
    """The mean of a metric over seeds and plants with its t interval, and the mean over plants of the worst seed."""
    scores = row.score(set_name, metric)
    found, seeds = estimate(scores, mean=True), scores.mean(axis=1)
    worst = float(seeds.max() if ascending else seeds.min())
    return {"mean": found.value, "mean_low": found.low, "mean_high": found.high, "worst_seed": worst}


def grouped(board: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """The rows of the main table by group; the last group contains rows that are in no table of another page."""
    placed = {name for names, _ in SECTIONS.values() for name in names}.union(*GROUPS.values())
    others = {"Others": [row["policy"] for row in board["rows"] if row["policy"] not in placed]}
    groups = {title: _chosen(board, names) for title, names in {**GROUPS, **others}.items()}
    return {title: rows for title, rows in groups.items() if rows}


def _chosen(board: Mapping[str, Any], names: Sequence[str]) -> list[Mapping[str, Any]]:
    return [row for row in board["rows"] if row["policy"] in names]


def message(board: Mapping[str, Any]) -> str:
    """The summary of the main table; NaN stands for the numbers of missing rows."""
    found = {row["policy"]: row["results"] for row in board["rows"]}

    def speeds(names: Sequence[str], on: str = RANKING_SET) -> list[float]:
        return [found[name][on][SPEED.name]["mean"] if on in found.get(name, ()) else math.nan for name in names]

    blind, paper, pd = speeds([REFERENCE, "adaptive", "pd"])
    (pd_real,), perfect, kept = speeds(["pd"], REAL), speeds(PERFECT), speeds(KEPT, REAL)
    return (
        f"Torque as a function of time alone makes {blind:.1f} cm/s, {blind / paper:.1f} times the paper's controller; an "
        f"encoder and two gains (`pd`) make {pd:.1f}. A model, dynamic programming or learning brings {min(perfect):.0f} "
        f"to {max(perfect):.0f} with perfect sensors on the assumed plants. With real sensors most of these fall below "
        f"the PD ({pd_real:.1f}); LQR, a predictor or training under such sensors keep {min(kept):.0f} to "
        f"{max(kept):.0f}: learning is worth {min(speeds(LEARNED, REAL)) - pd_real:.1f} cm/s over the PD."
    )


def _main_table(board: Mapping[str, Any], columns: Sequence[str], names: Sequence[str] = ()) -> str:
    """Some columns of all rows with lines for the titles of groups, or only of some rows."""
    speeds = {row["policy"]: row["results"][RANKING_SET][SPEED.name]["mean"] for row in board["rows"]}
    columns = [column for column in columns if column not in MAIN_SETS or column in board["sets"]]
    lines = [columns]
    for title, rows in grouped(board).items():
        lines += [] if names else [[f"**{title}**", *[""] * (len(columns) - 1)]]
        for row in (row for row in rows if not names or row["policy"] in names):
            cells = {"policy": row["policy"], "senses": row["senses"], "told": row["told"]}
            for name, each in row["results"].items():
                failed = f" ({_failures(each)})" if each["failures"] else ""
                cells[name] = SPEED.format(each[SPEED.name]["mean"]) + failed
            cells[RATIO] = SPEED.format(speeds[row["policy"]] / speeds.get(REFERENCE, math.nan))
            cells[COST.label] = COST.format(row["results"][RANKING_SET][COST.name]["iqm"])
            lines.append([cells[column] for column in columns])
    return markdown_table(lines)


def _failures(summary: Mapping[str, Any]) -> str:
    return f"{summary['failures']}/{summary['episodes']}"


def _interval(metric: TableMetric, summary: Mapping[str, Any], *keys: str, sign: bool = False) -> str:
    """Formats a value and the ends of its interval; the only possible line break is between the two."""
    value, low, high = (metric.format(summary[key], sign=sign) for key in keys)
    return f"{value} [{low},\N{NO-BREAK SPACE}{high}]"


def _details(rows: Sequence[Mapping[str, Any]], sets: Iterable[str], criteria: Criteria) -> str:
    """A table for each set: means, worst seeds and interquartile means, and the differences to base laws."""
    metrics, tables = [METRICS[name] for name in criteria.weights if name in METRICS], []
    costs = [COST] if SPEED in metrics else []
    for name in sets:
        columns = [each for metric in metrics for each in (metric.label, "worst seed", "interquartile mean")]
        columns += [*(metric.label for metric in costs), "failed", f"difference to base law on `{name}`"]
        lines = [["policy", *columns, "seeds", "revision"]]
        for row in (row for row in rows if name in row["results"]):
            result, seeds, cells = row["results"][name], len(row["training_seeds"]), [row["policy"]]
            for metric in metrics:
                each = result[metric.name]
                middle = "-" if metric.share else _interval(metric, each, "iqm", "low", "high")
                worst = metric.format(each["worst_seed"] if seeds else None)
                cells += [_interval(metric, each, "mean", "mean_low", "mean_high"), worst, middle]
            base = row.get("minus_base", {}).get(name)
            difference = _interval(criteria.metric, base, "mean", "low", "high", sign=True) if base else "-"
            cells += [*(metric.format(result[metric.name]["iqm"]) for metric in costs), _failures(result), difference]
            lines.append([*cells, str(seeds or "-"), row["revision"] or "-"])
        # A column without any value is omitted.
        kept = [n for n in range(len(lines[0])) if any(line[n] != "-" for line in lines[1:])]
        tables.append(f"On the set `{name}`:\n\n{markdown_table([[line[n] for n in kept] for line in lines])}")
    return "\n\n".join(tables)


def _section(name: str, text: str) -> str:
    """A text between the markers of mkdocs, by which other pages include it."""
    return f"<!-- --8<-- [start:{name}] -->\n{text}\n<!-- --8<-- [end:{name}] -->"


def files(root: Path, board: Mapping[str, Any]) -> dict[str, str]:
    """The texts of leaderboard.json, LEADERBOARD.md, the README with message and table, and tables of other pages.

    Raises:
        ValueError: if a marker is missing in the README.
    """
    rows, speed = [row for own in grouped(board).values() for row in own], CRITERIA["speed"]
    hashes = {name: value for each in (board, *board["tasks"].values()) for name, value in each["sets"].items()}
    parts = {
        "message": _section("message", message(board)),
        "main": _main_table(board, COLUMNS),
        "details": _details(rows, (RANKING_SET, REAL), speed),
        "policies": "\n".join(f"- `{row['policy']}`: {row['description']}" for row in rows),
        "hashes": ", ".join(f"`{name}` {value[:12]}" for name, value in hashes.items()),
        "versions": ", ".join(f"{name} {value}" for name, value in board["versions"].items()),
    }
    readme = (root / "README.md").read_text(encoding="utf-8")
    for name, text in {"message": message(board), "leaderboard": _main_table(board, HEAD_COLUMNS, HEAD)}.items():
        start, end = _section(name, "").split("\n\n")
        found = re.compile(f"{re.escape(start)}.*?{re.escape(end)}", re.DOTALL)
        if not found.search(readme):
            raise ValueError(f"README.md must contain {start} and then {end}")
        readme = found.sub(lambda _, name=name, text=text: _section(name, text), readme)
    tables = {name: _details(_chosen(board, names), sets, speed) for name, (names, sets) in SECTIONS.items()}
    tables |= {task: _details(own["rows"], own["sets"], CRITERIA[task]) for task, own in board["tasks"].items()}
    return {
        "README.md": readme,
        "leaderboard.json": to_json(board),
        "LEADERBOARD.md": Template(Path(__file__).with_suffix(".md").read_text(encoding="utf-8")).substitute(parts),
        TABLES: "\n\n".join([f"<!-- Written by `{COMMAND}`; do not edit. -->", *map(_section, tables, tables.values())]),
    }
