"""What is made of the rows: leaderboard.json, LEADERBOARD.md and the table in the README.

Both texts use nothing but the content of leaderboard.json, so that they can be checked without a simulation.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.evaluation.episodes import SHARE_OF_OPTIMUM, TABLE_METRICS, TableMetric, summarise
from agents.evaluation.policies import BASELINE, CHECKPOINTS
from agents.leaderboard.rows import COPIES, NOISE, Row
from baselines.tables import markdown_table
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.files import to_json, without_nonfinite, write_atomically

RANKING_SET = "paper"
HEAD_ROWS = 11
COMMAND = "python -m agents.leaderboard"
# As mkdocs includes a part of a file: docs/index.md does.
START, END = "<!-- --8<-- [start:leaderboard] -->", "<!-- --8<-- [end:leaderboard] -->"
# A line of the table in agents/checkpoints/README.md.
TRAINED = re.compile(r"^\| `([\w-]+)` \|[^|]*\| `([^`]+)` \|$", re.MULTILINE)

RATIO = TableMetric("ratio", f"x {BASELINE}", 2)
SPEED, COST = TABLE_METRICS["mean_speed"], TABLE_METRICS["cost_of_transport"]


def _rounded(value: Any, digits: int) -> Any:
    """The same nested dicts with floats rounded to so many significant digits."""
    if isinstance(value, dict):
        return {key: _rounded(entry, digits) for key, entry in value.items()}
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def training_commands() -> dict[str, str]:
    """The command that trains each checkpoint, from the table in its README."""
    path = CHECKPOINTS / "README.md"
    return dict(TRAINED.findall(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def build(rows: Sequence[Row], sets: Sequence[EvaluationSet]) -> dict[str, Any]:
    """The content of leaderboard.json, from the rows alone: the fastest row on the ranking set first.

    Args:
        rows: in any order.
        sets: the columns; one of them is the ranking set.

    Raises:
        ValueError: if a row was evaluated on other sets.
    """
    commands = training_commands()
    shown = (*TABLE_METRICS, SHARE_OF_OPTIMUM.name, "episodes", "failures", "resampled")
    versions: dict[str, set[str]] = {}
    content = []
    for row in rows:
        entry = {name: row.header[name] for name in ("policy", "description", "training_seeds", "revision", "files")}
        if row.trained:
            entry |= {"base": row.header["base"], "trained_by": commands.get(row.name)}
        summaries = {each.name: summarise(row.episodes(each)) for each in sets}
        results = {name: {key: each[key] for key in shown if key in each} for name, each in summaries.items()}
        content.append({**entry, **_rounded({"results": results, "disturbed": row.header["disturbed"]}, 6)})
        for package, number in row.header["versions"].items():
            versions.setdefault(package, set()).add(number)
    content.sort(key=lambda row: (-row["results"][RANKING_SET]["mean_speed"]["iqm"], row["policy"]))
    board = {
        "sets": {each.name: each.hash for each in sets},
        # Where the rows were evaluated with different versions, all of them.
        "versions": {package: ", ".join(sorted(numbers)) for package, numbers in versions.items()},
        "rows": content,
    }
    return without_nonfinite(board)


def _failures(summary: Mapping[str, Any]) -> str:
    return f"{summary['failures']}/{summary['episodes']}"


def _share(summary: Mapping[str, Any]) -> str:
    """The share of the optimum's speed; a dash on sets that the table of optima does not cover."""
    return SHARE_OF_OPTIMUM.format(summary.get(SHARE_OF_OPTIMUM.name, {}).get("iqm"))


def _interval(metric: TableMetric, summary: Mapping[str, Any]) -> str:
    """A number with its interval; a line may break between the two only."""
    return metric.with_interval(summary[metric.name]).replace(", ", ",\N{NO-BREAK SPACE}")


