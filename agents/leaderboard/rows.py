"""The rows of the leaderboard: every episode of every training run, in one file per policy.

`agents/leaderboard/results/NAME.npz` is a numpy archive without pickles. It contains a float64 array of shape (metrics,
training seeds, episodes) for every set, and under `header` a JSON text in UTF-8:

| field | meaning |
|---|---|
| `policy`, `description` | the policy |
| `training_seeds`, `revision`, `files` | its runs, the git revision of the training, the sha256 of each policy file |
| `base` | the scripted policy whose law runs inside its step; null for none |
| `metrics` | the rows of the arrays |
| `sets` | the sha256 of each set's content |
| `versions` | of Python and of the packages that evaluated it |
| `disturbed` | of the speed task: the range of the mean speed under small noise on the actions (`disturbed_range`) |

Distance and energy are omitted, since they follow from speed and cost of transport. The share of the optimum is
omitted, since it follows from speed and plant.
"""

from __future__ import annotations

import hashlib
import io
import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from tqdm import tqdm

from baselines.archive import UNREADABLE
from baselines.evaluation.episodes import Episode, as_episodes, versions
from baselines.evaluation.episodes import evaluate as evaluate_policy
from baselines.evaluation.policies import Candidate, Policy
from capsule_gym.config import find_task
from capsule_gym.evaluation_sets import NOMINAL_PLANT, EvaluationSet
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY
from capsule_gym.task import HORIZON, METRICS, TASKS

# Relative to the project's folder.
RESULTS = Path("agents", "leaderboard", "results")
COLUMNS = tuple(name for name in METRICS if name not in ("distance", "energy"))
HEADER = "header"
# Half width of the noise on the actions, relative to the full action: the rounding error of a network in float32.
NOISE = 1e-7
COPIES = 200


@dataclass(frozen=True, eq=False)
class Row:
    """All episodes of one policy, and the sources of their evaluation.

    Attributes:
        header: the fields of the table above.
        scores: metrics by the set's name, shape (metrics, runs, episodes); a scripted policy has one run.
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
        """The episodes as `baselines.evaluation.episodes.evaluate` returns them, without the omitted metrics.

        Raises:
            ValueError: if the row was evaluated on another set of this name, or on none.
        """
        self.check_set(evaluation_set)
        columns = self.scores[evaluation_set.name]
        found = []
        for i, seed in enumerate(self.header["training_seeds"] or [None]):
            metrics = dict(zip(self.header["metrics"], columns[:, i], strict=True))
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
    files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob(POLICY))} if folder else {}
    hashes = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    return {
        "policy": candidate.name,
        "description": candidate.description,
        "training_seeds": [policy.training_seed for policy in trained],
        "revision": ", ".join(dict.fromkeys(policy.revision for policy in trained)) or None,
        "files": hashes,
        "base": candidate.base,
    }


def columns(task: str) -> list[str]:
    """The metrics in rows of a task."""
    of_task = find_task(task)
    memory = SimpleNamespace(**{name: np.zeros(1) for name in of_task.fields})
    return [*COLUMNS, *of_task.metrics(memory, np.zeros(1))]


def evaluate_run(policy: Policy, sets: Sequence[EvaluationSet], horizon: float | None = None) -> dict[str, np.ndarray]:
    """Evaluates one training run; returns the metrics of its episodes by the set's name, shape (metrics, episodes)."""
    found = {}
    for each in sets:
        episodes = evaluate_policy(policy, each, horizon=horizon)
        found[each.name] = np.array([[episode[name] for episode in episodes] for name in columns(each.task)])
    return found


def disturbed_range(policy: Policy, horizon: float = HORIZON) -> tuple[float, float]:
    """The sensitivity of a policy to perturbations: the range of its mean speed (cm/s) under noise on its actions.

    If a difference in the tenth digit makes trajectories diverge, the mean speed of a single episode of `horizon` s is
    a sample from a wide distribution.
    """
    copies = EvaluationSet("copies", (NOMINAL_PLANT,) * COPIES)
    episodes = evaluate_policy(policy, copies, horizon=horizon, action_noise=NOISE)
    speeds = [episode["mean_speed"] for episode in episodes]
    return min(speeds), max(speeds)


