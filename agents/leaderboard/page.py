"""Output of the rows: leaderboard.json, LEADERBOARD.md, the README, and tables of other pages.

All depend only on the content of leaderboard.json, so that they can be checked without a
simulation.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
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
    Episode,
    TableMetric,
    summarise,
)
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.evaluation.statistics import (
    CONFIDENCE,
    adjust,
    lowest_decile,
    paired_difference,
    share,
)
from capsule_gym.files import to_json

# The content of leaderboard.json, and one of its rows.
Board = Mapping[str, Any]
Row = Mapping[str, Any]
COMMAND = "python -m agents.leaderboard"
TABLES = "docs/leaderboard_tables.md"
# The main table: its groups of rows, its sets, and the row to whose speed those of the others are
# compared.
GROUPS = {
    "Open loop": ("open-loop", "open-loop-real"),
    "The paper": ("adaptive", "feedback-linearising-optimal-profile"),
    "Simple feedback": ("pd", "oscillator", "gait-guarded", "gait-predictive"),
    "Model-based": ("lqr", "mpc", "dp-nominal", "dp-oracle"),
    "Learned": (
        "direct-ppo",
        "residual-ppo",
        "residual-real",
        "dp-distilled-wide",
        "dp-distilled",
        "dp-distilled-real",
    ),
}
# The paper's other laws.
OTHER_LAWS = ("adaptive-as-published", "adaptive-optimal-profile", "epc", "feedback-linearising")
RANKING_SET = "paper"
REAL = "real"
DETAILED_SETS = (RANKING_SET, REAL)
MAIN_SETS = (RANKING_SET, "wide", REAL, "real-wide", "sticky")
REFERENCE = "open-loop"
METRICS = {
    metric.name: metric for metric in (*TASK_METRICS, *TABLE_METRICS.values(), SHARE_OF_OPTIMUM)
}
SPEED = METRICS["mean_speed"]
COST = METRICS["cost_of_transport"]
RATIO = f"ratio to {REFERENCE}"
FAILED = "failed [%, Wilson]"
DECILE = "lowest_decile"
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
    "dp-distilled",
)
# Tables of other pages: rows and sets.
SECTIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "disturbances": (
        ("gait-predictive", "residual-real", "dp-distilled", "dp-distilled-real"),
        (REAL, "real-wide"),
    ),
    "algorithms": (("direct-ppo", "direct-sac"), (RANKING_SET,)),
    "recurrent": (("direct-ppo-wide", "direct-recurrent-ppo"), ("wide",)),
    "energy": (("direct-ppo", "efficient"), (RANKING_SET,)),
    "distilled": (
        ("dp-oracle", "gait-guarded", "direct-ppo-wide", "dp-distilled-wide", "dp-distilled"),
        (RANKING_SET, "sticky"),
    ),
    "paper": ((*GROUPS["The paper"], *OTHER_LAWS), (RANKING_SET,)),
}
# Policies that the message names: fast with perfect sensors, and faster than the PD with real ones,
# the slowest first.
PERFECT = ("lqr", "mpc", "dp-nominal", "dp-oracle", "direct-ppo", "residual-ppo")
KEPT = ("lqr", "residual-real", "dp-distilled", "dp-distilled-real")
ENTRIES = ("policy", "description", "training_seeds", "revision", "files", "base", "versions")


def build(rows: Sequence[LeaderboardRow], sets: Sequence[EvaluationSet]) -> dict[str, Any]:
    """The content of leaderboard.json: sets and rows of each task, ranked.

    Raises:
        ValueError: if a row was evaluated on other sets.
    """
    tasks: dict[str, dict[str, Any]] = {}
    for task in dict.fromkeys(each.task for each in sets):
        own_sets = [each for each in sets if each.task == task]
        own_rows = [row for row in rows if row.task == task]
        tasks[task] = {
            "sets": {each.name: each.hash for each in own_sets},
            "rows": _ranked(own_rows, own_sets, CRITERIA[task]),
        }
    board = tasks.pop("speed", {"sets": {}, "rows": []})
    board["tasks"] = tasks
    board["comparisons"] = _comparisons(rows)
    # Infinities become null.
    text = to_json(board)
    content: dict[str, Any] = json.loads(text, parse_float=_six_digits)
    return content


def _comparisons(rows: Sequence[LeaderboardRow]) -> dict[str, Any]:
    """The number of pairs of rows of the main table, and those that do not differ in mean speed."""
    names = {name for group in GROUPS.values() for name in group}
    pairs = list(combinations([row for row in rows if row.name in names], 2))
    compared = [(set_name, *pair) for set_name in DETAILED_SETS for pair in pairs]
    p_values = []
    for set_name, first, second in compared:
        both = [row.score(set_name, SPEED.name) for row in (first, second)]
        p_values.append(paired_difference(*both, mean=True).p_value)
    undecided: dict[str, dict[str, list[str]]] = {set_name: {} for set_name in DETAILED_SETS}
    for (set_name, first, second), p_value in zip(compared, adjust(p_values), strict=True):
        if p_value >= 1.0 - CONFIDENCE:
            undecided[set_name].setdefault(first.name, []).append(second.name)
    return {"pairs": len(compared), "undecided": undecided}


def _six_digits(text: str) -> float:
    """Reads a number with six significant digits."""
    return float(f"{float(text):.6g}")


def _ranked(
    rows: Sequence[LeaderboardRow], sets: Sequence[EvaluationSet], criteria: Criteria
) -> list[dict[str, Any]]:
    """The rows of one task, the best mean on its ranking set first."""
    metric = criteria.metric.name
    by_name = {row.name: row for row in rows}
    entries = [_entry(row, by_name.get(row.header["base"]), sets, metric) for row in rows]
    sign = 1.0 if criteria.ascending else -1.0

    def rank(entry: Row) -> tuple[float, str]:
        mean = entry["results"][criteria.ranking_set][metric]["mean"]
        return sign * mean, entry["policy"]

    return sorted(entries, key=rank)


def _entry(
    row: LeaderboardRow, base: LeaderboardRow | None, sets: Sequence[EvaluationSet], metric: str
) -> dict[str, Any]:
    """A row in leaderboard.json, with the difference in the metric to the row of its base law."""
    entry = {name: row.header[name] for name in ENTRIES}
    entry["results"] = results = {each.name: _summary(row.episodes(each)) for each in sets}
    if metric == SPEED.name:
        for each in sets:
            results[each.name][metric][DECILE] = lowest_decile(row.score(each.name, metric))
    entry["senses"], entry["told"] = find_candidate(row.name).inputs
    if base is not None:
        entry["minus_base"] = differences = {}
        for each in sets:
            both = [run.score(each.name, metric) for run in (row, base)]
            differences[each.name] = paired_difference(*both, mean=True).to_dict()
    return entry


def _summary(episodes: Sequence[Episode]) -> dict[str, Any]:
    """The results of a row on one set."""
    names = [name for name in episodes[0] if name in (*METRICS, *LABELS, "failed")]
    summary = summarise([{name: episode[name] for name in names} for episode in episodes])
    del summary["training_seeds"]
    return summary


def grouped(board: Board) -> dict[str, list[Row]]:
    """The rows of the main table by group.

    The last group contains rows that are in no table of another page.
    """
    title_of = {name: title for title, names in GROUPS.items() for name in names}
    elsewhere = {name for names, _ in SECTIONS.values() for name in names}
    groups: dict[str, list[Row]] = {title: [] for title in (*GROUPS, "Others")}
    for row in board["rows"]:
        name = row["policy"]
        if name in title_of or name not in elsewhere:
            groups[title_of.get(name, "Others")].append(row)
    return {title: rows for title, rows in groups.items() if rows}


def message(board: Board) -> str:
    """The summary of the main table."""
    results = {row["policy"]: row["results"] for row in board["rows"]}

    def speed(name: str, set_name: str = RANKING_SET) -> float:
        return float(results[name][set_name][SPEED.name]["mean"])

    blind = speed(REFERENCE)
    times = blind / speed("adaptive")
    perfect = [speed(name) for name in PERFECT]
    lqr, residual, distilled, specialised = (speed(name, REAL) for name in KEPT)
    return (
        f"Torque as a function of time alone makes {blind:.1f} cm/s, {times:.1f} times the paper's "
        f"controller; an encoder and two gains (`pd`) make {speed('pd'):.1f}. A model, dynamic "
        f"programming or learning brings {min(perfect):.0f} to {max(perfect):.0f} with perfect "
        "sensors on the assumed plants. With real sensors most of these fall below the PD "
        f"({speed('pd', REAL):.1f}). LQR keeps {lqr:.1f} without learning, PPO on a law with a "
        f"predictor (`residual-real`) makes {residual:.1f}, and `dp-distilled`, a recurrent "
        f"network from which M and mu are hidden, {distilled:.1f}; trained for these plants alone "
        f"(`dp-distilled-real`), it makes {specialised:.1f}."
    )


def _main_table(board: Board, columns: Sequence[str], names: Sequence[str] = ()) -> str:
    """Some columns of all rows with lines for the titles of groups, or only of some rows."""
    results = {row["policy"]: row["results"] for row in board["rows"]}
    reference = results[REFERENCE][RANKING_SET][SPEED.name]["mean"]
    lines = [columns]
    for title, rows in grouped(board).items():
        if not names:
            lines.append([f"**{title}**", *[""] * (len(columns) - 1)])
        for row in rows:
            if not names or row["policy"] in names:
                cells = _main_cells(row, reference)
                lines.append([cells[column] for column in columns])
    return markdown_table(lines)


def _main_cells(row: Row, reference: float) -> dict[str, str]:
    """The cells of `_main_table` by column; `reference` is the speed of `REFERENCE`, cm/s."""
    cells = {name: row[name] for name in ("policy", "senses", "told")}
    for name, result in row["results"].items():
        failed = f" ({result['failures']}/{result['episodes']})" if result["failures"] else ""
        cells[name] = SPEED.format(result[SPEED.name]["mean"]) + failed
    ranking = row["results"][RANKING_SET]
    cells[RATIO] = SPEED.format(ranking[SPEED.name]["mean"] / reference)
    cells[COST.label] = COST.format(ranking[COST.name]["iqm"])
    return cells


def _details(rows: Sequence[Row], sets: Iterable[str], criteria: Criteria) -> str:
    """A table for each set: means, worst seeds and plants, differences to base laws.

    Columns without any value are omitted.
    """
    tables = []
    for name in sets:
        lines = [_detail_cells(row, name, criteria) for row in rows]
        columns = [column for column in lines[0] if any(line[column] != "-" for line in lines)]
        table = markdown_table([columns, *([line[column] for column in columns] for line in lines)])
        tables.append(f"On the set `{name}`:\n\n{table}")
    return "\n\n".join(tables)


def _detail_cells(row: Row, set_name: str, criteria: Criteria) -> dict[str, str]:
    """The cells of `_details` by column."""
    result = row["results"][set_name]
    cells = {"policy": row["policy"]}
    for name, weight in criteria.weights.items():
        if name in METRICS:
            worst = max if weight < 0.0 else min
            worst_seed = worst(result[name]["seeds"]) if row["training_seeds"] else None
            cells |= _metric_cells(METRICS[name], result[name], worst_seed)
    cells[FAILED] = failures_with_interval(result["failures"], result["episodes"])
    base = row.get("minus_base", {}).get(set_name)
    difference = criteria.metric.with_interval(base.values(), sign=True) if base else "-"
    cells[f"difference to base law on `{set_name}`"] = difference
    if SPEED.name in criteria.weights:
        cells[COST.label] = COST.format(result[COST.name]["iqm"])
    cells["seeds"] = str(len(row["training_seeds"]) or "-")
    cells["revision"] = row["revision"] or "-"
    return cells


def failures_with_interval(failures: int, episodes: int) -> str:
    """The failed episodes of all, and Wilson's interval of their share, %."""
    found = share(failures, episodes)
    low, high = (f"{100.0 * end:.1f}" for end in (found.low, found.high))
    return f"{failures}/{episodes} [{low},\N{NO-BREAK SPACE}{high}]"


