"""The rows of the leaderboard: every episode of every training run, in one file per policy.

`agents/leaderboard/results/NAME.npz` is a numpy archive without pickles. It contains a float64
array of shape (metrics, training seeds, episodes) for every set, and under `header` a JSON text in
UTF-8: the policy, its description, training seeds, revisions, files (sha256) and base law;
`metrics`, the first axis of the arrays; the `sets` (sha256); the `versions` that evaluated it.

Distance, energy and share of the optimum are omitted, since they follow from speed, cost of
transport and plant.
"""

import hashlib
import io
import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from capsule_gym.evaluation.candidates import AnyPolicy, Candidate
from capsule_gym.evaluation.episodes import Episode, as_episodes, versions
from capsule_gym.evaluation.episodes import evaluate as evaluate_policy
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.files import load_arrays, write_atomically
from capsule_gym.policies.policy import POLICY
from capsule_gym.tasks.registry import TASKS, find_task
from capsule_gym.tasks.task import METRICS

# Relative to the project's folder.
RESULTS = Path("agents", "leaderboard", "results")
# Of the arrays in a file: little-endian on every machine.
DTYPE = np.dtype("<f8")
COLUMNS = tuple(name for name in METRICS if name not in ("distance", "energy"))


@dataclass(frozen=True, eq=False)
class LeaderboardRow:
    """All episodes of one policy: the header, and the arrays by the set's name.

    A scripted policy has one run.
    """

    header: dict[str, Any]
    scores: dict[str, np.ndarray]

    @property
    def name(self) -> str:
        """The policy's name."""
        return str(self.header["policy"])

    @property
    def trained(self) -> bool:
        """Whether the policy was trained."""
        return bool(self.header["training_seeds"])

    @property
    def task(self) -> str:
        """The task of the metrics."""
        return next(task for task in TASKS if columns(task) == self.header["metrics"])

    def score(self, set_name: str, metric: str) -> np.ndarray:
        """The values of a metric in all episodes of a set, shape (runs, episodes)."""
        column = self.header["metrics"].index(metric)
        return np.asarray(self.scores[set_name][column])

    def episodes(self, evaluation_set: EvaluationSet) -> list[Episode]:
        """The episodes as `capsule_gym.evaluate` returns them, without the omitted metrics.

        Raises:
            ValueError: if the row was evaluated on another set of this name, or on none.
        """
        self.check_set(evaluation_set)
        values = self.scores[evaluation_set.name]
        found = []
        for run, seed in enumerate(self.header["training_seeds"] or [None]):
            metrics = dict(zip(self.header["metrics"], values[:, run], strict=True))
            found += as_episodes(evaluation_set, metrics, training_seed=seed)
        return found

    def check_set(self, evaluation_set: EvaluationSet) -> None:
        """Raises a ValueError if the row was evaluated on another set of this name, or on none."""
        recorded = self.header["sets"].get(evaluation_set.name)
        if recorded != evaluation_set.hash:
            raise ValueError(
                f"{self.name}: the hash of the set {evaluation_set.name} is {recorded} in its "
                f"results and {evaluation_set.hash} now"
            )


def static_header(candidate: Candidate) -> dict[str, Any]:
    """The fields of a row's header that do not require an evaluation."""
    revisions = dict.fromkeys(policy.revision for policy in candidate.trained)
    hashes = {}
    if candidate.folder is not None:
        for path in sorted(candidate.folder.rglob(POLICY)):
            name = path.relative_to(candidate.folder).as_posix()
            hashes[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return {
        "policy": candidate.name,
        "description": candidate.description,
        "training_seeds": [policy.training_seed for policy in candidate.trained],
        "revision": ", ".join(revisions) or None,
        "files": hashes,
        "base": candidate.base,
    }


def columns(task: str) -> list[str]:
    """The metrics in rows of a task."""
    return [*COLUMNS, *find_task(task).metrics]


def _evaluate_run(
    policy: AnyPolicy, sets: Sequence[EvaluationSet], horizon: float | None
) -> dict[str, np.ndarray]:
    """The metrics of one run by the set's name, each of shape (metrics, episodes)."""
    found = {}
    for each in sets:
        episodes = evaluate_policy(policy, each, horizon=horizon)
        names = columns(each.task)
        found[each.name] = np.array([[episode[name] for episode in episodes] for name in names])
    return found


def evaluate(
    candidates: Sequence[Candidate],
    sets: Sequence[EvaluationSet],
    *,
    jobs: int = 1,
    horizon: float | None = None,
) -> Iterator[LeaderboardRow]:
    """Evaluates policies on the sets of their task; yields each row as soon as it is finished.

    `jobs` is the number of processes, `horizon` the length of an episode in s.
    """
    # Imported here, since the import is slow and --help does not need it.
    from joblib import Parallel, delayed

    # A set keeps its hash: computed while a thread pickles the set for another process, it would
    # change what is pickled.
    hash_of = {each.name: each.hash for each in sets}
    sets_of: dict[str, list[EvaluationSet]] = {}
    work = []
    for candidate in candidates:
        own_sets = sets_of[candidate.name] = [each for each in sets if each.task == candidate.task]
        for policy in candidate.policies:
            work.append(delayed(_evaluate_run)(policy, own_sets, horizon))
    if not work:
        return
    results = Parallel(jobs, return_as="generator")(work)
    bar = iter(tqdm(results, "evaluating", len(work), file=sys.stderr, disable=None))
    for candidate in candidates:
        runs = [next(bar) for _ in candidate.policies]
        hashes = {each.name: hash_of[each.name] for each in sets_of[candidate.name]}
        scores = {name: np.stack([run[name] for run in runs], axis=1) for name in hashes}
        header = static_header(candidate)
        header |= {"metrics": columns(candidate.task), "sets": hashes, "versions": versions()}
        yield LeaderboardRow(header, scores)


def save_row(folder: Path, row: LeaderboardRow) -> None:
    """Writes a row's file atomically; the same row gives the same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    header: Any = np.frombuffer(json.dumps(row.header).encode(), np.uint8)
    content = io.BytesIO()
    scores: dict[str, Any] = {name: values.astype(DTYPE) for name, values in row.scores.items()}
    np.savez_compressed(content, header=header, **scores)
    write_atomically(folder / f"{row.name}.npz", content.getvalue())


def load_row(path: Path) -> LeaderboardRow:
    """Reads a row's file.

    Raises:
        ValueError: if the file does not exist, or was not written by `save_row`.
    """
    if not path.is_file():
        hint = "`python -m agents.leaderboard NAME` writes them"
        raise ValueError(f"{path.stem}: no results in {path.name}; {hint}")
    try:
        arrays = load_arrays(path)
        header = json.loads(arrays["header"].tobytes().decode())
        scores = {name: arrays[name] for name in header["sets"]}
        runs = max(1, len(header["training_seeds"]))
        expected = (DTYPE, (len(header["metrics"]), runs))
        fits = all((each.dtype, each.shape[:2]) == expected for each in scores.values())
        if header["policy"] != path.stem or not fits:
            raise ValueError("its header does not match its name or arrays")
    # Any content may stand in the header.
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"{path.stem}: {path.name} contains no results: {reason}") from error
    return LeaderboardRow(header, scores)


def load_rows(folder: Path, names: Iterable[str]) -> list[LeaderboardRow]:
    """Reads the rows of policies, in order, with the errors of `load_row`."""
    return [load_row(folder / f"{name}.npz") for name in names]
