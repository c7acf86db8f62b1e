"""Trains a student by DAgger: in rounds of data, the student acts more and more often.

A fit follows each round, and a final fit the last one. The loss of a torque is its interpolated
regret, not its distance from the expert's torque. The folder of a run holds

    config.json          the fields of `Student`, and the git revision
    policy.safetensors   the best policy so far, by evaluations on validation plants
    finished.json        after the run: mean_speed (cm/s) and share of failed episodes of the best
                         policy, processor time of the run (core_seconds) and git revision
"""

import dataclasses
import itertools
import math
import sys
import time
from pathlib import Path

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from agents.distillation.config import Student
from agents.distillation.dataset import Dataset, collect
from agents.training.checkpoint import git_revision
from agents.training.config import CONFIG
from baselines.dynamic_programming.policy import NUM_TORQUES
from capsule_gym import Policy
from capsule_gym.evaluation.episodes import evaluate, scores, validation_set
from capsule_gym.evaluation.sets import EvaluationSet
from capsule_gym.files import to_json, write_atomically
from capsule_gym.policies.conversion import read_modules
from capsule_gym.policies.policy import IMITATION, POLICY
from capsule_gym.tasks.task import CONTROL_DT

# First seed of the validation plants for selecting the best policy; far from other seeds.
SELECTION_SEED = 6_000_000
# Share of the time in which the expert acts, in the first rounds; 0 afterwards.
EXPERT_SHARES = (1.0, 0.5, 0.3, 0.2, 0.1)
# Step size at the end of a round's fit, relative to its start.
FINAL_RATE = 0.3
HIDDEN = 64
FINISHED = "finished.json"
# Lower bound on the variance of an input that hardly varies.
MIN_VARIANCE = 1e-3
CLIP = 10.0
EPSILON = 1e-8
MAX_GRADIENT_NORM = 1.0


def interpolated_regret(regrets: torch.Tensor, torques: torch.Tensor) -> torch.Tensor:
    """Interpolates regrets linearly.

    Args:
        regrets: the regrets at `TORQUES`, shape (n, NUM_TORQUES).
        torques: where to interpolate, in [-1, 1], shape (n,).
    """
    positions = 0.5 * (NUM_TORQUES - 1) * (torques + 1.0)
    below = positions.detach().long().clamp(0, NUM_TORQUES - 2)
    low = regrets.gather(1, below[:, None])[:, 0]
    high = regrets.gather(1, below[:, None] + 1)[:, 0]
    return low + (positions - below) * (high - low)


class Network:
    """The student's network: two hidden layers, and tanh after each layer.

    A dataset's statistics normalise the inputs.
    """

    def __init__(self, dataset: Dataset, seed: int) -> None:
        inputs = dataset.inputs.astype(np.float64)
        self._mean = inputs.mean(axis=0)
        self._variance = np.maximum(inputs.var(axis=0), MIN_VARIANCE)
        torch.manual_seed(seed)
        first = nn.Linear(inputs.shape[1], HIDDEN)
        second = nn.Linear(HIDDEN, HIDDEN)
        last = nn.Linear(HIDDEN, 1)
        self._module = nn.Sequential(first, nn.Tanh(), second, nn.Tanh(), last, nn.Tanh())
        self._optimiser = torch.optim.Adam(self._module.parameters(), fused=True)

    def fit(
        self,
        datasets: list[Dataset],
        updates: int,
        rates: tuple[float, float],
        batch_size: int,
        rng: np.random.Generator,
    ) -> list[float]:
        """Minimises the mean regret.

        Args:
            datasets: the data of all rounds.
            updates: number of gradient steps.
            rates: step sizes of Adam at the first and the last gradient step; linear in between.
            batch_size: states in each step.
            rng: random generator of the batches.

        Returns:
            The loss of the batch of every step, cm/s.
        """
        raw = np.concatenate([dataset.inputs for dataset in datasets])
        scaled = np.clip((raw - self._mean) / np.sqrt(self._variance + EPSILON), -CLIP, CLIP)
        inputs = torch.from_numpy(scaled.astype(np.float32))
        regrets = torch.from_numpy(np.concatenate([dataset.regrets for dataset in datasets]))
        first_rate, last_rate = rates
        losses = []
        for update in range(updates):
            rate = first_rate + (last_rate - first_rate) * update / updates
            self._optimiser.param_groups[0]["lr"] = rate
            batch = torch.from_numpy(rng.integers(len(inputs), size=batch_size))
            torques = self._module(inputs[batch])[:, 0]
            loss = interpolated_regret(regrets[batch], torques).mean() / CONTROL_DT
            self._optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self._module.parameters(), MAX_GRADIENT_NORM)
            self._optimiser.step()
            losses.append(loss.item())
        return losses

    def policy(self, name: str, student: Student, seed: int, revision: str) -> Policy:
        """The policy with the current weights."""
        return Policy(
            name=name,
            algorithm=IMITATION,
            **read_modules(self._module),
            mean=self._mean,
            variance=self._variance,
            clip=CLIP,
            epsilon=EPSILON,
            env_kwargs=student.env_kwargs,
            training_seed=seed,
            revision=revision,
        )