def comparisons(board: Board) -> str:
    """What the comparisons of the rows of the main table say."""
    found = board["comparisons"]
    text = (
        f"All rows of the table above are compared with each other on `{RANKING_SET}` and on "
        f"`{REAL}`, on the same plants: {found['pairs']} comparisons of mean speeds at a "
        "family-wise level of 5 % (Holm). All differ but these:"
    )
    lines = [text, ""]
    for set_name, undecided in found["undecided"].items():
        pairs = [f"{first} from {', '.join(others)}" for first, others in undecided.items()]
        lines.append(f"- on `{set_name}`: {'; '.join(pairs) or 'none'}.")
    return "\n".join(lines)


def _metric_cells(
    metric: TableMetric, values: Mapping[str, Any], worst_seed: float | None
) -> dict[str, str]:
    """The cells of a metric by column."""
    # The label of a share has no unit in brackets.
    unit = metric.label.partition(" (")[2].removesuffix(")") or "share"
    means = metric.with_interval([values["mean"], values["mean_low"], values["mean_high"]])
    cells = {metric.label: means, f"worst seed ({unit})": metric.format(worst_seed)}
    if DECILE in values:
        cells["lowest decile"] = metric.format(values[DECILE])
    if not metric.share:
        cells["interquartile mean"] = metric.format(values["iqm"])
    return cells


