"""Evaluates policies, row by row, and makes the content of leaderboard.json of the rows."""

from __future__ import annotations

import multiprocessing
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tqdm import tqdm

from agents.evaluation.episodes import SHARE_OF_OPTIMUM, TABLE_METRICS, Episode, summarise
from agents.evaluation.policies import CHECKPOINTS, Candidate, Policy
from agents.leaderboard import chaos
from agents.leaderboard.page import rank, render, with_head
from agents.leaderboard.rows import Row, evaluate_run, make_row
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.files import to_json, without_nonfinite, write_atomically
from capsule_gym.task import HORIZON

# A line of the table in agents/checkpoints/README.md.
TRAINED = re.compile(r"^\| `([\w-]+)` \|[^|]*\| `([^`]+)` \|$", re.MULTILINE)


@contextmanager
def _pool(jobs: int) -> Iterator[Any]:
    """The `map` of so many processes."""
    if jobs == 1:
        yield map
        return
    # Spawned and not forked, which Python warns of where there are threads.
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as executor:
        try:
            yield executor.map
        except BaseException:
            # What has not begun would be waited for.
            executor.shutdown(cancel_futures=True)
            raise


def _work(item: Policy | Candidate, sets: Sequence[EvaluationSet], horizon: float) -> Any:
    """One run on all sets, or how chaotic a policy is."""
    return chaos.measure(item, horizon) if isinstance(item, Candidate) else evaluate_run(item, sets, horizon)


def evaluate(
    candidates: Sequence[Candidate], sets: Sequence[EvaluationSet], *, jobs: int = 1, horizon: float = HORIZON
) -> Iterator[Row]:
    """Evaluates policies, with a progress bar on a terminal; gives each row as soon as it is there.

    Args:
        candidates: the rows.
        sets: what they are evaluated on.
        jobs: number of processes.
        horizon: length of an episode in s.
    """
    work = [item for candidate in candidates for item in (*candidate.policies, candidate)]
    with _pool(jobs) as pool_map:
        found = pool_map(_work, work, [sets] * len(work), [horizon] * len(work))
        found = iter(tqdm(found, "evaluating", len(work), file=sys.stderr, disable=None))
        for candidate in candidates:
            runs = [next(found) for _ in candidate.policies]
            yield make_row(candidate, sets, runs, next(found))


def _rounded(value: Any, digits: int) -> Any:
    """The same nested dicts with floats to so many significant digits."""
    if isinstance(value, dict):
        return {key: _rounded(entry, digits) for key, entry in value.items()}
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def _summary(episodes: Sequence[Episode]) -> dict[str, Any]:
    """What a row says of one set: its measures, to six digits, and its counts."""
    summary = summarise(episodes)
    shown = (*TABLE_METRICS, SHARE_OF_OPTIMUM.name, "episodes", "failures", "resampled")
    return {name: _rounded(summary[name], 6) for name in shown if name in summary}


def training_commands() -> dict[str, str]:
    """The command that trains each checkpoint, from the table in its README."""
    path = CHECKPOINTS / "README.md"
    return dict(TRAINED.findall(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def build(rows: Sequence[Row], sets: Sequence[EvaluationSet]) -> dict[str, Any]:
    """The content of leaderboard.json, from the rows alone.

    Args:
        rows: in any order.
        sets: the columns; one of them is the ranking set.

    Raises:
        ValueError: if a row was evaluated on other sets.
    """
    trained = training_commands()
    content = []
    for row in rows:
        entry = {name: row.header[name] for name in ("policy", "description", "training_seeds", "revision", "files")}
        if row.trained:
            entry |= {"base": row.header["base"], "trained_by": trained.get(row.name)}
        summaries = {each.name: _summary(row.episodes(each)) for each in sets}
        content.append({**entry, "results": summaries, "disturbed": _rounded(row.header["disturbed"], 6)})
    board = {"sets": {each.name: each.hash for each in sets}, "versions": _versions(rows), "rows": rank(content)}
    return without_nonfinite(board)


def _versions(rows: Sequence[Row]) -> dict[str, str]:
    """The versions that the rows were evaluated with; where they differ, all of them."""
    found: dict[str, set[str]] = {}
    for row in rows:
        for package, number in row.header["versions"].items():
            found.setdefault(package, set()).add(number)
    return {package: ", ".join(sorted(numbers)) for package, numbers in found.items()}


def write(root: Path, board: Mapping[str, Any]) -> None:
    """Writes leaderboard.json, LEADERBOARD.md and, between its markers, the README's head.

    Args:
        root: the folder that they lie in.
        board: what `build` returned.
    """
    readme = root / "README.md"
    text = readme.read_text(encoding="utf-8") if readme.is_file() else ""
    # The README first: broken markers are an error, and nothing should be half written then.
    updated = with_head(text, board)
    if updated != text:
        write_atomically(readme, updated)
    write_atomically(root / "leaderboard.json", to_json(board))
    write_atomically(root / "LEADERBOARD.md", render(board))
