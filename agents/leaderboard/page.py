"""Output of the rows: leaderboard.json, LEADERBOARD.md and the table in the README.

Both texts depend only on the content of leaderboard.json, so that they can be checked without a simulation.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from agents.evaluation.criteria import CRITERIA
from agents.leaderboard.rows import Row
from baselines.evaluation.episodes import LABELS, SHARE_OF_OPTIMUM, TABLE_METRICS, TASK_METRICS, TableMetric, summarise
from baselines.evaluation.policies import BASELINE, CHECKPOINTS
from baselines.evaluation.statistics import paired_difference
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import FURTHER_SET_NAMES, EvaluationSet
from capsule_gym.files import to_json, without_nonfinite

RANKING_SET = "paper"
# Sets in the README's table, and the number of fastest policies on each set that it contains.
HEAD_SETS = {RANKING_SET: 11, "real": 3, "sticky": 3}
# Metrics for the further sets of the speed task.
BRIEF = ("mean_speed", "stuck_fraction", "share_of_optimum")
COMMAND = "python -m agents.leaderboard"
# Markers in the syntax of mkdocs; docs/index.md includes the text between them.
START, END = "<!-- --8<-- [start:leaderboard] -->", "<!-- --8<-- [end:leaderboard] -->"
# A line of the table in agents/checkpoints/README.md.
TRAINED = re.compile(r"^\| `([\w-]+)` \|[^|]*\| `([^`]+)` \|$", re.MULTILINE)

RATIO = TableMetric("ratio", f"x {BASELINE}", 2)
# The fastest policy of the paper's method: the paper's law and family of profiles, with other times.
BEST_OF_PAPER = "feedback-linearising-optimal-profile"
SPEED, COST, TORQUE = (TABLE_METRICS[name] for name in ("mean_speed", "cost_of_transport", "rms_torque"))
# Columns of tables: keys of the cells (`_cells`) by header.
POLICY = {"policy": "policy"}
# Narrow enough for a phone.
RANKING = {
    "": "place",
    **POLICY,
    "cm/s [95 %]": SPEED.name,
    "minus base": f"minus base {RANKING_SET}",
    RATIO.label: "ratio",
    "of optimum": f"share {RANKING_SET}",
    "CoT": "cost",
    "failed": f"failures {RANKING_SET}",
}
SENSITIVITY = {**POLICY, f"lowest {SPEED.label}": "low", "highest": "high", "width": "width"}


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
    """The content of leaderboard.json: the rows of each task, the best on its ranking set first.

    The sets are the columns. They must include the ranking set of each task with rows.

    Raises:
        ValueError: if a row was evaluated on other sets.
    """
    by_task = {each.task: [other for other in sets if other.task == each.task] for each in sets}
    versions: dict[str, set[str]] = {}
    for row in rows:
        for package, number in row.header["versions"].items():
            versions.setdefault(package, set()).add(number)
    tasks = {
        task: {
            "sets": {each.name: each.hash for each in own},
            "rows": _ranked([row for row in rows if row.task == task], own, task),
        }
        for task, own in by_task.items()
    }
    board = {
        "sets": {each.name: each.hash for each in sets if each.task == "speed"},
        # If the rows were evaluated with different versions, all versions are listed.
        "versions": {package: ", ".join(sorted(numbers)) for package, numbers in versions.items()},
        "rows": tasks.pop("speed", {}).get("rows", []),
        "tasks": tasks,
    }
    return without_nonfinite(board)


def _ranked(rows: Sequence[Row], sets: Sequence[EvaluationSet], task: str) -> list[dict[str, Any]]:
    """The rows of one task, the best on its ranking set first; a row that does not improve on its base is below it."""
    commands, criteria = training_commands(), CRITERIA[task]
    ranking, metric, by_name = criteria.ranking_set, criteria.metric.name, {row.name: row for row in rows}
    of_task = [metric.name for metric in TASK_METRICS]
    shown = (*of_task, *TABLE_METRICS, SHARE_OF_OPTIMUM.name, "episodes", "failures")
    content = []
    for row in rows:
        entry = {name: row.header[name] for name in ("policy", "description", "training_seeds", "revision", "files")}
        if row.trained:
            entry |= {"base": row.header["base"], "trained_by": commands.get(row.name)}
        summaries = {}
        for each in sets:
            names = BRIEF if each.name in FURTHER_SET_NAMES else shown
            episodes = row.episodes(each)
            kept = [name for name in episodes[0] if name in (*names, *LABELS, "failed")]
            summaries[each.name] = summarise([{name: episode[name] for name in kept} for episode in episodes])
        results = {name: {key: each[key] for key in shown if key in each} for name, each in summaries.items()}
        numbers = {"results": results, "disturbed": row.header["disturbed"]}
        if base := by_name.get(row.header["base"] or ""):
            pairs = {each.name: (row.score(each.name, metric), base.score(each.name, metric)) for each in sets}
            numbers["minus_base"] = {name: paired_difference(*pair).to_dict() for name, pair in pairs.items()}
        content.append({**entry, **_rounded(numbers, 6)})
    ranks = {row["policy"]: criteria.rank(row["results"][ranking][metric]["iqm"], row["policy"]) for row in content}

    def place(row: Mapping[str, Any]) -> tuple[tuple[float, str], ...]:
        own, gain = (ranks[row["policy"]],), row.get("minus_base", {}).get(ranking)
        if gain is None or (gain["high"] < 0.0 if criteria.ascending else gain["low"] > 0.0):
            return own
        return max(own, (ranks[row["base"]], *own))

    return sorted(content, key=place)


def _interval(metric: TableMetric, summary: Mapping[str, Any]) -> str:
    """Formats a metric with its interval; the only possible line break is between the two."""
    return metric.with_interval(summary[metric.name]).replace(", ", ",\N{NO-BREAK SPACE}")


def _difference(row: Mapping[str, Any], set_name: str) -> str:
    """The difference between a row and its base on a set, with its interval."""
    found = row.get("minus_base", {}).get(set_name)
    return SPEED.with_interval(found, sign=True).replace(", ", ",\N{NO-BREAK SPACE}") if found else "-"


def _cells(row: Mapping[str, Any], place: int, baseline: float, best: float) -> dict[str, str]:
    """The texts of all cells of a row of leaderboard.json, by the keys used in the tables.

    `baseline` and `best` are the speeds of the paper's controller and of its method's fastest policy, in cm/s.
    """
    summary, disturbed = row["results"][RANKING_SET], row["disturbed"]
    width = SPEED.format(disturbed["high"] - disturbed["low"])
    cells = {
        "place": str(place),
        "policy": row["policy"],
        "ratio": RATIO.format(summary["mean_speed"]["iqm"] / baseline if baseline > 0.0 else None),
        "torque": TORQUE.format(summary["rms_torque"]["iqm"]),
        "cost": COST.format(summary["cost_of_transport"]["iqm"]),
        "training_seeds": str(len(row["training_seeds"]) or "-"),
        "revision": f"`{row['revision']}`" if row["revision"] else "-",
        "best ratio": RATIO.format(summary["mean_speed"]["iqm"] / best if best > 0.0 else None),
        "low": SPEED.format(disturbed["low"]),
        "high": SPEED.format(disturbed["high"]),
        "width": width if float(width) else f"< {0.5 * 10.0**-SPEED.digits:g}",
        **{name: _interval(metric, summary) for name, metric in TABLE_METRICS.items()},
    }
    for name, each in row["results"].items():
        share, counts = 100.0 * each["failures"] / each["episodes"], f"{each['failures']}/{each['episodes']}"
        rounded = f"{share:.0f}" if share >= 1.0 else "<\N{NO-BREAK SPACE}1"
        cells |= {
            f"failures {name}": counts,
            # Gives a dash on sets that the table of optima does not cover.
            f"share {name}": SHARE_OF_OPTIMUM.format(each.get(SHARE_OF_OPTIMUM.name, {}).get("iqm")),
            f"speed {name}": SPEED.format(each["mean_speed"]["iqm"])
            + (f" ({rounded}\N{NO-BREAK SPACE}%)" if share else ""),
            f"minus base {name}": _difference(row, name),
            f"interval {name}": _interval(SPEED, each) + (f", {counts} failed" if share else ""),
        }
    return cells


def _all_cells(board: Mapping[str, Any]) -> list[dict[str, str]]:
    """The texts of all cells of leaderboard.json, row by row."""
    speeds = {row["policy"]: row["results"][RANKING_SET]["mean_speed"]["iqm"] for row in board["rows"]}
    references = [speeds.get(name, 0.0) for name in (BASELINE, BEST_OF_PAPER)]
    return [_cells(row, n, *references) for n, row in enumerate(board["rows"], start=1)]


def _table(rows: Sequence[Mapping[str, str]], columns: Mapping[str, str]) -> str:
    """A Markdown table; `columns` maps headers to keys of the cells."""
    return markdown_table([[*columns], *([row[key] for key in columns.values()] for row in rows)])


def render(board: Mapping[str, Any]) -> str:
    """Renders LEADERBOARD.md from page.md and the content of leaderboard.json."""
    rows, cells, sets = board["rows"], _all_cells(board), board["sets"]
    of_tasks = {task: each["rows"] for task, each in board["tasks"].items()}
    hashes = {name: value for each in (board, *board["tasks"].values()) for name, value in each["sets"].items()}
    details = {metric.label: name for name, metric in TABLE_METRICS.items() if metric != SPEED}
    shared = [name for name in sets if any(SHARE_OF_OPTIMUM.name in row["results"][name] for row in rows)]
    every = [row for each in (rows, *of_tasks.values()) for row in each]
    trained_by = [f". Trained by `{row['trained_by']}`" if row.get("trained_by") else "" for row in every]
    policies = [f"- `{row['policy']}`: {row['description']}{by}" for row, by in zip(every, trained_by, strict=True)]
    parts = {
        "ranking": _table(cells, RANKING),
        "details": _table(cells, {**POLICY, **details, "training seeds": "training_seeds", "revision": "revision"}),
        "sets": _table(cells, {**POLICY, **{name: f"speed {name}" for name in sets}}),
        "intervals": _table(cells, {**POLICY, **{name: f"interval {name}" for name in sets}}),
        "shares": _table(cells, {**POLICY, **{name: f"share {name}" for name in shared}}),
        "differences": _table(
            [each for each, row in zip(cells, rows, strict=True) if "minus_base" in row],
            {**POLICY, **{name: f"minus base {name}" for name in sets}},
        ),
        "sensitivity": _table(cells, SENSITIVITY),
        "policies": "\n".join(policies),
        "hashes": ", ".join(f"`{name}` {value[:12]}" for name, value in hashes.items()),
        "versions": ", ".join(f"{name} {value}" for name, value in board["versions"].items()),
    }
    parts |= {task: _task_tables(of_tasks.get(task, [])) for task in CRITERIA if task != "speed"}
    return Template(Path(__file__).with_suffix(".md").read_text(encoding="utf-8")).substitute(parts)


def _task_tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows of another task than speed, one table per set."""
    tables = []
    for name in rows[0]["results"] if rows else ():
        metrics = [metric for metric in TASK_METRICS if metric.name in rows[0]["results"][name]]
        lines = [["policy", *(metric.label for metric in metrics), "failed", "training seeds", "revision"]]
        for row in rows:
            result = row["results"][name]
            values = [_interval(metric, result) for metric in metrics]
            seeds, revision = len(row["training_seeds"]) or "-", f"`{row['revision']}`" if row["revision"] else "-"
            lines.append([row["policy"], *values, f"{result['failures']}/{result['episodes']}", str(seeds), revision])
        tables.append(f"On the set `{name}`:\n\n{markdown_table(lines)}")
    return "\n\n".join(tables)