def _ratio(board: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    """The mean speed as a multiple of the baseline's."""
    speeds = {row["policy"]: row["results"][RANKING_SET]["mean_speed"]["iqm"] for row in board["rows"]}
    baseline = speeds.get(BASELINE, 0.0)
    return RATIO.format(summary["mean_speed"]["iqm"] / baseline if baseline > 0.0 else None)


def _table(board: Mapping[str, Any], header: Sequence[str], cells: Callable[[Any], Sequence[str]]) -> str:
    """A table with one line per policy, from the cells behind its name."""
    return markdown_table([["policy", *header], *([row["policy"], *cells(row)] for row in board["rows"])])


def _table_of_sets(board: Mapping[str, Any], cell: Callable[[Any], str]) -> str:
    """A table with one line per policy and one column per set, from the summary of each."""
    return _table(board, list(board["sets"]), lambda row: [cell(row["results"][name]) for name in board["sets"]])


def _ranking_table(board: Mapping[str, Any]) -> str:
    """The ranking, in columns narrow enough for a telephone."""
    table = [["", "policy", "cm/s [95 %]", RATIO.label, "of optimum", "CoT", "failed"]]
    for place, row in enumerate(board["rows"], start=1):
        summary = row["results"][RANKING_SET]
        cost = COST.format(summary["cost_of_transport"]["iqm"])
        speed, ratio = _interval(SPEED, summary), _ratio(board, summary)
        table.append([str(place), row["policy"], speed, ratio, _share(summary), cost, _failures(summary)])
    return markdown_table(table)


def _details_table(board: Mapping[str, Any]) -> str:
    """The metrics that the ranking leaves out."""
    shown = [metric for metric in TABLE_METRICS.values() if metric != SPEED]

    def cells(row: Any) -> list[str]:
        intervals = [_interval(metric, row["results"][RANKING_SET]) for metric in shown]
        revision = f"`{row['revision']}`" if row["revision"] else "-"
        return [*intervals, str(len(row["training_seeds"]) or "-"), revision]

    return _table(board, [*(metric.label for metric in shown), "training seeds", "revision"], cells)


def _speed_and_failed_share(summary: Mapping[str, Any]) -> str:
    """The mean speed, with the share of failed episodes in brackets if there are any."""
    speed, share = SPEED.format(summary["mean_speed"]["iqm"]), 100.0 * summary["failures"] / summary["episodes"]
    if not share:
        return speed
    shown = f"{share:.0f}" if share >= 1.0 else "<\N{NO-BREAK SPACE}1"
    return f"{speed} ({shown}\N{NO-BREAK SPACE}%)"


def _speed_and_failures(summary: Mapping[str, Any]) -> str:
    """The mean speed with its interval, and the failures as counts."""
    return _interval(SPEED, summary) + (f", {_failures(summary)} failed" if summary["failures"] else "")


def _shares_table(board: Mapping[str, Any]) -> str:
    """The shares on the sets that the table of optima covers."""
    rows = board["rows"]
    names = [name for name in board["sets"] if any(SHARE_OF_OPTIMUM.name in row["results"][name] for row in rows)]
    return _table(board, names, lambda row: [_share(row["results"][name]) for name in names])


def _sensitivity_table(board: Mapping[str, Any]) -> str:
    """The range of the mean speed under noise."""

    def cells(row: Any) -> list[str]:
        low, high = (row["disturbed"][end] for end in ("low", "high"))
        width = SPEED.format(high - low)
        return [SPEED.format(low), SPEED.format(high), width if float(width) else f"< {0.5 * 10.0**-SPEED.digits:g}"]

    return _table(board, [f"lowest {SPEED.label}", "highest", "width"], cells)


def _policies(board: Mapping[str, Any]) -> list[str]:
    """One line per policy: its description, and the command that trains it."""
    lines = []
    for row in board["rows"]:
        trained = f". Trained by `{row['trained_by']}`" if row.get("trained_by") else ""
        lines.append(f"- `{row['policy']}`: {row['description']}{trained}")
    return lines


def _folded(summary: str, table: str) -> str:
    """Lines of Markdown that a reader unfolds, on GitHub and on the site."""
    return f'<details markdown="1">\n<summary>{summary}</summary>\n\n{table}\n\n</details>'


def render(board: Mapping[str, Any]) -> str:
    """The text of LEADERBOARD.md.

    Args:
        board: the content of leaderboard.json.
    """
    hashes = ", ".join(f"`{name}` {value[:12]}" for name, value in board["sets"].items())
    versions = ", ".join(f"{name} {value}" for name, value in board["versions"].items())
    parts = [
        f"<!-- Written by `{COMMAND}`; do not edit. -->",
        "# Leaderboard",
        f"The fastest policies on the set `{RANKING_SET}`: 100 frozen episodes of 33 s from rest, each on a capsule "
        "with its own mass and friction, the same for every policy. Interquartile means with 95 % intervals.",
        _ranking_table(board),
        f"`{RATIO.label}`: the speed over that of the paper's controller. Of optimum: the share of the highest speed "
        "known for each plant. CoT: cost of transport, the energy per weight and distance. Failed: episodes in which "
        "the pendulum reaches 90 degrees or the platform leaves the floor, of all training seeds.",
        _folded("All metrics, training seeds and revisions", _details_table(board)),
        f"`python -m agents.evaluate NAME --set {RANKING_SET}` evaluates one line and compares it with the paper's "
        "controller.",
        "## On every set",
        "Mean speed, cm/s; in brackets the share of episodes that fail. `nominal` is the paper's plant from 100 "
        "angles; `wide` and `extrapolation` hold plants far from it, and in `drift` the plant changes during the "
        "episode.",
        _table_of_sets(board, _speed_and_failed_share),
        _folded("With intervals and counts of failures", _table_of_sets(board, _speed_and_failures)),
        "## Share of the optimum",
        "Each episode's mean speed over the optimum's for its plant. Dynamic programming finds the optimum for a "
        "torque with a control interval of 20 ms, from the same start, under the same limits "
        "(`python -m baselines.dynamic_programming`); between the plants of its grid it is linear in M and log(mu). A "
        "share may exceed 1 slightly: by the error of the interpolation, by the error of the optimum, and by a torque "
        "with a shorter control interval. Sets with plants outside the grid, or whose plants change during the "
        "episode, have none. Interquartile means.",
        _folded("Shares on every set that has them", _shares_table(board)),
        "## Sensitivity to perturbations",
        f"The mean speed (cm/s) on the paper's plant, of {COPIES} copies of one episode with noise of up to "
        f"1 / {1.0 / NOISE:,.0f} of full action on every action; of several training seeds, the one with the widest "
        "range. The speed of a policy with a wide range is known as a distribution only: a single episode of it says "
        "little, here as on a robot.",
        _folded("Ranges of all policies", _sensitivity_table(board)),
        "## The policies",
        "\n".join(_policies(board)),
        "## Notes",
        "- Numbers are interquartile means: of the middle half of the episodes. A failed episode ends there: its mean "
        "speed is its distance over the whole 33 s, its other numbers are of the time until then.\n"
        "- Intervals. Where a policy was trained with several seeds, whole seeds are resampled, all episodes of a seed "
        "together; with three seeds the interval is the range from the worst to the best seed, which holds the true "
        "median of training runs with a probability of 75 %, not 95 %. Scripted policies, and policies of a single "
        "seed, have their episodes resampled: the interval then says how much the choice of plants matters, not what "
        "another training run would give; on `nominal`, how much the start matters.\n"
        "- Revision: the git revision that a checkpoint was trained at. Scripted policies are code of this revision, "
        "which the check runs.\n"
        "- A dash stands for what does not exist: the cost of transport where more than a quarter of the episodes make "
        "no forward progress, the revision of a scripted policy.\n"
        f"- Made from the results of all episodes (`agents/leaderboard/results`). `{COMMAND} --check` evaluates every "
        "row again, and fails if any digit of an episode, a set or a checkpoint has changed: the same code gives the "
        "same bits on every machine.\n"
        f"- Sets (sha256 of the content): {hashes}.\n"
        f"- Written with {versions}.",
    ]
    return "\n\n".join(parts) + "\n"


def head(board: Mapping[str, Any]) -> str:
    """The leaderboard's head for the README, as a Markdown table: the fastest few, and always the baseline."""
    table = [["policy", f"{SPEED.label} [95 %]", RATIO.label, COST.label, "failures"]]
    for place, row in enumerate(board["rows"]):
        if place < HEAD_ROWS or row["policy"] == BASELINE:
            summary = row["results"][RANKING_SET]
            cost = COST.format(summary["cost_of_transport"]["iqm"])
            speed, ratio = _interval(SPEED, summary), _ratio(board, summary)
            table.append([row["policy"], speed, ratio, cost, _failures(summary)])
    return markdown_table(table)


def with_head(text: str, board: Mapping[str, Any]) -> str:
    """The README with the leaderboard's head between its markers; the same text where it has no markers.

    Args:
        text: the README.
        board: the content of leaderboard.json.

    Raises:
        ValueError: if there is one marker without the other, or one twice.
    """
    if START not in text and END not in text:
        return text
    before, start, rest = text.partition(START)
    _, end, after = rest.partition(END)
    if not (start and end) or START in rest or END in before + after:
        raise ValueError(f"README.md must hold {START} and then {END}, once each, or neither")
    return f"{before}{START}\n{head(board)}\n{END}{after}"


def write(root: Path, board: Mapping[str, Any]) -> None:
    """Writes leaderboard.json, LEADERBOARD.md and, between its markers, the README's head.

    Args:
        root: the folder that they lie in.
        board: what `build` returned.
    """
    readme = root / "README.md"
    text = readme.read_text(encoding="utf-8") if readme.is_file() else ""
    # The README first: broken markers raise an error before anything is written.
    updated = with_head(text, board)
    if updated != text:
        write_atomically(readme, updated)
    write_atomically(root / "leaderboard.json", to_json(board))
    write_atomically(root / "LEADERBOARD.md", render(board))
