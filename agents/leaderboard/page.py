"""Renders the content of leaderboard.json as LEADERBOARD.md, and its head into the README.

Rendering uses nothing but that content, so that the page can be checked without a simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from agents.evaluation.episodes import SHARE_OF_OPTIMUM, TABLE_METRICS, TableMetric
from agents.evaluation.policies import BASELINE
from agents.leaderboard.chaos import COPIES, NOISE
from baselines.tables import markdown_table

RANKING_SET = "paper"
HEAD_ROWS = 11
COMMAND = "python -m agents.leaderboard"
# As mkdocs includes a part of a file: docs/index.md does.
START, END = "<!-- --8<-- [start:leaderboard] -->", "<!-- --8<-- [end:leaderboard] -->"

RATIO = TableMetric("ratio", f"x {BASELINE}", 2)
SPEED = TABLE_METRICS["mean_speed"]


def rank(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The rows, fastest on the ranking set first; names break ties."""
    return sorted(rows, key=lambda row: (-row["results"][RANKING_SET]["mean_speed"]["iqm"], row["policy"]))


def _baseline_speed(board: Mapping[str, Any]) -> float:
    return next(
        (row["results"][RANKING_SET]["mean_speed"]["iqm"] for row in board["rows"] if row["policy"] == BASELINE), 0.0
    )


def _speed_cells(board: Mapping[str, Any], row: Mapping[str, Any]) -> list[str]:
    """Mean speed with interval, and as a multiple of the baseline's."""
    speed, baseline = row["results"][RANKING_SET]["mean_speed"], _baseline_speed(board)
    return [_unbroken(SPEED.with_interval(speed)), RATIO.format(speed["iqm"] / baseline if baseline > 0.0 else None)]


def _failures(summary: Mapping[str, Any]) -> str:
    return f"{summary['failures']}/{summary['episodes']}"


def _share(summary: Mapping[str, Any]) -> str:
    """The share of the optimum's speed; a dash on sets that the table of optima does not cover."""
    return SHARE_OF_OPTIMUM.format(summary.get(SHARE_OF_OPTIMUM.name, {}).get("iqm"))


def _main_table(board: Mapping[str, Any]) -> str:
    """The ranking, in columns narrow enough for a telephone."""
    table = [["", "policy", "cm/s [95 %]", RATIO.label, "of optimum", "CoT", "failed"]]
    for place, row in enumerate(rank(board["rows"]), start=1):
        summary = row["results"][RANKING_SET]
        speed, ratio = _speed_cells(board, row)
        cost = TABLE_METRICS["cost_of_transport"].format(summary["cost_of_transport"]["iqm"])
        table.append([str(place), row["policy"], speed, ratio, _share(summary), cost, _failures(summary)])
    return markdown_table(table)


def _unbroken(text: str) -> str:
    """A number with its interval, in which a line may end between the two alone."""
    return text.replace(", ", ",\N{NO-BREAK SPACE}")


def _details_table(board: Mapping[str, Any]) -> str:
    """What the ranking leaves out."""
    shown = [measure for measure in TABLE_METRICS.values() if measure != SPEED]
    table = [["policy", *(measure.label for measure in shown), "training seeds", "revision"]]
    for row in rank(board["rows"]):
        summary = row["results"][RANKING_SET]
        revision = f"`{row['revision']}`" if row["revision"] else "-"
        cells = (_unbroken(measure.with_interval(summary[measure.name])) for measure in shown)
        table.append([row["policy"], *cells, str(len(row["training_seeds"]) or "-"), revision])
    return markdown_table(table)


def _sets_table(board: Mapping[str, Any]) -> str:
    """Mean speeds alone, with the share of failed episodes where there are any."""
    table = [["policy", *board["sets"]]]
    for row in rank(board["rows"]):
        summaries = [row["results"][name] for name in board["sets"]]
        cells = [SPEED.format(summary["mean_speed"]["iqm"]) + _failed_share(summary) for summary in summaries]
        table.append([row["policy"], *cells])
    return markdown_table(table)


