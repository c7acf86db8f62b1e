"""The content of leaderboard.json: every policy evaluated on every frozen set, and how chaotic its numbers are."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from agents.evaluation.candidates import POLICY_FILES, Candidate, Run
from agents.evaluation.episodes import Episode, summarise, versions
from agents.evaluation.sets import EvaluationSet
from agents.evaluation.tables import MEASURES, SHARE
from agents.leaderboard import tolerance
from agents.leaderboard.page import rank, render, with_head
from capsule_gym.files import file_hash, to_json, without_nonfinite, write_atomically
from capsule_gym.task import HORIZON

T = TypeVar("T")


def _one_thread() -> None:
    """Keeps a worker's networks to one thread: the workers already fill the machine."""
    os.environ["OMP_NUM_THREADS"] = "1"


def _evaluate_run(run: Run, sets: Sequence[EvaluationSet], horizon: float) -> list[list[Episode]]:
    return [run.evaluate(evaluation_set, horizon) for evaluation_set in sets]


@contextmanager
def _pool(jobs: int) -> Iterator[Any]:
    """The `map` of so many processes."""
    if jobs == 1:
        yield map
        return
    # Spawned and not forked: numba's and torch's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_one_thread) as executor:
        yield executor.map


def _with_progress(doing: str, results: Iterable[T], count: int) -> list[T]:
    """All results, with a progress bar on a terminal."""
    return list(tqdm(results, doing, count, file=sys.stderr, disable=None))


def static_row(candidate: Candidate) -> dict[str, Any]:
    """What a row says before anything is evaluated."""
    revisions = dict.fromkeys(run.revision for run in candidate.runs if run.revision)
    folder = candidate.folder
    paths = sorted(path for name in POLICY_FILES for path in folder.rglob(name)) if folder else []
    return {
        "policy": candidate.name,
        "description": candidate.description,
        "training_seeds": [run.training_seed for run in candidate.runs if run.training_seed is not None],
        "revision": ", ".join(revisions) or None,
        "files": {path.relative_to(folder).as_posix(): file_hash(path) for path in paths if folder},
    }


def _rounded(value: Any, digits: int) -> Any:
    """The same nested dicts with floats to so many significant digits."""
    if isinstance(value, dict):
        return {key: _rounded(entry, digits) for key, entry in value.items()}
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def _summary(episodes: Sequence[Episode]) -> dict[str, Any]:
    """What a row says of one set: its measures, to six digits, and its counts."""
    summary = summarise(episodes)
    shown = (*MEASURES, SHARE.metric, "episodes", "failures", "resampled")
    return {name: _rounded(summary[name], 6) for name in shown if name in summary}


def build(
    candidates: Sequence[Candidate],
    sets: Sequence[EvaluationSet],
    *,
    jobs: int = 1,
    horizon: float = HORIZON,
    with_spread: bool = True,
) -> dict[str, Any]:
    """Evaluates everything: the content of leaderboard.json.

    Args:
        candidates: the rows.
        sets: the columns; one of them is the ranking set.
        jobs: number of processes.
        horizon: length of an episode in s.
        with_spread: whether to measure every number's spread too, which takes several times as long.
    """
    runs = [run for candidate in candidates for run in candidate.runs]
    pairs = [(candidate, evaluation_set) for candidate in candidates for evaluation_set in sets]
    with _pool(jobs) as run_map:
        evaluated = run_map(_evaluate_run, runs, [sets] * len(runs), [horizon] * len(runs))
        results = iter(_with_progress("evaluating", evaluated, len(runs)))
        if with_spread:
            measured = run_map(tolerance.measure, *zip(*pairs, strict=True), [horizon] * len(pairs))
            spreads = iter(_with_progress("measuring the spread", measured, len(pairs)))
    rows = []
    for candidate in candidates:
        own = [next(results) for _ in candidate.runs]
        summaries = {s.name: _summary([episode for run in own for episode in run[i]]) for i, s in enumerate(sets)}
        if with_spread:
            for summary in summaries.values():
                summary["spread"] = _rounded(next(spreads), 3)
        rows.append({**static_row(candidate), "results": summaries})
    board = {"sets": {s.name: s.hash for s in sets}, "versions": versions(), "rows": rank(rows)}
    return without_nonfinite(board)


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
