"""Trains a student by DAgger: in rounds of data, the student acts more and more often.

A fit follows each round, and a final fit the last one. The folder of a run holds

    config.json          the fields of `Student`, and the git revision
    policy.safetensors   the best policy so far, by evaluations on validation plants
    finished.json        after the run: mean_speed (cm/s) and share of failed episodes of the best
                         policy, processor time of the run (core_seconds) and git revision

and until then what it needs to continue: checkpoint.pt, without pickled code, and round-00.npz, ..
with the data of each round.
"""

import dataclasses
import itertools
import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from agents.distillation.config import RIG, Student
from agents.distillation.dataset import Dataset, collect
from agents.distillation.network import Network
from agents.distillation.plants import draw_groups, solve_groups
from agents.training.checkpoint import git_revision
from agents.training.config import CONFIG, RunError
from capsule_gym import Policy
from capsule_gym.evaluation.episodes import drawn_from, drawn_like, evaluate, scores
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.files import load_arrays, replacing, to_json, write_atomically
from capsule_gym.parameters import Randomization
from capsule_gym.policies.policy import POLICY

# First seed of the validation plants for selecting the best policy; far from other seeds.
SELECTION_SEED = 6_000_000
# Share of the time in which the expert acts, in the first rounds; 0 afterwards.
EXPERT_SHARES = (1.0, 0.5, 0.3, 0.2, 0.1)
# Step sizes at the end of a round's fit and at the start of the final one, relative to those at the
# start of a round's.
ROUND_END = 0.3
FINAL_START = 0.5
FINISHED = "finished.json"
CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True)
class Fit:
    """A fit, and the data collected before.

    Attributes:
        expert_share: the expert's share of the time in the data; None if no data is collected.
        updates: number of gradient steps.
        rates: step sizes of Adam at the first and the last gradient step.
    """

    expert_share: float | None
    updates: int
    rates: tuple[float, float]