def _failed_share(summary: Mapping[str, Any]) -> str:
    """The share of episodes that failed, in brackets; nothing where none did."""
    share = 100.0 * summary["failures"] / summary["episodes"]
    if not share:
        return ""
    return f" ({share:.0f}\N{NO-BREAK SPACE}%)" if share >= 1.0 else " (<\N{NO-BREAK SPACE}1\N{NO-BREAK SPACE}%)"


def _intervals_table(board: Mapping[str, Any]) -> str:
    """Mean speeds with their intervals, and failures as counts."""
    table = [["policy", *board["sets"]]]
    for row in rank(board["rows"]):
        cells = []
        for name in board["sets"]:
            summary = row["results"][name]
            failed = f", {_failures(summary)} failed" if summary["failures"] else ""
            cells.append(_unbroken(SPEED.with_interval(summary["mean_speed"])) + failed)
        table.append([row["policy"], *cells])
    return markdown_table(table)


def _shares_table(board: Mapping[str, Any]) -> str:
    """The shares on the sets that the table of optima covers."""
    rows = rank(board["rows"])
    names = [name for name in board["sets"] if any(SHARE_OF_OPTIMUM.name in row["results"][name] for row in rows)]
    table = [[row["policy"], *(_share(row["results"][name]) for name in names)] for row in rows]
    return markdown_table([["policy", *names], *table])


def _chaos_table(board: Mapping[str, Any]) -> str:
    """The range of the mean speed under noise."""
    table = [["policy", f"lowest {SPEED.label}", "highest", "width"]]
    for row in rank(board["rows"]):
        low, high = (row["disturbed"][end] for end in ("low", "high"))
        width = SPEED.format(high - low)
        smallest = f"< {0.5 * 10.0**-SPEED.digits:g}"
        table.append([row["policy"], SPEED.format(low), SPEED.format(high), width if float(width) else smallest])
    return markdown_table(table)


def _policy(row: Mapping[str, Any]) -> str:
    """What a policy is, and the command that trains it."""
    trained = f". Trained by `{row['trained_by']}`" if row.get("trained_by") else ""
    return f"- `{row['policy']}`: {row['description']}{trained}"


def _notes(board: Mapping[str, Any]) -> list[str]:
    """What the numbers mean and what they were computed with."""
    hashes = ", ".join(f"`{name}` {value[:12]}" for name, value in board["sets"].items())
    versions = ", ".join(f"{name} {value}" for name, value in board["versions"].items())
    return [
        "- Numbers are interquartile means: of the middle half of the episodes. A failed episode ends there: its mean "
        "speed is the distance it had made over the whole 33 s, its other numbers are of the time until then.",
        "- Intervals. Where a policy was trained with several seeds, whole seeds are resampled, all episodes of a seed "
        "together; with three seeds the interval is the range from the worst to the best seed, which holds the true "
        "median of training runs with a probability of 75 %, not 95 %. Scripted policies, and policies of a single "
        "seed, have their episodes resampled: the interval then says how much the choice of plants matters, not what "
        "another training run would give; on `nominal`, how much the start matters.",
        "- Revision: the git revision that a checkpoint was trained at. Scripted policies are this checkout's own "
        "code, which the check runs, so they need none.",
        "- A dash stands for what does not exist: the cost of transport where more than a quarter of the episodes make "
        "no forward progress, the revision of a scripted policy.",
        f"- Made from the results of all episodes (`agents/leaderboard/results`). `{COMMAND} --check` evaluates every "
        "row again, and fails where any digit of an episode, a set or a checkpoint is not what it was: the same code "
        "gives the same bits on every machine.",
        f"- Sets (sha256 of the content): {hashes}.",
        f"- Written with {versions}.",
    ]


def _folded(summary: str, table: str) -> list[str]:
    """Lines of Markdown that a reader unfolds, on GitHub and on the site."""
    return ['<details markdown="1">', f"<summary>{summary}</summary>", "", table, "", "</details>"]


