"""What in the committed leaderboard is stale."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.policies import Candidate
from agents.leaderboard.board import build, evaluate, training_commands
from agents.leaderboard.page import render, with_head
from agents.leaderboard.rows import RESULTS, Row, load_rows, static_header
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.files import to_json
from capsule_gym.task import HORIZON


def _numbers(where: str, value: Any) -> dict[str, Any]:
    """What stands in nested dicts, by where it stands, in words."""
    if not isinstance(value, dict):
        return {where: value}
    return {key: each for name, entry in value.items() for key, each in _numbers(f"{where} {name}", entry).items()}


def _differences(where: str, recorded: Any, found: Any, places: tuple[str, str]) -> list[str]:
    """Compares nested numbers to the last of their digits."""
    old, new = _numbers(where, recorded), _numbers(where, found)
    return [
        f"{key} is {old.get(key, 'absent')!r} {places[0]} and {new.get(key, 'absent')!r} {places[1]}"
        for key in dict.fromkeys([*old, *new])
        if key not in old or key not in new or old[key] != new[key]
    ]


def _stale_headers(folder: Path, rows: Sequence[Row], candidates: Sequence[Candidate]) -> list[str]:
    """Compares what needs no evaluation: what each row was evaluated from, and which rows there are."""
    names = [candidate.name for candidate in candidates]
    strays = sorted(path.stem for path in folder.glob("*.npz") if path.stem not in names)
    stale = [f"{name}: has results and does not exist" for name in strays]
    commands = training_commands()
    for row, candidate in zip(rows, candidates, strict=True):
        for field, now in static_header(candidate).items():
            before = row.header[field]
            if before == now:
                continue
            if field == "files":
                changed = sorted(path for path in {*before, *now} if before.get(path) != now.get(path))
                stale.append(f"{row.name}: files have changed: {', '.join(changed)}")
            else:
                stale.append(f"{row.name}: {field} is {before!r} in its results and {now!r} now")
        if row.trained and row.name not in commands:
            stale.append(f"{row.name}: the table in agents/checkpoints/README.md has no command that trains it")
    return stale


def _stale_sets(rows: Sequence[Row], sets: Sequence[EvaluationSet]) -> Iterator[str]:
    for row in rows:
        for each in sets:
            try:
                row.check_set(each)
            except ValueError as error:
                yield str(error)
        for name in row.header["sets"]:
            if name not in [each.name for each in sets]:
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
            line
            for key in dict.fromkeys([*old, *new])
            for line in _differences(f"{key}:", old.get(key), new.get(key), ("in leaderboard.json", "by the results"))
        ]
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        return [f"leaderboard.json is malformed: {type(error).__name__}: {error}"]
    return stale or ["leaderboard.json is not what the results give"]


def _stale_pages(root: Path, board: dict[str, Any]) -> list[str]:
    """Compares the rendered pages with what the results give."""
    stale = []
    page = root / "LEADERBOARD.md"
    if not page.is_file() or page.read_text(encoding="utf-8") != render(board):
        stale.append("LEADERBOARD.md is not what the results give")
    readme = root / "README.md"
    if readme.is_file():
        text = readme.read_text(encoding="utf-8")
        try:
            if with_head(text, board) != text:
                stale.append("README.md: the leaderboard's head is not what the results give")
        except ValueError as error:
            stale.append(str(error))
    return stale


def _stale_episodes(recorded: Row, found: Row) -> Iterator[str]:
    """Compares every number of every episode, bit for bit; of a metric the first that differs is named."""
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
    places = ("in its results", "now")
    yield from _differences(
        f"{recorded.name} disturbed:", recorded.header["disturbed"], found.header["disturbed"], places
    )


def check(
    root: Path,
    candidates: Sequence[Candidate],
    sets: Sequence[EvaluationSet],
    *,
    evaluated: Sequence[Candidate] | None = None,
    jobs: int = 1,
    horizon: float = HORIZON,
) -> list[str]:
    """What is stale, one line each.

    Args:
        root: the project's folder, with leaderboard.json, LEADERBOARD.md, README.md and the results.
        candidates: the rows that should be there.
        sets: the sets that they should be evaluated on.
        evaluated: the rows to evaluate again; None for all.
        jobs: number of processes.
        horizon: length of an episode in s.
    """
    evaluated = candidates if evaluated is None else evaluated
    try:
        # What needs no evaluation comes first: whoever has to write the leaderboard anew learns it at once.
        rows = load_rows(root / RESULTS, [candidate.name for candidate in candidates])
    except ValueError as error:
        return [str(error)]
    stale = _stale_headers(root / RESULTS, rows, candidates) + list(_stale_sets(rows, sets))
    if not stale:
        board = build(rows, sets)
        stale = _stale_board(root, board) + _stale_pages(root, board)
    if stale:
        return [*stale, *(["the numbers were not evaluated again"] if evaluated else [])]
    recorded = {row.name: row for row in rows}
    found = evaluate(evaluated, sets, jobs=jobs, horizon=horizon)
    return [line for row in found for line in _stale_episodes(recorded[row.name], row)]
