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

from baselines.dynamic_programming.archive import UNREADABLE
from capsule_gym.evaluation.candidates import AnyPolicy, Candidate
from capsule_gym.evaluation.episodes import Episode, as_episodes, versions
from capsule_gym.evaluation.episodes import evaluate as evaluate_policy
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.files import write_atomically
from capsule_gym.policies.policy import POLICY
from capsule_gym.tasks.registry import TASKS, find_task
from capsule_gym.tasks.task import METRICS

# Relative to the project's folder.
RESULTS = Path("agents", "leaderboard", "results")
COLUMNS = tuple(name for name in METRICS if name not in ("distance", "energy"))


@dataclass(frozen=True, eq=False)
class LeaderboardRow:
    """All episodes of one policy: the header, and the arrays by the set's name; a scripted policy
    has one run.
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
        found: np.ndarray = self.scores[set_name][self.header["metrics"].index(metric)]
        return found

    def episodes(self, evaluation_set: EvaluationSet) -> list[Episode]:
        """The episodes as `capsule_gym.evaluate` returns them, without the omitted metrics.

        Raises:
            ValueError: if the row was evaluated on another set of this name, or on none.
        """
        self.check_set(evaluation_set)
        found = []
        for i, seed in enumerate(self.header["training_seeds"] or [None]):
            metrics = dict(
                zip(self.header["metrics"], self.scores[evaluation_set.name][:, i], strict=True)
            )
            found += as_episodes(evaluation_set, metrics, training_seed=seed)
        return found

    def check_set(self, evaluation_set: EvaluationSet) -> None:
        """Raises a ValueError if the row was evaluated on another set of this name, or on none."""
        recorded = self.header["sets"].get(evaluation_set.name)
        if recorded != evaluation_set.hash:
            raise ValueError(
                f"{self.name}: the hash of the set {evaluation_set.name} is {recorded} in its results and "
                f"{evaluation_set.hash} now"
            )


def static_header(candidate: Candidate) -> dict[str, Any]:
    """The fields of a row's header that do not require an evaluation."""
    trained, folder = candidate.trained, candidate.folder
    files = (
        {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob(POLICY))}
        if folder
        else {}
    )
    return {
        "policy": candidate.name,
        "description": candidate.description,
        "training_seeds": [policy.training_seed for policy in trained],
        "revision": ", ".join(dict.fromkeys(policy.revision for policy in trained)) or None,
        "files": {
            name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()
        },
        "base": candidate.base,
    }


def columns(task: str) -> list[str]:
    """The metrics in rows of a task."""
    return [*COLUMNS, *find_task(task).metrics]


def _work(
    policy: AnyPolicy, sets: Sequence[EvaluationSet], horizon: float | None
) -> dict[str, np.ndarray]:
    """The metrics of one run by the set's name, each of shape (metrics, episodes)."""
    found = {}
    for each in sets:
        episodes = evaluate_policy(policy, each, horizon=horizon)
        found[each.name] = np.array(
            [[episode[name] for episode in episodes] for name in columns(each.task)]
        )
    return found


def evaluate(
    candidates: Sequence[Candidate],
    sets: Sequence[EvaluationSet],
    *,
    jobs: int = 1,
    horizon: float | None = None,
) -> Iterator[LeaderboardRow]:
    """Evaluates policies on the sets of their task, with a progress bar; yields each row as soon as
    it is finished.

    `jobs` is the number of processes, `horizon` the length of an episode in s.
    """
    # Imported here, since the import is slow and --help does not need it.
    from joblib import Parallel, delayed

    own = {
        candidate.name: [each for each in sets if each.task == candidate.task]
        for candidate in candidates
    }
    work = [(policy, candidate) for candidate in candidates for policy in candidate.policies]
    if not work:
        return
    results = Parallel(jobs, return_as="generator")(
        delayed(_work)(policy, own[candidate.name], horizon) for policy, candidate in work
    )
    found = iter(tqdm(results, "evaluating", len(work), file=sys.stderr, disable=None))
    for candidate in candidates:
        runs = [next(found) for _ in candidate.policies]
        header = {
            **static_header(candidate),
            "metrics": columns(candidate.task),
            "sets": {each.name: each.hash for each in own[candidate.name]},
            "versions": versions(),
        }
        yield LeaderboardRow(
            header, {name: np.stack([run[name] for run in runs], axis=1) for name in header["sets"]}
        )


def save_row(folder: Path, row: LeaderboardRow) -> None:
    """Writes a row's file atomically; the same row gives the same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {
        "header": np.frombuffer(json.dumps(row.header).encode(), np.uint8),
        **row.scores,
    }
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_atomically(folder / f"{row.name}.npz", content.getvalue())


def load_row(path: Path) -> LeaderboardRow:
    """Reads a row's file.

    Raises:
        ValueError: if the file does not exist, or was not written by `save_row`.
    """
    if not path.is_file():
        raise ValueError(
            f"{path.stem}: no results in {path.name}; `python -m agents.leaderboard NAME` writes them"
        )
    try:
        # Read from memory, since numpy does not close an invalid file.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            header = json.loads(archive["header"].tobytes().decode())
            scores = {name: archive[name] for name in header["sets"]}
        shape = (len(header["metrics"]), max(1, len(header["training_seeds"])))
        fits = all(
            values.dtype == np.float64 and values.shape[:2] == shape for values in scores.values()
        )
        if header["policy"] != path.stem or not fits:
            raise ValueError("its header does not match its name or arrays")
    except UNREADABLE as error:
        raise ValueError(
            f"{path.stem}: {path.name} contains no results: {type(error).__name__}: {error}"
        ) from error
    return LeaderboardRow(header, scores)


def load_rows(folder: Path, names: Iterable[str]) -> list[LeaderboardRow]:
    """Reads the rows of policies, in order, with the errors of `load_row`."""
    return [load_row(folder / f"{name}.npz") for name in names]
