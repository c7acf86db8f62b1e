"""What a row of the leaderboard rests on: every episode of every training run, in one file per policy.

`agents/leaderboard/results/NAME.npz` is a numpy archive without pickles. For every set it holds an array of float64, of
shape (metrics, training seeds, episodes), and under `header` a JSON text in UTF-8:

| field | meaning |
|---|---|
| `policy`, `description` | what was evaluated |
| `training_seeds`, `revision`, `files` | its runs, the revision they were trained at, the sha256 of each policy file |
| `base` | the scripted policy whose law runs inside its step; null for none |
| `metrics` | the rows of the arrays |
| `sets` | the sha256 of each set's content |
| `versions` | of Python and of the packages that evaluated it |
| `disturbed` | the range of the mean speed under noise (`agents.leaderboard.chaos`) |

Distance and energy are left out: they follow from speed and cost of transport. So is the share of the optimum, which
follows from speed and plant.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.episodes import Episode, as_episodes, evaluate, versions
from agents.evaluation.policies import Candidate, Policy
from baselines.policies import SCRIPTED
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.files import file_hash, write_atomically
from capsule_gym.policy import POLICY
from capsule_gym.task import METRICS

# From the project's folder.
RESULTS = Path("agents", "leaderboard", "results")
COLUMNS = tuple(name for name in METRICS if name not in ("distance", "energy"))
HEADER = "header"


@dataclass(frozen=True, eq=False)
class Row:
    """All episodes of one policy, with what they were made from.

    Attributes:
        header: the fields of the table above.
        scores: by the set's name, shape (metrics, runs, episodes), float64; a scripted policy has one run.
    """

    header: dict[str, Any]
    scores: dict[str, np.ndarray]

    @property
    def name(self) -> str:
        """The policy's."""
        return str(self.header["policy"])

    @property
    def trained(self) -> bool:
        """Whether it was learnt."""
        return bool(self.header["training_seeds"])

    def score(self, set_name: str, metric: str) -> np.ndarray:
        """A metric of all episodes of a set, shape (runs, episodes), float64."""
        found: np.ndarray = self.scores[set_name][self.header["metrics"].index(metric)]
        return found

    def episodes(self, evaluation_set: EvaluationSet) -> list[Episode]:
        """The episodes as `Candidate.evaluate` gives them, less what the file leaves out.

        Raises:
            ValueError: if the row was evaluated on another set of this name, or on none.
        """
        self.check_set(evaluation_set)
        columns = self.scores[evaluation_set.name]
        found = []
        for i, seed in enumerate(self.header["training_seeds"] or [None]):
            metrics = dict(zip(self.header["metrics"], columns[:, i], strict=True))
            label = {} if seed is None else {"training_seed": seed}
            found += [{**episode, **label} for episode in as_episodes(evaluation_set, metrics)]
        return found

    def check_set(self, evaluation_set: EvaluationSet) -> None:
        """Refuses a set that is not the one that the row was evaluated on."""
        recorded = self.header["sets"].get(evaluation_set.name)
        if recorded != evaluation_set.hash:
            raise ValueError(
                f"{self.name}: the hash of the set {evaluation_set.name} is {recorded} in its results and "
                f"{evaluation_set.hash} now"
            )
        count = self.scores[evaluation_set.name].shape[-1]
        if count != len(evaluation_set.plants):
            raise ValueError(
                f"{self.name}: its results hold {count} episodes of the set {evaluation_set.name}, which has "
                f"{len(evaluation_set.plants)}"
            )

    def same_as(self, other: Row) -> bool:
        """Whether both hold the same header and the same bits."""
        return self.header == other.header and all(
            name in other.scores and values.tobytes() == other.scores[name].tobytes()
            for name, values in self.scores.items()
        )


