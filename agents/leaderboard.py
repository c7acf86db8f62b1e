"""Writes and checks the leaderboard: every policy on every frozen set.

    python -m agents.leaderboard           writes leaderboard.json, LEADERBOARD.md and the head in the README
    python -m agents.leaderboard --check   fails where they are stale, and says what is

The check compares exactly: the policies listed, their descriptions and training seeds, the sets' hashes, the hash of
every checkpoint's model, normalisation and configuration, and the revisions they were trained at; LEADERBOARD.md and
the README's head must be what leaderboard.json renders to. Then it evaluates everything again with the code at hand
and compares the numbers:

- scripted policies, on sets where none of their episodes fails, to 0.1 %: feedback keeps them on their reference, so
  that machines differ by rounding only;
- all else to the largest of 3 %, 0.01 in the number's unit, and a quarter of the recorded interval, its ends to the
  whole of it; failures to 5 % of the episodes. The last bit of a network in float32 depends on the machine, and what
  is unstable amplifies it: with M and mu changed by 1 part in 10^14 the adaptive law, where it diverges, fails in 42
  episodes of `drift` instead of 39; with 1 part in 10^6 of noise on the actions of a PPO policy single episodes moved
  by up to 0.6 cm/s, and interquartile means by 0.1 %. A change of the physics by rounding moved no mean of a PPO policy
  by more than a tenth of its interval, and an end by up to half of it.

Versions of packages are recorded and not compared. Neither is any revision of the code: the numbers are, so that a
commit makes the leaderboard stale exactly where it changes them.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from agents.candidates import POLICY_FILES, Candidate, Run, all_candidates
from agents.evaluation import Episode, summarise, versions
from agents.leaderboard_page import COMMAND, rank, render, with_head
from agents.reporting import MEASURES, SHARE
from agents.sets import HORIZON, SET_NAMES, EvaluationSet, load_set
from baselines.files import file_hash, to_json, without_nonfinite, write_atomically

ROOT = Path(__file__).resolve().parent.parent
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


def _static_row(candidate: Candidate) -> dict[str, Any]:
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


def _rounded(summary: Mapping[str, Any]) -> dict[str, Any]:
    """The summary's measures to six digits, and its counts."""
    names = [name for name in (*MEASURES, SHARE.metric) if name in summary]
    measures = {name: {end: float(f"{value:.6g}") for end, value in summary[name].items()} for name in names}
    return {**measures, **{name: summary[name] for name in ("episodes", "failures", "resampled")}}


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
        results = iter(list(tqdm(evaluated, "evaluating", len(runs), file=sys.stderr, disable=None, unit="run")))
    rows = []
    for candidate in candidates:
        own = [next(results) for _ in candidate.runs]
        merged = [[episode for run in own for episode in run[i]] for i in range(len(sets))]
        summaries = {s.name: _rounded(summarise(episodes)) for s, episodes in zip(sets, merged, strict=True)}
        rows.append({**_static_row(candidate), "results": summaries})
    board = {"sets": {s.name: s.hash for s in sets}, "versions": versions(), "rows": rank(rows)}
    return without_nonfinite(board)


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


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be an integer >= 1, got {text}")
    return value


def main(arguments: Sequence[str] | None = None, *, root: Path = ROOT) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog=COMMAND, description="Evaluates every policy on every frozen set and writes LEADERBOARD.md."
    )
    parser.add_argument("--check", action="store_true", help="write nothing; fail where the leaderboard is stale")
    parser.add_argument("--jobs", type=_positive, default=os.cpu_count() or 1, help="processes (default: all cores)")
    options = parser.parse_args(arguments)
    sets = [load_set(name) for name in SET_NAMES]
    candidates = all_candidates()
    if options.check:
        stale = check(root, candidates, sets, jobs=options.jobs)
        if stale:
            print("The leaderboard is stale:", *stale, sep="\n- ")
            print(f"Run `{COMMAND}` and commit what it writes.")
            return 1
        print(f"The leaderboard is up to date: {len(candidates)} policies on {len(sets)} sets.")
        return 0
    write(root, build(candidates, sets, jobs=options.jobs))
    print(f"Written: {len(candidates)} policies on {len(sets)} sets, to {root / 'LEADERBOARD.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
