"""Writes and checks the leaderboard: `python -m agents.leaderboard`.

The leaderboard has every policy on every frozen set. The episodes of all policies are written to
agents/leaderboard/results; leaderboard.json, the pages and the chart depend only on these files.

The check compares headers, pages and every bit of every episode with the results, but not the
versions of packages.
"""

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np

from agents.leaderboard.candidates import all_candidates
from agents.leaderboard.chart import CHART, digest, draw
from agents.leaderboard.page import COMMAND, build, files
from agents.leaderboard.rows import (
    RESULTS,
    LeaderboardRow,
    evaluate,
    load_row,
    load_rows,
    save_row,
    static_header,
)
from agents.training.signals import INTERRUPTED
from capsule_gym.checks import check_count, nearest, require
from capsule_gym.command_line import Count, Positional, arg, command
from capsule_gym.evaluation.candidates import Candidate
from capsule_gym.evaluation.sets import (
    FURTHER_SET_NAMES,
    SET_NAMES,
    TASK_SET_NAMES,
    EvaluationSet,
    load_set,
)
from capsule_gym.files import write_atomically
from capsule_gym.policies.loading import refuse_archive
from capsule_gym.tasks.registry import TASKS

ROOT = Path(__file__).resolve().parents[2]
SETS = SET_NAMES + FURTHER_SET_NAMES + TASK_SET_NAMES


def uncommitted(candidates: Sequence[Candidate]) -> list[str]:
    """The policies that cannot be trained again, since their training code was not committed."""
    found = []
    for candidate in candidates:
        for policy in candidate.trained:
            if "+" in policy.revision:
                name = f"{candidate.name}/seed-{policy.training_seed}"
                found.append(f"{name}: the revision {policy.revision} is not committed")
    return found


def find_stale(
    root: Path, candidates: Sequence[Candidate], sets: Sequence[EvaluationSet]
) -> Iterator[str]:
    """Lists what is stale without an evaluation: headers of rows, the pages, the chart.

    Raises:
        ValueError: if results are missing, or are those of other sets.
    """
    names = [candidate.name for candidate in candidates]
    for path in sorted((root / RESULTS).glob("*.npz")):
        if path.stem not in names:
            yield f"{path.stem}: has results and does not exist"
    yield from uncommitted(candidates)
    rows = load_rows(root / RESULTS, names)
    for row, candidate in zip(rows, candidates, strict=True):
        header = static_header(candidate)
        header["sets"] = {each.name: each.hash for each in sets if each.task == candidate.task}
        for field, now in header.items():
            if row.header[field] != now:
                yield f"{row.name}: {field} differs from its results"
    board = build(rows, sets)
    for name, text in files(root, board).items():
        if _read_if_any(root / name) != text:
            yield f"{name} differs from the results"
    if digest(board) not in _read_if_any(root / CHART):
        yield f"{CHART} differs from the results"


def _read_if_any(path: Path) -> str:
    """A file's text; empty if it does not exist."""
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def check_episodes(root: Path, rows: Iterable[LeaderboardRow]) -> Iterator[str]:
    """Compares rows with the first episodes of the results, bit for bit.

    Lists the first difference on each set.
    """
    for row in rows:
        recorded = load_row(root / RESULTS / f"{row.name}.npz")
        for set_name, now in row.scores.items():
            before = recorded.scores[set_name][:, :, : now.shape[2]]
            differs = np.argwhere(before.view(np.uint64) != now.view(np.uint64))
            if differs.size:
                metric, run, episode = differs[0].tolist()
                was, value = (each[metric, run, episode].item() for each in (before, now))
                name = row.header["metrics"][metric]
                seed = f"training seed {row.header['training_seeds'][run]}, " if row.trained else ""
                where = f"{seed}episode {episode}; {len(differs)} of {now.size} differ"
                numbers = f"{was!r} in its results and {value!r} now"
                yield f"{row.name} on {set_name}: {name} is {numbers} ({where})"


@command(COMMAND, ValueError)
def main(
    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME")] = (),
    check: bool = False,
    from_results: bool = False,
    plants: Count | None = None,
    jobs: int = os.cpu_count() or 1,
) -> int:
    """Evaluates policies on every frozen set, and writes leaderboard.json, the pages and the chart.

    Examples:
      python -m agents.leaderboard                    evaluate every policy and write everything
      python -m agents.leaderboard direct-ppo         evaluate one policy and write everything
      python -m agents.leaderboard --from-results     write everything from stored results
      python -m agents.leaderboard --check            fail if anything is stale, and print it

    Args:
        names: Policies to evaluate; all by default.
        check: Write nothing; fail if the leaderboard is stale.
        from_results: Use the stored results instead of evaluating.
        plants: With --check, number of plants per set that are evaluated again; all by default.
        jobs: Processes.
    """
    candidates = [each for task in TASKS for each in all_candidates(task)]
    sets = [load_set(name) for name in SETS]
    known = [candidate.name for candidate in candidates]
    check_count("--jobs", jobs)
    if plants is not None:
        require(plants >= 1 and check, "--plants", "an integer >= 1, with --check", plants)
    require(not (names and from_results), "--from-results", "given without names", " ".join(names))
    for name in names:
        if name not in known:
            if os.path.isfile(name):
                refuse_archive(name)
            accepted = f"among {', '.join(known)}"
            raise ValueError(f"names must be {accepted}, got {name}{nearest(name, known)}")
    chosen = [] if from_results else [each for each in candidates if each.name in (names or known)]
    if check:
        stale = list(find_stale(ROOT, candidates, sets))
        if not stale:
            sets = [replace(each, plants=each.plants[:plants]) for each in sets]
            stale += check_episodes(ROOT, evaluate(chosen, sets, jobs=jobs))
        result = "The leaderboard is stale:" if stale else "The leaderboard is up to date."
        print(result, *stale, sep="\n- ")
        return int(bool(stale))
    for line in uncommitted(chosen):
        raise ValueError(line)
    try:
        for row in evaluate(chosen, sets, jobs=jobs):
            save_row(ROOT / RESULTS, row)
    except KeyboardInterrupt:
        print(f"Stopped. The rows that were finished are kept in {ROOT / RESULTS}.")
        return INTERRUPTED
    board = build(load_rows(ROOT / RESULTS, known), sets)
    texts = files(ROOT, board)
    texts[CHART] = draw(board)
    for path, text in texts.items():
        write_atomically(ROOT / path, text)
    print(f"Written: {len(candidates)} policies on {len(sets)} sets, to {ROOT / 'LEADERBOARD.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
