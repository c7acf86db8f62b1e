"""The network of a student, and its fit to the regrets of torques.

The loss of a torque is its interpolated regret, not its distance from the expert's torque.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from agents.distillation.config import Student
from agents.distillation.dataset import Dataset
from baselines.dynamic_programming.policy import NUM_TORQUES
from capsule_gym import Policy
from capsule_gym.policies.conversion import read_modules
from capsule_gym.policies.policy import IMITATION
from capsule_gym.tasks.task import CONTROL_DT

# Lower bound on the variance of an input that hardly varies.
MIN_VARIANCE = 1e-3
CLIP = 10.0
EPSILON = 1e-8
MAX_GRADIENT_NORM = 1.0
# Share of the sequences that begin an episode.
BEGINNINGS = 0.15


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


class Module(nn.Module):
    """Layers with tanh, with a GRU after the first if it has units.

    After the GRU the inputs are read again.
    """

    def __init__(self, entries: int, units: int, hidden: int) -> None:
        super().__init__()
        width = units or hidden
        self.first = nn.Sequential(nn.Linear(entries, width), nn.Tanh())
        self.cell = nn.GRU(units, units) if units else None
        read = units + entries if units else hidden
        self.head = nn.Sequential(
            nn.Linear(read, hidden), nn.Tanh(), nn.Linear(hidden, 1), nn.Tanh()
        )

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """The torques, shape (steps, sequences), for inputs (steps, sequences, entries)."""
        values = self.first(inputs)
        if self.cell is not None:
            values, _ = self.cell(values)
            values = torch.cat([values, inputs], dim=-1)
        torques: torch.Tensor = self.head(values)
        return torques[..., 0]

    def parts(self) -> list[nn.Module]:
        """The modules in the order in which they are applied."""
        cell = [] if self.cell is None else [self.cell]
        return [*self.first, *cell, *self.head]


class Network:
    """A student's network, whose inputs the statistics of a dataset normalise."""

    def __init__(self, student: Student, dataset: Dataset, seed: int) -> None:
        inputs = dataset.inputs[dataset.running].astype(np.float64)
        self._student = student
        self.mean = inputs.mean(axis=0)
        self.variance = np.maximum(inputs.var(axis=0), MIN_VARIANCE)
        torch.manual_seed(seed)
        self.module = Module(inputs.shape[1], student.units, student.hidden)
        self.optimiser = torch.optim.Adam(self.module.parameters(), fused=True)

    def fit(
        self,
        datasets: Sequence[Dataset],
        updates: int,
        rates: tuple[float, float],
        rng: np.random.Generator,
    ) -> list[float]:
        """Minimises the mean regret.

        Args:
            datasets: the data of all rounds.
            updates: number of gradient steps.
            rates: step sizes of Adam at the first gradient step and after the last, linear between.
            rng: random generator of the batches.

        Returns:
            The loss of the batch of every step, cm/s.
        """
        inputs = np.concatenate([dataset.inputs for dataset in datasets])
        regrets = np.concatenate([dataset.regrets for dataset in datasets])
        running = np.concatenate([dataset.running for dataset in datasets])
        inputs = np.clip((inputs - self.mean) / np.sqrt(self.variance + EPSILON), -CLIP, CLIP)
        inputs = inputs.astype(np.float32)
        first_rate, last_rate = rates
        losses = []
        for update in range(updates):
            rate = first_rate + (last_rate - first_rate) * update / updates
            self.optimiser.param_groups[0]["lr"] = rate
            at, counts = self._sequences(running, rng)
            torques = self.module(torch.from_numpy(inputs[at]))
            own = torch.from_numpy(regrets[at][counts].astype(np.float32))
            loss = interpolated_regret(own, torques[torch.from_numpy(counts)]).mean() / CONTROL_DT
            self.optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.module.parameters(), MAX_GRADIENT_NORM)
            self.optimiser.step()
            losses.append(loss.item())
        return losses

    def _sequences(
        self, running: np.ndarray, rng: np.random.Generator
    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
        """Draws sequences: their episodes and steps, and which of these steps count.

        The shapes are (steps, sequences).
        """
        student = self._student
        episodes, steps = running.shape
        chosen = rng.integers(episodes, size=student.batch_size)
        begins = rng.integers(steps - student.sequence + 1, size=student.batch_size)
        if student.units:
            begins[rng.random(student.batch_size) < BEGINNINGS] = 0
        within = np.arange(student.sequence)[:, None]
        at = np.broadcast_to(chosen, (student.sequence, student.batch_size)), begins + within
        return at, running[at] & ((within >= student.burn_in) | (begins == 0))

    def policy(self, name: str, seed: int, revision: str) -> Policy:
        """The policy with the current weights."""
        return Policy(
            name=name,
            algorithm=IMITATION,
            **read_modules(self.module.parts()),
            mean=self.mean,
            variance=self.variance,
            clip=CLIP,
            epsilon=EPSILON,
            env_kwargs=self._student.env_kwargs,
            training_seed=seed,
            revision=revision,
        )
