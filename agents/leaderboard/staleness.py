"""What in the committed leaderboard is stale, and how far a number may be from the recorded one."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agents.evaluation.candidates import Candidate
from agents.evaluation.sets import HORIZON, EvaluationSet
from agents.evaluation.tables import MEASURES, SHARE
from agents.leaderboard.board import _static_row, build
from agents.leaderboard.page import render, with_head

EXACT_FIELDS = ("description", "training_seeds", "revision", "files")


class Tolerance(NamedTuple):
    """How far a number may be from the recorded one.

    Attributes:
        relative: of the recorded number.
        absolute: in the number's own unit.
        interval: as a fraction of the recorded interval. The largest of the three counts.
        ends: the same fraction for the ends of the interval, which one episode moves farther than it moves the mean.
        failures: as a fraction of the episodes.
    """

    relative: float
    absolute: float
    interval: float
    ends: float
    failures: float


STABLE = Tolerance(relative=1e-3, absolute=1e-4, interval=0.0, ends=0.0, failures=0.0)
CHAOTIC = Tolerance(relative=0.03, absolute=0.01, interval=0.25, ends=1.0, failures=0.05)


def _allowed(recorded: Mapping[str, float | None], end: str, tolerance: Tolerance) -> float:
    """How far one number of `{"iqm": .., "low": .., "high": ..}` may be from the recorded one."""
    value, low, high = recorded[end], recorded["low"], recorded["high"]
    width = high - low if low is not None and high is not None else 0.0
    share = tolerance.interval if end == "iqm" else tolerance.ends
    return max(tolerance.relative * abs(value or 0.0), tolerance.absolute, share * width)


def _stale_numbers(where: str, recorded: Mapping[str, Any], found: Mapping[str, Any], learned: bool) -> list[str]:
    """Compares two summaries of one policy on one set."""
    stale = []

    def compare(name: str, old: Any, new: Any, same: bool) -> None:
        if not same:
            stale.append(f"{where}: {name} is {old!r} in leaderboard.json and {new!r} now")

    for name in ("episodes", "resampled"):
        compare(name, recorded.get(name), found[name], recorded.get(name) == found[name])
    tolerance = CHAOTIC if learned or recorded["failures"] else STABLE
    allowed_failures = math.ceil(tolerance.failures * found["episodes"])
    same = abs(recorded["failures"] - found["failures"]) <= allowed_failures
    compare("failures", recorded["failures"], found["failures"], same)
    for metric in (name for name in (*MEASURES, SHARE.metric) if name in found):
        before = recorded[metric]
        for end, new in found[metric].items():
            old = before[end]
            if old is None or new is None:
                same = old is new
            else:
                same = abs(new - old) <= _allowed(before, end, tolerance)
            compare(f"{metric} ({end})", old, new, same)
    return stale


def _stale_rows(recorded: Mapping[str, Any], candidates: Sequence[Candidate]) -> list[str]:
    """Compares what needs no evaluation."""
    old = {row["policy"]: row for row in recorded["rows"]}
    new = {candidate.name: _static_row(candidate) for candidate in candidates}
    stale = [f"{name}: is in leaderboard.json and does not exist" for name in old if name not in new]
    stale += [f"{name}: exists and is not in leaderboard.json" for name in new if name not in old]
    for name in (name for name in old if name in new):
        for field in EXACT_FIELDS:
            before, after = old[name].get(field), new[name][field]
            if before == after:
                continue
            if field == "files":
                before, after = before or {}, after or {}
                changed = sorted(path for path in {*before, *after} if before.get(path) != after.get(path))
                stale.append(f"{name}: files have changed: {', '.join(changed)}")
            else:
                stale.append(f"{name}: {field} is {before!r} in leaderboard.json and {after!r} now")
    return stale


def _stale_sets(recorded: Mapping[str, Any], sets: Sequence[EvaluationSet]) -> list[str]:
    old, new = recorded["sets"], {s.name: s.hash for s in sets}
    return [
        f"set {name}: hash is {old.get(name)} in leaderboard.json and {new.get(name)} now"
        for name in dict.fromkeys([*old, *new])
        if old.get(name) != new.get(name)
    ]


def _stale_pages(root: Path, recorded: Mapping[str, Any]) -> list[str]:
    """Compares the rendered pages with leaderboard.json."""
    stale = []
    page = root / "LEADERBOARD.md"
    if not page.is_file() or page.read_text(encoding="utf-8") != render(recorded):
        stale.append("LEADERBOARD.md is not what leaderboard.json renders to")
    readme = root / "README.md"
    if readme.is_file():
        text = readme.read_text(encoding="utf-8")
        if with_head(text, recorded) != text:
            stale.append("README.md: the leaderboard's head is not what leaderboard.json renders to")
    return stale


def check(
    root: Path,
    candidates: Sequence[Candidate],
    sets: Sequence[EvaluationSet],
    *,
    jobs: int = 1,
    horizon: float = HORIZON,
) -> list[str]:
    """What is stale, one line each.

    Args:
        root: the folder of leaderboard.json, LEADERBOARD.md and README.md.
        candidates: the rows that should be there.
        sets: the sets that they should be evaluated on.
        jobs: number of processes.
        horizon: length of an episode in s.
    """
    try:
        recorded = json.loads((root / "leaderboard.json").read_text(encoding="utf-8"))
        # What needs no evaluation comes first: whoever has to write the leaderboard anew learns it at once.
        stale = _stale_sets(recorded, sets) + _stale_rows(recorded, candidates) + _stale_pages(root, recorded)
    except FileNotFoundError:
        return ["leaderboard.json is missing"]
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        return [f"leaderboard.json is malformed: {type(error).__name__}: {error}"]
    except ValueError as error:
        return [str(error)]
    if stale:
        return [*stale, "the numbers were not evaluated again"]
    found = {row["policy"]: row for row in build(candidates, sets, jobs=jobs, horizon=horizon)["rows"]}
    for row in recorded["rows"]:
        for name, summary in found[row["policy"]]["results"].items():
            where, before = f"{row['policy']} on {name}", row["results"][name]
            try:
                stale += _stale_numbers(where, before, summary, learned=bool(row["training_seeds"]))
            except (KeyError, TypeError) as error:
                stale.append(f"{where}: leaderboard.json is malformed: {type(error).__name__}: {error}")
    return stale