def _markers(name: str) -> tuple[str, str]:
    """The markers of mkdocs around a section, by which other pages include it."""
    return f"<!-- --8<-- [start:{name}] -->", f"<!-- --8<-- [end:{name}] -->"


def _section(name: str, text: str) -> str:
    """A text between its markers."""
    start, end = _markers(name)
    return f"{start}\n{text}\n{end}"


def _replace_section(readme: str, name: str, text: str) -> str:
    """Replaces a section of the README.

    Raises:
        ValueError: if a marker is missing.
    """
    start, end = _markers(name)
    before, _, rest = readme.partition(start)
    if end not in rest:
        raise ValueError(f"README.md must contain {start} and then {end}")
    return before + _section(name, text) + rest.partition(end)[2]


def files(root: Path, board: Board) -> dict[str, str]:
    """The texts of leaderboard.json, LEADERBOARD.md, the README, and the tables of other pages.

    Raises:
        ValueError: if a marker is missing in the README.
    """
    rows = [row for group in grouped(board).values() for row in group]
    speed = CRITERIA["speed"]
    parts = {
        "message": _section("message", message(board)),
        "main": _main_table(board, COLUMNS),
        "comparisons": comparisons(board),
        "details": _details(rows, DETAILED_SETS, speed),
        "policies": "\n".join(f"- `{row['policy']}`: {row['description']}" for row in rows),
    }
    template = Template(Path(__file__).with_suffix(".md").read_text(encoding="utf-8"))
    readme = (root / "README.md").read_text(encoding="utf-8")
    readme = _replace_section(readme, "message", message(board))
    readme = _replace_section(readme, "leaderboard", _main_table(board, HEAD_COLUMNS, HEAD))
    tables = [f"<!-- Written by `{COMMAND}`. -->"]
    for name, (names, sets) in SECTIONS.items():
        shown = [row for row in board["rows"] if row["policy"] in names]
        tables.append(_section(name, _details(shown, sets, speed)))
    for task, own in board["tasks"].items():
        tables.append(_section(task, _details(own["rows"], own["sets"], CRITERIA[task])))
    return {
        "README.md": readme,
        "leaderboard.json": to_json(board),
        "LEADERBOARD.md": template.substitute(parts),
        TABLES: "\n\n".join(tables) + "\n",
    }
