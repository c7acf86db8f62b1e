"""How chaotic a policy is: how far its mean speed moves under noise far below anything that a plant shows.

The check needs no such number: the same code gives the same bits on every machine. Its reader does. A chaotic policy
forgets its start: trajectories that differ in their tenth digit part, and the mean speed of a single episode is a draw
from a wide distribution, on the robot as here. `measure` says how wide, on the paper's plant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.evaluation.episodes import evaluate, scores
from agents.evaluation.policies import Act, Candidate, Policy
from capsule_gym.evaluation_sets import NOMINAL_PLANT, EvaluationSet
from capsule_gym.task import HORIZON

# Of full action, half the width: what a network in float32 rounds away.
NOISE = 1e-7
NOISE_SEED = 1_000_000_007
COPIES = 200


@dataclass(frozen=True)
class Disturbed:
    """A policy with noise on its actions.

    Attributes:
        policy: whose actions they are.
        seed: of the noise.
    """

    policy: Policy
    seed: int

    @property
    def name(self) -> str:
        """The policy's."""
        return self.policy.name

    @property
    def env_kwargs(self) -> Mapping[str, Any]:
        """The policy's."""
        return self.policy.env_kwargs

    def start(self, seeds: Sequence[int]) -> Act:
        """As the policy's, with uniform noise that differs from episode to episode."""
        act = self.policy.start(seeds)
        rng = np.random.default_rng(self.seed)

        def disturbed(observations: np.ndarray) -> np.ndarray:
            actions = act(observations)
            return (actions + NOISE * (2.0 * rng.random(actions.shape) - 1.0)).astype(np.float32)

        return disturbed


def measure(candidate: Candidate, horizon: float = HORIZON) -> dict[str, float]:
    """The lowest and the highest mean speed of many copies of one episode with noise on their actions.

    Args:
        candidate: a row of the leaderboard; of several training seeds the one counts whose copies part the most.
        horizon: length of the episode in s.

    Returns:
        `{"low": .., "high": ..}` in cm/s.
    """
    copies = EvaluationSet("copies", (NOMINAL_PLANT,) * COPIES)
    ends = []
    for policy in candidate.policies:
        speeds = scores(evaluate(Disturbed(policy, NOISE_SEED), copies, horizon=horizon), "mean_speed")
        ends.append((float(speeds.min()), float(speeds.max())))
    low, high = max(ends, key=lambda end: end[1] - end[0])
    return {"low": low, "high": high}