def schedule(student: Student) -> list[Fit]:
    """The rounds of DAgger and the parts of the final fit."""
    rate = student.learning_rate
    fits = []
    shares = itertools.chain(EXPERT_SHARES, itertools.repeat(0.0))
    for share in itertools.islice(shares, student.rounds):
        fits.append(Fit(share, student.updates, (rate, ROUND_END * rate)))
    parts = student.final_parts
    ends = [FINAL_START * rate * (1.0 - n / parts) for n in range(parts + 1)]
    for rates in itertools.pairwise(ends):
        fits.append(Fit(None, student.final_updates // parts, rates))
    return fits


class Run:
    """A run in its folder, which continues where it was interrupted.

    Equal seeds give equal policies, also after an interruption.
    """

    def __init__(self, name: str, student: Student, seed: int, folder: Path) -> None:
        """Begins a run, or reads its checkpoint.

        Raises:
            RunError: if the folder holds a run of another student or revision.
        """
        self.name = name
        self.student = student
        self.seed = seed
        self.folder = folder
        self.revision = git_revision()
        self.rng = np.random.default_rng(seed)
        self.datasets: list[Dataset] = []
        self.network: Network | None = None
        self.policy: Policy | None = None
        self.finished_fits = 0
        self.core_seconds = 0.0
        self.best = (-math.inf, 0.0, 0.0)
        config = {"hyperparameters": dataclasses.asdict(student), "revision": self.revision}
        text = to_json(config)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / CONFIG
        if not path.exists():
            write_atomically(path, text)
        elif path.read_text(encoding="utf-8") != text:
            raise RunError(f"{folder} contains a run with other settings or code: move it")
        if (folder / CHECKPOINT).is_file():
            self._load()

    def train(self) -> None:
        """Trains to the end, and saves the best policy so far and a checkpoint after each fit."""
        torch.set_num_threads(1)
        groups = draw_groups(self.student)
        solutions = solve_groups(groups, self.folder.parent / "plants")
        plants = _validation_plants(self.student, self.seed)
        fits = schedule(self.student)
        bar = tqdm(
            fits,
            f"{self.name}/{self.folder.name}",
            initial=self.finished_fits,
            unit="fit",
            file=sys.stderr,
            disable=None,
        )
        for fit in fits[self.finished_fits :]:
            began = time.process_time()
            if fit.expert_share is not None:
                act = self.policy.start(range(self.student.num_envs)) if self.policy else None
                share = fit.expert_share
                self._add(collect(self.student, groups, solutions, self.rng, share, act))
            if self.network is None:
                self.network = Network(self.student, self.datasets[0], self.seed)
            self.network.fit(self.datasets, fit.updates, fit.rates, self.rng)
            self.policy = self.network.policy(self.name, self.seed, self.revision)
            speed, failed = self._evaluate(self.policy, plants)
            bar.set_postfix_str(f"{speed:.2f} cm/s, {100.0 * failed:.1f} % failed")
            bar.update()
            self.finished_fits += 1
            self.core_seconds += time.process_time() - began
            self._save()
        bar.close()
        self._finish()

    def _evaluate(self, policy: Policy, plants: Sequence[EvaluationSet]) -> tuple[float, float]:
        """Evaluates a policy, and saves it if it is the best so far.

        Returns:
            The mean speed, cm/s, and the share of failed episodes.
        """
        episodes = [episode for each in plants for episode in evaluate(policy, each)]
        speed = float(scores(episodes, "mean_speed").mean())
        failed = float(scores(episodes, "failed").mean())
        found = (speed - self.student.failure_cost * failed, speed, failed)
        if found > self.best:
            self.best = found
            policy.save(self.folder / POLICY)
        return speed, failed

    def _finish(self) -> None:
        """Writes the result, and removes what was needed to continue."""
        _, speed, failed = self.best
        result = {
            "mean_speed": speed,
            "failed": failed,
            "core_seconds": round(self.core_seconds, 1),
            "revision": self.revision,
        }
        write_atomically(self.folder / FINISHED, to_json(result))
        for path in (self.folder / CHECKPOINT, *self.folder.glob("round-*.npz")):
            path.unlink()

    def _round_path(self, n: int) -> Path:
        return self.folder / f"round-{n:02}.npz"

    def _add(self, dataset: Dataset) -> None:
        """Adds the data of a round, and writes its file."""
        with replacing(self._round_path(len(self.datasets))) as temporary:
            np.savez(temporary, **dataset._asdict())
        self.datasets.append(dataset)

    def _save(self) -> None:
        """Writes the checkpoint."""
        assert self.network is not None
        state = {
            "finished_fits": self.finished_fits,
            "rounds": len(self.datasets),
            "core_seconds": self.core_seconds,
            "best": self.best,
            # As text, since its integers exceed 64 bits.
            "rng": json.dumps(self.rng.bit_generator.state),
            "module": self.network.module.state_dict(),
            "optimiser": self.network.optimiser.state_dict(),
        }
        with replacing(self.folder / CHECKPOINT) as temporary:
            torch.save(state, temporary)

    def _load(self) -> None:
        """Reads the checkpoint and the data of the rounds before it."""
        state: dict[str, Any] = torch.load(self.folder / CHECKPOINT, weights_only=True)
        for n in range(state["rounds"]):
            arrays = load_arrays(self._round_path(n))
            self.datasets.append(Dataset(**arrays))
        self.network = Network(self.student, self.datasets[0], self.seed)
        self.network.module.load_state_dict(state["module"])
        self.network.optimiser.load_state_dict(state["optimiser"])
        self.policy = self.network.policy(self.name, self.seed, self.revision)
        self.rng.bit_generator.state = json.loads(state["rng"])
        self.finished_fits = state["finished_fits"]
        self.core_seconds = state["core_seconds"]
        self.best = state["best"]


def _validation_plants(student: Student, seed: int) -> Sequence[EvaluationSet]:
    """The plants that select a run's best policy: drawn as those of sets, but never theirs.

    With an identified rig they are drawn from its ranges.
    """
    count = student.evaluation_episodes
    first = SELECTION_SEED + seed * count
    if isinstance(student.randomization, Randomization):
        return [drawn_from(student.env_kwargs, RIG, first, count)]
    return [drawn_like(name, first, count) for name in student.validation]
