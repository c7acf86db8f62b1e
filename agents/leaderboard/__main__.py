"""Writes and checks the leaderboard, every policy on every frozen set: `python -m agents.leaderboard`.

The episodes of all policies are written to agents/leaderboard/results. leaderboard.json, LEADERBOARD.md and the
README's table depend only on these files.

The check is exact. It compares the list of policies, their descriptions and training seeds, the sets' hashes, the hash
of every policy file and the revisions of the trainings. leaderboard.json and the pages must match the results. Then the
check evaluates all policies again with the current code and compares every bit of every episode. It compares neither
versions of packages nor the revision of the code, so a commit makes the leaderboard stale only if it changes a number.
The sensitivity is not evaluated again: it follows from the same code and takes almost as long as everything else.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from agents.leaderboard import chart
from agents.leaderboard.page import COMMAND, build, files, training_commands
from agents.leaderboard.rows import RESULTS, Row, evaluate, load_rows, save_row, static_header
from baselines.evaluation.policies import Candidate, all_candidates
from capsule_gym.checks import nearest
from capsule_gym.command_line import Count, Positional, arg, parse, refuse
from capsule_gym.evaluation_sets import FURTHER_SET_NAMES, SET_NAMES, TASK_SET_NAMES, EvaluationSet, load_set
from capsule_gym.files import write_atomically
from capsule_gym.task import TASKS

ROOT = Path(__file__).resolve().parents[2]
SETS = SET_NAMES + FURTHER_SET_NAMES + TASK_SET_NAMES


@dataclass(frozen=True)
class Args:
    """Evaluates policies on every frozen set, and writes leaderboard.json, LEADERBOARD.md and the README's table.

    Examples:
      python -m agents.leaderboard                    evaluate every policy and write everything
      python -m agents.leaderboard direct-ppo         evaluate one policy and write everything
      python -m agents.leaderboard --from-results     write everything from stored results
      python -m agents.leaderboard --check            fail if anything is stale, and print it
    """

    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME")] = ()
    """Policies to evaluate; all by default."""
    check: bool = False
    """Write nothing; fail if the leaderboard is stale."""
    from_results: bool = False
    """Use the stored results instead of evaluating."""
    plants: Count | None = None
    """With --check, number of plants per set that are evaluated again; all by default."""
    jobs: int = os.cpu_count() or 1
    """Processes."""


def _stale_headers(
    rows: Sequence[Row], candidates: Sequence[Candidate], sets: Sequence[EvaluationSet]
) -> Iterator[str]:
    """Compares the fields of the headers that do not require an evaluation."""
    commands = training_commands()
    for row, candidate in zip(rows, candidates, strict=True):
        hashes = {each.name: each.hash for each in sets if each.task == candidate.task}
        for field, now in {**static_header(candidate), "sets": hashes}.items():
            if row.header[field] != now:
                yield f"{row.name}: {field} differs from its results"
        if row.trained and row.name not in commands:
            yield f"{row.name}: the table in agents/checkpoints/README.md has no command that trains it"


def _stale_episodes(recorded: Row, found: Row, plants: int | None) -> Iterator[str]:
    """Compares every number of every episode bit for bit; reports the first difference in each metric."""
    seeds = recorded.header["training_seeds"]
    for set_name, scores in recorded.scores.items():
        values, now = scores[:, :, :plants], found.scores[set_name]
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
    plants: int | None = None,
    jobs: int = 1,
    horizon: float | None = None,
) -> list[str]:
    """Lists stale files, one line each.

    Args:
        root: the project's folder, with leaderboard.json, LEADERBOARD.md, README.md and the results.
        candidates: the expected rows.
        sets: the sets of all tasks.
        evaluated: the rows to evaluate again.
        plants: number of plants per set to evaluate again, from the first on; None takes all.
        jobs: number of processes.
        horizon: length of an episode in s; None takes that of the task.
    """
    names = [candidate.name for candidate in candidates]
    # Checks without an evaluation come first, since they are fast.
    extra = [path.stem for path in sorted((root / RESULTS).glob("*.npz")) if path.stem not in names]
    stale = [f"{name}: has results and does not exist" for name in extra]
    try:
        rows = load_rows(root / RESULTS, names)
        stale += _stale_headers(rows, candidates, sets)
        if not stale:
            for name, text in files(root, build(rows, sets)).items():
                path = root / name
                if not path.is_file() or path.read_text(encoding="utf-8") != text:
                    stale.append(f"{name} differs from the results")
    except ValueError as error:
        stale.append(str(error))
    if stale:
        return [*stale, *(["the numbers were not evaluated again"] if evaluated else [])]
    recorded = {row.name: row for row in rows}
    sets = [replace(each, plants=each.plants[:plants]) for each in sets]
    found = evaluate(evaluated, sets, jobs=jobs, horizon=horizon, disturbed=False)
    return [line for row in found for line in _stale_episodes(recorded[row.name], row, plants)]


def main(arguments: Sequence[str] | None = None, *, root: Path = ROOT) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    try:
        if args.jobs < 1:
            raise ValueError(f"--jobs must be an integer >= 1, got {args.jobs}")
        if args.plants is not None and (args.plants < 1 or not args.check):
            raise ValueError(f"--plants must be an integer >= 1 and needs --check, got {args.plants}")
        if args.names and args.from_results:
            raise ValueError(f"--from-results must be given without names, got {' '.join(args.names)}")
        candidates = [candidate for task in TASKS for candidate in all_candidates(task)]
        names = [candidate.name for candidate in candidates]
        unknown = [name for name in args.names if name not in names]
        if unknown:
            raise ValueError(f"names must be among {', '.join(names)}, got {unknown[0]}{nearest(unknown[0], names)}")
    except ValueError as error:
        refuse(COMMAND, str(error))
    chosen = [] if args.from_results else [each for each in candidates if each.name in (args.names or names)]
    sets = [load_set(name) for name in SETS]
    if args.check:
        stale = check(root, candidates, sets, evaluated=chosen, plants=args.plants, jobs=args.jobs)
        if stale:
            print("The leaderboard is stale:", *stale, sep="\n- ")
            print(f"Run `{COMMAND}` and commit what it writes.")
            return 1
        print(f"The leaderboard is up to date: {len(candidates)} policies on {len(sets)} sets.")
        return 0
    try:
        for row in evaluate(chosen, sets, jobs=args.jobs):
            save_row(root / RESULTS, row)
    except KeyboardInterrupt:
        print(f"Stopped. The rows that were finished are kept in {root / RESULTS}; the pages are as they were.")
        return 130
    try:
        texts = files(root, build(load_rows(root / RESULTS, names), sets))
    except ValueError as error:
        refuse(COMMAND, str(error))
    for name, text in texts.items():
        write_atomically(root / name, text)
    print(f"Written: {len(candidates)} policies on {len(sets)} sets, to {root / 'LEADERBOARD.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