def static_header(candidate: Candidate) -> dict[str, Any]:
    """What a row says before anything is evaluated."""
    revisions = dict.fromkeys(policy.revision for policy in candidate.trained)
    folder = candidate.folder
    paths = sorted(folder.rglob(POLICY)) if folder else []
    return {
        "policy": candidate.name,
        "description": candidate.description,
        "training_seeds": [policy.training_seed for policy in candidate.trained],
        "revision": ", ".join(revisions) or None,
        "files": {path.relative_to(folder).as_posix(): file_hash(path) for path in paths if folder},
        "base": _base(candidate),
    }


def _base(candidate: Candidate) -> str | None:
    """The scripted policy that does nothing but what the law under a residual does."""
    controller = candidate.policies[0].env_kwargs.get("controller")
    if controller is None or candidate.folder is None:
        return None
    return next((name for name, each in SCRIPTED.items() if each.env_kwargs.get("controller") == controller), None)


def evaluate_run(policy: Policy, sets: Sequence[EvaluationSet], horizon: float) -> dict[str, np.ndarray]:
    """One training run on all sets: by the set's name the metrics of its episodes, shape (metrics, episodes)."""
    episodes = {each.name: evaluate(policy, each, horizon=horizon) for each in sets}
    return {
        name: np.array([[each[column] for each in found] for column in COLUMNS]) for name, found in episodes.items()
    }


def make_row(
    candidate: Candidate,
    sets: Sequence[EvaluationSet],
    runs: Sequence[dict[str, np.ndarray]],
    disturbed: dict[str, float],
) -> Row:
    """Puts a row together.

    Args:
        candidate: the policy.
        sets: that it was evaluated on.
        runs: what `evaluate_run` gave for each of its runs, in order.
        disturbed: what `agents.leaderboard.chaos.measure` gave.
    """
    header = {
        **static_header(candidate),
        "metrics": list(COLUMNS),
        "sets": {each.name: each.hash for each in sets},
        "versions": versions(),
        "disturbed": disturbed,
    }
    return Row(header, {each.name: np.stack([run[each.name] for run in runs], axis=1) for each in sets})


def path_of(folder: Path, name: str) -> Path:
    """The file of a policy's results."""
    return folder / f"{name}.npz"


def save_row(folder: Path, row: Row) -> bool:
    """Writes a row's file, whole or not at all, unless it holds the same already; returns whether it wrote."""
    path = path_of(folder, row.name)
    if path.is_file():
        try:
            if load_row(path).same_as(row):
                return False
        except ValueError:
            # What cannot be read is written anew.
            pass
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {HEADER: np.frombuffer(json.dumps(row.header).encode(), np.uint8), **row.scores}
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_atomically(path, content.getvalue())
    return True


def load_row(path: Path) -> Row:
    """Reads a row's file.

    Raises:
        ValueError: if there is none, or it is not what `save_row` writes.
    """
    if not path.is_file():
        raise ValueError(f"{path.stem}: has no results, expected in {path.name}")
    try:
        # Out of memory: numpy leaves a file open that it cannot read.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            header = json.loads(archive[HEADER].tobytes().decode())
            scores = {name: archive[name] for name in header["sets"]}
        shape = (len(header["metrics"]), max(1, len(header["training_seeds"])))
        fits = all(values.dtype == np.float64 and values.shape[:2] == shape for values in scores.values())
        missing = {"policy", "description", "revision", "files", "base", "versions", "disturbed"} - set(header)
        if header["policy"] != path.stem or missing or not fits:
            raise ValueError(f"its header does not fit its name or its arrays, or lacks {sorted(missing)}")
    except (KeyError, TypeError, ValueError, EOFError, OSError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path.stem}: {path.name} holds no results: {type(error).__name__}: {error}") from error
    return Row(header, scores)


def load_rows(folder: Path, names: Iterable[str]) -> list[Row]:
    """The rows of some policies, in their order.

    Raises:
        ValueError: as `load_row`; it names the first policy that has no results.
    """
    return [load_row(path_of(folder, name)) for name in names]