def schedule(student: Student) -> list[tuple[float | None, int, tuple[float, float]]]:
    """The rounds of DAgger and the parts of the final fit.

    Each entry is the expert's share of the time (None if no data is collected), the number of
    gradient steps, and the step sizes of Adam at the first and the last gradient step.
    """
    rate = student.learning_rate
    fits: list[tuple[float | None, int, tuple[float, float]]] = []
    shares = itertools.chain(EXPERT_SHARES, itertools.repeat(0.0))
    for share in itertools.islice(shares, student.rounds):
        fits.append((share, student.updates, (rate, FINAL_RATE * rate)))
    parts = student.final_parts
    ends = [rate * (1.0 - n / parts) for n in range(parts + 1)]
    for rates in itertools.pairwise(ends):
        fits.append((None, student.final_updates // parts, rates))
    return fits


def distil(name: str, student: Student, seed: int, folder: Path) -> None:
    """Trains a student in a new folder. Equal seeds give equal policies.

    If the run is interrupted, the folder holds the best policy so far, if any.

    Raises:
        FileExistsError: if the folder exists.
    """
    folder.mkdir(parents=True)
    torch.set_num_threads(1)
    began = time.process_time()
    revision = git_revision(Path(__file__).parent)
    config = {"hyperparameters": dataclasses.asdict(student), "revision": revision}
    write_atomically(folder / CONFIG, to_json(config))
    rng = np.random.default_rng(seed)
    plants = _validation_plants(student, seed)
    datasets: list[Dataset] = []
    network: Network | None = None
    policy: Policy | None = None
    best = (-math.inf, 0.0, 0.0)
    fits = schedule(student)
    bar = tqdm(fits, f"{name}/{folder.name}", unit="fit", file=sys.stderr, disable=None)
    for expert_share, updates, rates in bar:
        if expert_share is not None:
            act = policy.start(range(student.num_envs)) if policy else None
            datasets.append(collect(student, rng, expert_share, act))
        network = network or Network(datasets[0], seed)
        network.fit(datasets, updates, rates, student.batch_size, rng)
        policy = network.policy(name, student, seed, revision)
        episodes = evaluate(policy, plants)
        speed = float(scores(episodes, "mean_speed").mean())
        failed = float(scores(episodes, "failed").mean())
        bar.set_postfix_str(f"{speed:.2f} cm/s, {100.0 * failed:.0f} % failed")
        found = (speed - student.failure_cost * failed, speed, failed)
        if found > best:
            best = found
            policy.save(folder / POLICY)
    _, speed, failed = best
    result = {
        "mean_speed": speed,
        "failed": failed,
        "core_seconds": round(time.process_time() - began, 1),
        "revision": revision,
    }
    write_atomically(folder / FINISHED, to_json(result))


def _validation_plants(student: Student, seed: int) -> EvaluationSet:
    """The plants that select a run's best policy, never a frozen set."""
    count = student.evaluation_episodes
    first = SELECTION_SEED + seed * count
    capsule = student.grid.capsule
    return validation_set(student.randomization, "validation plants", first, count, capsule)