def make_row(
    candidate: Candidate,
    sets: Sequence[EvaluationSet],
    runs: Sequence[dict[str, np.ndarray]],
    ranges: Sequence[tuple[float, float]] = (),
) -> Row:
    """Creates a row from the results of `evaluate_run` and `disturbed_range` for each training seed, in order.

    Of the ranges, the widest is used.
    """
    widest = max(ranges, key=lambda ends: ends[1] - ends[0], default=())
    header = {
        **static_header(candidate),
        "metrics": columns(candidate.task),
        "sets": {each.name: each.hash for each in sets},
        "versions": versions(),
        "disturbed": dict(zip(("low", "high"), widest, strict=False)),
    }
    return Row(header, {each.name: np.stack([run[each.name] for run in runs], axis=1) for each in sets})


def _work(policy: Policy, sets: Sequence[EvaluationSet], horizon: float | None, disturbed: bool) -> Any:
    """Evaluates one run on all sets, and its sensitivity if `disturbed`."""
    return evaluate_run(policy, sets, horizon), disturbed_range(policy, horizon or HORIZON) if disturbed else ()


def evaluate(
    candidates: Sequence[Candidate],
    sets: Sequence[EvaluationSet],
    *,
    jobs: int = 1,
    horizon: float | None = None,
    disturbed: bool = True,
) -> Iterator[Row]:
    """Evaluates policies on the sets of their task, with a progress bar; yields each row as soon as it is finished.

    `jobs` is the number of processes, `horizon` the length of an episode in s. `disturbed` also evaluates the
    sensitivity of policies of the speed task, which takes a third of the time.
    """
    # Imported here, since the import is slow and --help does not need it.
    from joblib import Parallel, delayed

    own = {candidate.name: [each for each in sets if each.task == candidate.task] for candidate in candidates}
    work = [(policy, candidate) for candidate in candidates for policy in candidate.policies]
    if not work:
        return
    results = Parallel(jobs, return_as="generator")(
        delayed(_work)(policy, own[candidate.name], horizon, disturbed and candidate.task == "speed")
        for policy, candidate in work
    )
    found = iter(tqdm(results, "evaluating", len(work), file=sys.stderr, disable=None))
    for candidate in candidates:
        runs, ranges = zip(*(next(found) for _ in candidate.policies), strict=True)
        yield make_row(candidate, own[candidate.name], runs, [each for each in ranges if each])


def path_of(folder: Path, name: str) -> Path:
    """The file of a policy's results."""
    return folder / f"{name}.npz"


def save_row(folder: Path, row: Row) -> None:
    """Writes a row's file atomically; the same row gives the same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {HEADER: np.frombuffer(json.dumps(row.header).encode(), np.uint8), **row.scores}
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_atomically(path_of(folder, row.name), content.getvalue())


def load_row(path: Path) -> Row:
    """Reads a row's file.

    Raises:
        ValueError: if the file does not exist, or was not written by `save_row`.
    """
    if not path.is_file():
        raise ValueError(f"{path.stem}: no results in {path.name}; `python -m agents.leaderboard NAME` writes them")
    try:
        # Read from memory, since numpy does not close an invalid file.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            header = json.loads(archive[HEADER].tobytes().decode())
            scores = {name: archive[name] for name in header["sets"]}
        shape = (len(header["metrics"]), max(1, len(header["training_seeds"])))
        fits = all(values.dtype == np.float64 and values.shape[:2] == shape for values in scores.values())
        if header["policy"] != path.stem or not fits:
            raise ValueError("its header does not match its name or arrays")
    except UNREADABLE as error:
        raise ValueError(f"{path.stem}: {path.name} contains no results: {type(error).__name__}: {error}") from error
    return Row(header, scores)


def load_rows(folder: Path, names: Iterable[str]) -> list[Row]:
    """Reads the rows of policies, in order, with the errors of `load_row`."""
    return [load_row(path_of(folder, name)) for name in names]
