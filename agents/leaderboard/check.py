"""Finds what in the committed leaderboard is stale, as CI does: `python -m agents.leaderboard --check`.

The check is exact. It compares the policies listed, their descriptions and training seeds, the sets' hashes, the hash
of every policy's file and the revisions they were trained at; leaderboard.json and the pages must be what the results
give. Then it evaluates everything again with the current code and compares every bit of every episode: networks, laws
and plants give the same bits on every machine.

It compares neither versions of packages nor the revision of the code: a commit makes the leaderboard stale exactly
where it changes a number. Nor does it evaluate the sensitivity again, which the same policies on the same plants have.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.policies import Candidate
from agents.leaderboard.page import build, render, training_commands, with_head
from agents.leaderboard.rows import RESULTS, Row, evaluate, load_rows, static_header
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.files import to_json
from capsule_gym.task import HORIZON


def _flattened(where: str, value: Any) -> dict[str, Any]:
    """The values of nested dicts; the keys are the path to each, in words."""
    if not isinstance(value, dict):
        return {where: value}
    return {key: each for name, entry in value.items() for key, each in _flattened(f"{where} {name}", entry).items()}


def _differences(where: str, recorded: Any, found: Any) -> list[str]:
    """Compares nested numbers of leaderboard.json exactly with what the results give."""
    old, new = _flattened(where, recorded), _flattened(where, found)
    return [
        f"{key} is {old.get(key, 'absent')!r} in leaderboard.json and {new.get(key, 'absent')!r} by the results"
        for key in dict.fromkeys([*old, *new])
        if key not in old or key not in new or old[key] != new[key]
    ]


def _stale_headers(rows: Sequence[Row], candidates: Sequence[Candidate]) -> Iterator[str]:
    """Compares the fields of the headers that need no evaluation."""
    commands = training_commands()
    for row, candidate in zip(rows, candidates, strict=True):
        for field, now in static_header(candidate).items():
            before = row.header[field]
            if field == "files" and before != now:
                changed = sorted(path for path in {*before, *now} if before.get(path) != now.get(path))
                yield f"{row.name}: files have changed: {', '.join(changed)}"
            elif before != now:
                yield f"{row.name}: {field} is {before!r} in its results and {now!r} now"
        if row.trained and row.name not in commands:
            yield f"{row.name}: the table in agents/checkpoints/README.md has no command that trains it"


def _stale_sets(rows: Sequence[Row], sets: Sequence[EvaluationSet]) -> Iterator[str]:
    """Compares the sets that the rows were evaluated on with the present ones."""
    for row in rows:
        for each in sets:
            try:
                row.check_set(each)
            except ValueError as error:
                yield str(error)
        for name in sorted(set(row.header["sets"]) - {each.name for each in sets}):
            yield f"{row.name}: the set {name} is in its results and does not exist"


def _stale_board(root: Path, board: dict[str, Any]) -> list[str]:
    """Compares leaderboard.json with what the results give."""
    path = root / "leaderboard.json"
    if not path.is_file():
        return ["leaderboard.json is missing"]
    text = path.read_text(encoding="utf-8")
    if text == to_json(board):
        return []
    try:
        recorded = json.loads(text)
        old, new = ({row["policy"]: row for row in each["rows"]} for each in (recorded, board))
        stale = [
            line for key in dict.fromkeys([*old, *new]) for line in _differences(f"{key}:", old.get(key), new.get(key))
        ]
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        return [f"leaderboard.json is malformed: {type(error).__name__}: {error}"]
    return stale or ["leaderboard.json is not what the results give"]


def _stale_pages(root: Path, board: dict[str, Any]) -> Iterator[str]:
    """Compares the rendered pages with what the results give."""
    page, readme = root / "LEADERBOARD.md", root / "README.md"
    if not page.is_file() or page.read_text(encoding="utf-8") != render(board):
        yield "LEADERBOARD.md is not what the results give"
    text = readme.read_text(encoding="utf-8") if readme.is_file() else ""
    try:
        if with_head(text, board) != text:
            yield "README.md: the leaderboard's head is not what the results give"
    except ValueError as error:
        yield str(error)


def _stale_episodes(recorded: Row, found: Row) -> Iterator[str]:
    """Compares every number of every episode, bit for bit; names the first that differs of every metric."""
    seeds = recorded.header["training_seeds"]
    for set_name, values in recorded.scores.items():
        now = found.scores[set_name]
        if values.shape != now.shape or recorded.header["metrics"] != found.header["metrics"]:
            yield f"{recorded.name} on {set_name}: holds arrays of {values.shape}, now of {now.shape}"
            continue
        for name, before, after in zip(found.header["metrics"], values, now, strict=True):
            differs = np.argwhere(before.view(np.uint64) != after.view(np.uint64))
            if differs.size:
                run, episode = differs[0].tolist()
                where = f"training seed {seeds[run]}, episode {episode}" if seeds else f"episode {episode}"
                yield (
                    f"{recorded.name} on {set_name}: {name} is {before[run, episode].item()!r} in its results and "
                    f"{after[run, episode].item()!r} now ({where}; {len(differs)} of {before.size} differ)"
                )


def check(
    root: Path,
    candidates: Sequence[Candidate],
    sets: Sequence[EvaluationSet],
    *,
    evaluated: Sequence[Candidate],
    jobs: int = 1,
    horizon: float = HORIZON,
) -> list[str]:
    """What is stale, one line each.

    Args:
        root: the project's folder, with leaderboard.json, LEADERBOARD.md, README.md and the results.
        candidates: the rows that should be there.
        sets: the sets that they should be evaluated on.
        evaluated: the rows to evaluate again.
        jobs: number of processes.
        horizon: length of an episode in s.
    """
    names = [candidate.name for candidate in candidates]
    try:
        rows = load_rows(root / RESULTS, names)
    except ValueError as error:
        return [str(error)]
    # What needs no evaluation comes first: it takes no time.
    stale = [
        f"{path.stem}: has results and does not exist"
        for path in sorted((root / RESULTS).glob("*.npz"))
        if path.stem not in names
    ]
    stale += [*_stale_headers(rows, candidates), *_stale_sets(rows, sets)]
    if not stale:
        board = build(rows, sets)
        stale = [*_stale_board(root, board), *_stale_pages(root, board)]
    if stale:
        return [*stale, *(["the numbers were not evaluated again"] if evaluated else [])]
    recorded = {row.name: row for row in rows}
    found = evaluate(evaluated, sets, jobs=jobs, horizon=horizon, disturbed=False)
    return [line for row in found for line in _stale_episodes(recorded[row.name], row)]
