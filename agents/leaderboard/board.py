"""The content of leaderboard.json: every policy evaluated on every frozen set, and how chaotic it is."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from agents.evaluation.candidates import Candidate, Run
from agents.evaluation.episodes import Episode, summarise, versions
from agents.evaluation.sets import EvaluationSet
from agents.evaluation.tables import MEASURES, SHARE
from agents.leaderboard import chaos
from agents.leaderboard.page import rank, render, with_head
from capsule_gym.files import file_hash, to_json, without_nonfinite, write_atomically
from capsule_gym.policy import POLICY
from capsule_gym.task import HORIZON

T = TypeVar("T")


def _evaluate_run(run: Run, sets: Sequence[EvaluationSet], horizon: float) -> list[list[Episode]]:
    return [run.evaluate(evaluation_set, horizon) for evaluation_set in sets]


@contextmanager
def _pool(jobs: int) -> Iterator[Any]:
    """The `map` of so many processes."""
    if jobs == 1:
        yield map
        return
    # Spawned and not forked, which Python warns of where there are threads.
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as executor:
        yield executor.map


def _with_progress(doing: str, results: Iterable[T], count: int) -> list[T]:
    """All results, with a progress bar on a terminal."""
    return list(tqdm(results, doing, count, file=sys.stderr, disable=None))


def static_row(candidate: Candidate) -> dict[str, Any]:
    """What a row says before anything is evaluated."""
    revisions = dict.fromkeys(run.revision for run in candidate.runs if run.revision)
    folder = candidate.folder
    paths = sorted(folder.rglob(POLICY)) if folder else []
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
    candidates: Sequence[Candidate], sets: Sequence[EvaluationSet], *, jobs: int = 1, horizon: float = HORIZON
) -> dict[str, Any]:
    """Evaluates everything: the content of leaderboard.json.

    Args:
        candidates: the rows.
        sets: the columns; one of them is the ranking set.
        jobs: number of processes.
        horizon: length of an episode in s.
    """
    runs = [run for candidate in candidates for run in candidate.runs]
    with _pool(jobs) as run_map:
        evaluated = run_map(_evaluate_run, runs, [sets] * len(runs), [horizon] * len(runs))
        disturbed = run_map(chaos.measure, candidates, [horizon] * len(candidates))
        results = iter(_with_progress("evaluating", evaluated, len(runs)))
        ranges = _with_progress("disturbing", disturbed, len(candidates))
    rows = []
    for candidate, speeds in zip(candidates, ranges, strict=True):
        own = [next(results) for _ in candidate.runs]
        summaries = {s.name: _summary([episode for run in own for episode in run[i]]) for i, s in enumerate(sets)}
        rows.append({**static_row(candidate), "results": summaries, "disturbed": _rounded(speeds, 6)})
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
