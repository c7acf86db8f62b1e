"""Output of the rows: leaderboard.json, LEADERBOARD.md, the README's message and table, and tables
of other pages.

All depend only on the content of leaderboard.json, so that they can be checked without a
simulation.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from agents.criteria import CRITERIA, Criteria
from agents.leaderboard.rows import LeaderboardRow
from baselines.tables import markdown_table
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.evaluation.episodes import (
    LABELS,
    SHARE_OF_OPTIMUM,
    TABLE_METRICS,
    TASK_METRICS,
    summarise,
)
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.evaluation.statistics import paired_difference
from capsule_gym.files import to_json

COMMAND = "python -m agents.leaderboard"
TABLES = "docs/leaderboard_tables.md"
# The main table: its groups of rows, its sets, and the row to whose speed those of the others are
# compared.
GROUPS = {
    "Open loop": ("open-loop", "open-loop-real"),
    "The paper": ("adaptive", "feedback-linearising-optimal-profile"),
    "Simple feedback": ("pd", "oscillator", "gait-guarded", "gait-predictive"),
    "Model-based": ("lqr", "mpc", "dp-nominal", "dp-oracle"),
    "Learned": ("direct-ppo", "residual-ppo", "direct-real", "residual-real", "dp-distilled-wide"),
}
# The paper's other laws.
OTHER_LAWS = ("adaptive-as-published", "adaptive-optimal-profile", "epc", "feedback-linearising")
RANKING_SET, REAL = "paper", "real"
MAIN_SETS = (RANKING_SET, "wide", REAL, "real-wide", "sticky")
REFERENCE = "open-loop"
METRICS = {
    metric.name: metric for metric in (*TASK_METRICS, *TABLE_METRICS.values(), SHARE_OF_OPTIMUM)
}
SPEED, COST = METRICS["mean_speed"], METRICS["cost_of_transport"]
RATIO = f"ratio to {REFERENCE}"
COLUMNS = ("policy", *MAIN_SETS, RATIO, COST.label, "senses", "told")
# Columns and rows of the README's table.
HEAD_COLUMNS = ("policy", RANKING_SET, REAL, COST.label, "senses", "told")
HEAD = (
    "open-loop",
    "adaptive",
    "pd",
    "gait-predictive",
    "lqr",
    "dp-oracle",
    "direct-ppo",
    "residual-real",
)
# Tables of other pages: rows and sets.
SECTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "disturbances": (
        ("gait-predictive", "residual-real", "residual-real-wide"),
        (REAL, "real-wide"),
    ),
    "algorithms": (("direct-ppo", "direct-sac"), (RANKING_SET,)),
    "energy": (("direct-ppo", "efficient"), (RANKING_SET,)),
    "wide": (
        ("direct-ppo", "direct-ppo-wide", "gait-guarded", "dp-distilled-wide"),
        (RANKING_SET, "wide"),
    ),
    "sticky": (("sticky", "gait-guarded", "dp-oracle", "dp-distilled-wide"), ("sticky",)),
    "paper": ((*GROUPS["The paper"], *OTHER_LAWS), (RANKING_SET,)),
}
# The message: policies with perfect sensors, policies that keep their speed with real ones, and
# learned for these.
PERFECT = ("lqr", "mpc", "dp-nominal", "dp-oracle", "direct-ppo", "residual-ppo")
KEPT, LEARNED = ("lqr", "gait-predictive", "residual-real"), ("direct-real", "residual-real")
ENTRIES = ("policy", "description", "training_seeds", "revision", "files", "base", "versions")


def build(rows: Sequence[LeaderboardRow], sets: Sequence[EvaluationSet]) -> dict[str, Any]:
    """The content of leaderboard.json: sets and rows of each task, the best mean on its ranking set
    first.

    Raises:
        ValueError: if a row was evaluated on other sets.
    """
    tasks = {}
    for task in dict.fromkeys(each.task for each in sets):
        own = [each for each in sets if each.task == task]
        ranked = _ranked([row for row in rows if row.task == task], own, CRITERIA[task])
        tasks[task] = {"sets": {each.name: each.hash for each in own}, "rows": ranked}
    board = {**tasks.pop("speed", {"sets": {}, "rows": []}), "tasks": tasks}
    # Six digits; infinities become null.
    content: dict[str, Any] = json.loads(
        to_json(board), parse_float=lambda text: float(f"{float(text):.6g}")
    )
    return content


def _ranked(
    rows: Sequence[LeaderboardRow], sets: Sequence[EvaluationSet], criteria: Criteria
) -> list[dict[str, Any]]:
    """The rows of one task, the best mean on its ranking set first."""
    metric, by_name, content = criteria.metric.name, {row.name: row for row in rows}, []
    for row in rows:
        results = {}
        for each in sets:
            episodes = row.episodes(each)
            kept = [name for name in episodes[0] if name in (*METRICS, *LABELS, "failed")]
            results[each.name] = summarise(
                [{name: episode[name] for name in kept} for episode in episodes]
            )
            del results[each.name]["training_seeds"]
        entry = {name: row.header[name] for name in ENTRIES} | {"results": results}
        entry["senses"], entry["told"] = find_candidate(row.name).inputs
        if base := by_name.get(row.header["base"] or ""):
            pairs = {
                each.name: (row.score(each.name, metric), base.score(each.name, metric))
                for each in sets
            }
            entry["minus_base"] = {
                name: paired_difference(*pair, mean=True).to_dict() for name, pair in pairs.items()
            }
        content.append(entry)
    ranking, sign = criteria.ranking_set, 1.0 if criteria.ascending else -1.0
    return sorted(
        content, key=lambda row: (sign * row["results"][ranking][metric]["mean"], row["policy"])
    )


def grouped(board: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """The rows of the main table by group; the last group contains rows that are in no table of
    another page.
    """
    placed = {name for names, _ in SECTIONS.values() for name in names}.union(*GROUPS.values())
    others = {
        "Others": tuple(row["policy"] for row in board["rows"] if row["policy"] not in placed)
    }
    groups = GROUPS | others
    found = {
        title: [row for row in board["rows"] if row["policy"] in names]
        for title, names in groups.items()
    }
    return {title: rows for title, rows in found.items() if rows}


def message(board: Mapping[str, Any]) -> str:
    """The summary of the main table."""
    found = {row["policy"]: row["results"] for row in board["rows"]}

    def speeds(*names: str, on: str = RANKING_SET) -> list[float]:
        return [found[name][on][SPEED.name]["mean"] for name in names]

    (blind, paper, pd), (pd_real,) = speeds(REFERENCE, "adaptive", "pd"), speeds("pd", on=REAL)
    perfect, kept = speeds(*PERFECT), speeds(*KEPT, on=REAL)
    return (
        f"Torque as a function of time alone makes {blind:.1f} cm/s, {blind / paper:.1f} times the paper's controller; "
        f"an encoder and two gains (`pd`) make {pd:.1f}. A model, dynamic programming or learning brings "
        f"{min(perfect):.0f} to {max(perfect):.0f} with perfect sensors on the assumed plants. With real sensors most "
        f"of these fall below the PD ({pd_real:.1f}); LQR, a predictor or training under such sensors keep "
        f"{min(kept):.0f} to {max(kept):.0f}: learning is worth {min(speeds(*LEARNED, on=REAL)) - pd_real:.1f} cm/s "
        "over the PD."
    )


def _main_table(board: Mapping[str, Any], columns: Sequence[str], names: Sequence[str] = ()) -> str:
    """Some columns of all rows with lines for the titles of groups, or only of some rows."""
    speeds = {
        row["policy"]: row["results"][RANKING_SET][SPEED.name]["mean"] for row in board["rows"]
    }
    lines = [columns]
    for title, rows in grouped(board).items():
        lines += [] if names else [[f"**{title}**", *[""] * (len(columns) - 1)]]
        for row in (row for row in rows if not names or row["policy"] in names):
            cells = {"policy": row["policy"], "senses": row["senses"], "told": row["told"]}
            for name, each in row["results"].items():
                failed = f" ({each['failures']}/{each['episodes']})" if each["failures"] else ""
                cells[name] = SPEED.format(each[SPEED.name]["mean"]) + failed
            cells[RATIO] = SPEED.format(speeds[row["policy"]] / speeds[REFERENCE])
            cells[COST.label] = COST.format(row["results"][RANKING_SET][COST.name]["iqm"])
            lines.append([cells[column] for column in columns])
    return markdown_table(lines)


def _details(rows: Sequence[Mapping[str, Any]], sets: Iterable[str], criteria: Criteria) -> str:
    """A table for each set: means, worst seeds and interquartile means, and the differences to base
    laws.
    """
    tables = []
    for name in sets:
        lines = [_cells(row, name, criteria) for row in rows]
        columns = [column for column in lines[0] if any(line[column] != "-" for line in lines)]
        table = markdown_table([columns, *([line[column] for column in columns] for line in lines)])
        tables.append(f"On the set `{name}`:\n\n{table}")
    return "\n\n".join(tables)


def _cells(row: Mapping[str, Any], set_name: str, criteria: Criteria) -> dict[str, str]:
    """The cells of `_details` by column; columns without any value are omitted."""
    cells, result, seeds = (
        {"policy": row["policy"]},
        row["results"][set_name],
        len(row["training_seeds"]),
    )
    for name, weight in criteria.weights.items():
        if (metric := METRICS.get(name)) is None:
            continue
        each = result[name]
        worst = max(each["seeds"]) if weight < 0.0 else min(each["seeds"])
        cells[metric.label] = metric.with_interval(
            (each["mean"], each["mean_low"], each["mean_high"])
        )
        cells[f"worst seed ({metric.label.partition(' (')[2] or 'share)'}"] = metric.format(
            worst if seeds else None
        )
        if not metric.share:
            cells["interquartile mean"] = metric.with_interval(
                (each["iqm"], each["low"], each["high"])
            )
    base = row.get("minus_base", {}).get(set_name)
    difference = criteria.metric.with_interval(base.values(), sign=True) if base else "-"
    cells["failed"] = f"{result['failures']}/{result['episodes']}"
    cells[f"difference to base law on `{set_name}`"] = difference
    if SPEED.name in criteria.weights:
        cells[COST.label] = COST.format(result[COST.name]["iqm"])
    return {**cells, "seeds": str(seeds or "-"), "revision": row["revision"] or "-"}


def _section(name: str, text: str) -> str:
    """A text between the markers of mkdocs, by which other pages include it."""
    return f"<!-- --8<-- [start:{name}] -->\n{text}\n<!-- --8<-- [end:{name}] -->"


def files(root: Path, board: Mapping[str, Any]) -> dict[str, str]:
    """The texts of leaderboard.json, LEADERBOARD.md, the README with message and table, and tables
    of other pages.

    Raises:
        ValueError: if a marker is missing in the README.
    """
    rows, speed = [row for own in grouped(board).values() for row in own], CRITERIA["speed"]
    parts = {
        "message": _section("message", message(board)),
        "main": _main_table(board, COLUMNS),
        "details": _details(rows, (RANKING_SET, REAL), speed),
        "policies": "\n".join(f"- `{row['policy']}`: {row['description']}" for row in rows),
    }
    readme = (root / "README.md").read_text(encoding="utf-8")
    for name, text in {
        "message": message(board),
        "leaderboard": _main_table(board, HEAD_COLUMNS, HEAD),
    }.items():
        start, end = _section(name, "").split("\n\n")
        (before, first, rest), (_, last, after) = (readme.partition(start), readme.partition(end))
        if not (first and last and end in rest):
            raise ValueError(f"README.md must contain {start} and then {end}")
        readme = before + _section(name, text) + after
    tables = {
        name: _details([row for row in board["rows"] if row["policy"] in names], sets, speed)
        for name, (names, sets) in SECTIONS.items()
    }
    tables |= {
        task: _details(own["rows"], own["sets"], CRITERIA[task])
        for task, own in board["tasks"].items()
    }
    return {
        "README.md": readme,
        "leaderboard.json": to_json(board),
        "LEADERBOARD.md": Template(
            Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
        ).substitute(parts),
        TABLES: "\n\n".join(
            [f"<!-- Written by `{COMMAND}`. -->", *map(_section, tables, tables.values())]
        )
        + "\n",
    }
