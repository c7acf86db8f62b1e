"""What in the committed leaderboard is stale."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.evaluation.candidates import Candidate
from agents.evaluation.sets import EvaluationSet
from agents.evaluation.tables import MEASURES, SHARE
from agents.leaderboard.board import build, static_row
from agents.leaderboard.page import render, with_head
from agents.leaderboard.tolerance import agree, agree_counts
from capsule_gym.task import HORIZON

EXACT_FIELDS = ("description", "training_seeds", "revision", "files")


def _stale_numbers(where: str, recorded: Mapping[str, Any], found: Mapping[str, Any]) -> list[str]:
    """Compares two summaries of one policy on one set."""
    stale = []

    def compare(name: str, old: Any, new: Any, same: bool) -> None:
        if not same:
            stale.append(f"{where}: {name} is {old!r} in leaderboard.json and {new!r} now")

    spread = recorded["spread"]
    for name in ("episodes", "resampled"):
        compare(name, recorded[name], found[name], recorded[name] == found[name])
    old, new = recorded["failures"], found["failures"]
    compare("failures", old, new, agree_counts(old, new, spread["failures"]))
    for metric in (name for name in (*MEASURES, SHARE.metric) if name in found):
        for end, new in found[metric].items():
            old = recorded[metric][end]
            compare(f"{metric} ({end})", old, new, agree(old, new, spread[metric][end]))
    return stale


def _stale_rows(recorded: Mapping[str, Any], candidates: Sequence[Candidate]) -> list[str]:
    """Compares what needs no evaluation."""
    old = {row["policy"]: row for row in recorded["rows"]}
    new = {candidate.name: static_row(candidate) for candidate in candidates}
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
    board = build(candidates, sets, jobs=jobs, horizon=horizon, with_spread=False)
    found = {row["policy"]: row for row in board["rows"]}
    for row in recorded["rows"]:
        for name, summary in found[row["policy"]]["results"].items():
            where, before = f"{row['policy']} on {name}", row["results"][name]
            try:
                stale += _stale_numbers(where, before, summary)
            except (KeyError, TypeError) as error:
                stale.append(f"{where}: leaderboard.json is malformed: {type(error).__name__}: {error}")
    return stale
