"""The student's network, and how it is fitted: by what its torques cost, not by how far they are from the teacher's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from agents.distil.lessons import Lesson
from agents.distil.students import Student
from agents.training.algorithms import FastTanh
from agents.training.export import Normalisation
from baselines.dynamic_programming.policy import NUM_TORQUES
from capsule_gym import Policy
from capsule_gym.policy import IMITATION
from capsule_gym.task import CONTROL_DT

HIDDEN = 64
# An entry that hardly varies is not blown up.
LEAST_VARIANCE = 1e-3
CLIP, EPSILON = 10.0, 1e-8
# Norm of a gradient, beyond which it is cut.
LARGEST_GRADIENT = 1.0


def interpolated(regrets: torch.Tensor, torques: torch.Tensor) -> torch.Tensor:
    """What torques cost between those that the teacher tried, linear between them.

    Args:
        regrets: of `TORQUES`, shape (n, NUM_TORQUES).
        torques: in [-1, 1], shape (n,).

    Returns:
        In the unit of the regrets, shape (n,).
    """
    positions = 0.5 * (NUM_TORQUES - 1) * (torques + 1.0)
    below = positions.detach().long().clamp(0, NUM_TORQUES - 2)
    low, high = (regrets.gather(1, (below + n)[:, None])[:, 0] for n in (0, 1))
    return low + (positions - below) * (high - low)


@dataclass(frozen=True)
class Fit:
    """A number of gradient steps.

    Attributes:
        updates: how many.
        start: step size of Adam at the first.
        end: at the last; linear in between.
        batch_size: states in each.
    """

    updates: int
    start: float
    end: float
    batch_size: int


class Network:
    """Two hidden layers, tanh after each.

    Args:
        lesson: whose observations are normalised to zero mean and unit variance.
        seed: of the first weights.
    """

    def __init__(self, lesson: Lesson, seed: int) -> None:
        inputs = lesson.inputs.astype(np.float64)
        variance = np.maximum(inputs.var(axis=0), LEAST_VARIANCE)
        self._normalisation = Normalisation(inputs.mean(axis=0), variance, CLIP, EPSILON)
        torch.manual_seed(seed)
        first, second, last = nn.Linear(inputs.shape[1], HIDDEN), nn.Linear(HIDDEN, HIDDEN), nn.Linear(HIDDEN, 1)
        self._layers = first, second, last
        self._module = nn.Sequential(first, FastTanh(), second, FastTanh(), last, FastTanh())
        self._optimiser = torch.optim.Adam(self._module.parameters())

    def fit(
        self,
        lessons: list[Lesson],
        how: Fit,
        rng: np.random.Generator,
        report: Callable[[float], bool] = lambda regret: True,
    ) -> None:
        """Makes the torques cheaper.

        Args:
            lessons: of which states are drawn.
            how: the gradient steps.
            rng: draws the states.
            report: is told after every step what the torques of its states cost, cm/s; False ends the fit.
        """
        of = self._normalisation
        given = np.concatenate([lesson.inputs for lesson in lessons])
        scaled = np.clip((given - of.mean) / np.sqrt(of.var + of.epsilon), -of.clip, of.clip)
        inputs = torch.from_numpy(scaled.astype(np.float32))
        regrets = torch.from_numpy(np.concatenate([lesson.regrets for lesson in lessons]))
        for n in range(how.updates):
            self._optimiser.param_groups[0]["lr"] = how.start + (how.end - how.start) * n / how.updates
            chosen = torch.from_numpy(rng.integers(len(inputs), size=how.batch_size))
            loss = interpolated(regrets[chosen], self._module(inputs[chosen])[:, 0]).mean() / CONTROL_DT
            self._optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self._module.parameters(), LARGEST_GRADIENT)
            self._optimiser.step()
            if not report(loss.item()):
                break

    def policy(self, name: str, student: Student, seed: int, revision: str) -> Policy:
        """The policy as it is now.

        Args:
            name: its own, as the rest a field of `capsule_gym.Policy`.
            student: what it meets and sees.
            seed: of its training.
            revision: of the code.
        """
        of = self._normalisation
        return Policy(
            name=name,
            algorithm=IMITATION,
            layers=tuple(
                (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in self._layers
            ),
            activation="tanh",
            squashing="tanh",
            mean=of.mean,
            variance=of.var,
            clip=of.clip,
            epsilon=of.epsilon,
            env_kwargs=student.env_kwargs,
            training_seed=seed,
            revision=revision,
            identifies=student.identifies,
        )
