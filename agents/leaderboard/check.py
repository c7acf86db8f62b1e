"""What in the committed leaderboard is stale."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.evaluation.candidates import Candidate
from agents.evaluation.sets import EvaluationSet
from agents.leaderboard.board import build, static_row
from agents.leaderboard.page import render, with_head
from capsule_gym.task import HORIZON

EXACT_FIELDS = ("description", "training_seeds", "revision", "files")


def _numbers(where: str, value: Any) -> dict[str, Any]:
    """Nested numbers by where they stand, in words."""
    if not isinstance(value, dict):
        return {where: value}
    return {key: each for name, entry in value.items() for key, each in _numbers(f"{where} {name}", entry).items()}


def _stale_numbers(where: str, recorded: Any, found: Any) -> list[str]:
    """Compares nested numbers to the last of their digits: the same code gives the same bits on every machine."""
    old, new = _numbers(where, recorded), _numbers(where, found)
    return [
        f"{key} is {old.get(key, 'absent')!r} in leaderboard.json and {new.get(key, 'absent')!r} now"
        for key in dict.fromkeys([*old, *new])
        if key not in old or key not in new or old[key] != new[key]
    ]


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
    board = build(candidates, sets, jobs=jobs, horizon=horizon)
    found = {row["policy"]: row for row in board["rows"]}
    for row in recorded["rows"]:
        name, now = row["policy"], found[row["policy"]]
        for set_name, summary in now["results"].items():
            stale += _stale_numbers(f"{name} on {set_name}:", row["results"].get(set_name), summary)
        stale += _stale_numbers(f"{name} disturbed:", row.get("disturbed"), now["disturbed"])
    return stale