def _ranking(board: Mapping[str, Any]) -> list[str]:
    """Who is fastest, and what the columns say."""
    return [
        f"Who is fastest on the set `{RANKING_SET}`: 100 frozen episodes of 33 s from rest, each on a capsule with a "
        "mass and a friction of its own, the same for every policy. Interquartile means with 95 % intervals.",
        "",
        _main_table(board),
        "",
        f"`{RATIO.label}`: the speed over that of the paper's controller. Of optimum: the share of the fastest that is "
        "known for each plant. CoT: cost of transport, what is spent per weight and distance. Failed: episodes in "
        "which the pendulum reaches 90 degrees or the platform leaves the floor, of all training seeds.",
        "",
        *_folded("All measures, training seeds and revisions", _details_table(board)),
        "",
        f"`python -m agents.evaluate NAME --set {RANKING_SET}` evaluates one line beside the paper's controller.",
    ]


def _every_set(board: Mapping[str, Any]) -> list[str]:
    """The speeds on all sets, and their shares of the optimum's."""
    return [
        "## On every set",
        "",
        "Mean speed, cm/s; in brackets the share of episodes that fail. `nominal` is the paper's plant from 100 "
        "angles; `wide` and `extrapolation` hold plants far from it, and in `drift` the plant jumps on the way.",
        "",
        _sets_table(board),
        "",
        *_folded("With intervals and counts of failures", _intervals_table(board)),
        "",
        "## Share of the optimum",
        "",
        "Each episode's mean speed over the optimum's on its plant: what dynamic programming has found for a torque "
        "that is held for 20 ms, from the same start, under the same limits "
        "(`python -m baselines.dynamic_programming`); linear in M and log(mu) between the plants of its grid. A share "
        "may exceed 1 a little: by the error between the plants, by that of the optimum itself, and by a torque that "
        "changes more often. Sets with plants outside the grid, or "
        "whose plants change on the way, have none. Here too, interquartile means.",
        "",
        *_folded("Shares on every set that has them", _shares_table(board)),
    ]


def _chaos(board: Mapping[str, Any]) -> list[str]:
    """How far a policy's speed is known."""
    return [
        "## Chaos",
        "",
        f"The mean speed (cm/s) on the paper's plant, of {COPIES} copies of one episode with noise of up to "
        f"1 / {1.0 / NOISE:,.0f} of full action on every action; of several training seeds, the one whose copies part "
        "the most. The speed of a policy with a wide range is known as a distribution only: a single episode of it "
        "says little, here as on a robot.",
        "",
        *_folded("Ranges of all policies", _chaos_table(board)),
    ]


def render(board: Mapping[str, Any]) -> str:
    """The text of LEADERBOARD.md.

    Args:
        board: the content of leaderboard.json.
    """
    policies = ["## The policies", "", *(_policy(row) for row in rank(board["rows"]))]
    parts = [
        [f"<!-- Written by `{COMMAND}`; do not edit. -->"],
        ["# Leaderboard"],
        _ranking(board),
        _every_set(board),
        _chaos(board),
        policies,
        ["## Notes", "", *_notes(board)],
    ]
    return "\n\n".join("\n".join(part) for part in parts) + "\n"


def head(board: Mapping[str, Any]) -> str:
    """The leaderboard's head for the README, as a Markdown table: the fastest few, and always the baseline."""
    table = [["policy", f"{SPEED.label} [95 %]", RATIO.label, TABLE_METRICS["cost_of_transport"].label, "failures"]]
    for place, row in enumerate(rank(board["rows"])):
        if place < HEAD_ROWS or row["policy"] == BASELINE:
            summary = row["results"][RANKING_SET]
            transport = TABLE_METRICS["cost_of_transport"].format(summary["cost_of_transport"]["iqm"])
            table.append([row["policy"], *_speed_cells(board, row), transport, _failures(summary)])
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