def head(board: Mapping[str, Any]) -> str:
    """The README's Markdown table: the fastest policies on some sets, the baseline, and the paper's best policy."""
    shown, speeds = {BASELINE, BEST_OF_PAPER}, {f"{RANKING_SET} (cm/s) [95 %]": SPEED.name}
    for name, count in HEAD_SETS.items():
        if name in board["sets"]:
            ranked = sorted(board["rows"], key=lambda row: -row["results"][name]["mean_speed"]["iqm"])
            shown |= {row["policy"] for row in ranked[:count]}
            speeds |= {} if name == RANKING_SET else {f"{name} (cm/s)": f"speed {name}"}
    columns = {
        **{**POLICY, **speeds, "minus base": f"minus base {RANKING_SET}", RATIO.label: "ratio"},
        **{"x the paper's best": "best ratio", COST.label: "cost", TORQUE.label: "torque"},
        "failures": f"failures {RANKING_SET}",
    }
    return _table([each for each in _all_cells(board) if each["policy"] in shown], columns)


def files(root: Path, board: Mapping[str, Any]) -> dict[str, str]:
    """The texts of leaderboard.json, LEADERBOARD.md and the README, which contains the table between its markers.

    Raises:
        ValueError: if a marker is missing in the README.
    """
    before, start, rest = (root / "README.md").read_text(encoding="utf-8").partition(START)
    _, end, after = rest.partition(END)
    if not (start and end):
        raise ValueError(f"README.md must contain {START} and then {END}")
    readme = f"{before}{START}\n{head(board)}\n{END}{after}"
    return {"README.md": readme, "leaderboard.json": to_json(board), "LEADERBOARD.md": render(board)}
