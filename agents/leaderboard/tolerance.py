"""How far a number of the leaderboard may be from the recorded one: CI's tolerance, and where it comes from.

The physics gives the same bits everywhere; what computes the actions does not. Those of torch's float32 networks move
by 1e-7 of full action (rms; at most 4e-7 with PPO and 1.5e-6 with SAC) with the processor and even with the size of the
batch. Most policies forget that. A chaotic one does not: its trajectories part, and each number of an episode becomes a
draw from a distribution. So the distribution is measured, and recorded with the leaderboard.

`measure` runs every episode of a row many times, with normal noise of 1e-7 of full action on each action: of a trained
policy on its output, of a scripted law on the residual torque, which is the motor's. From these copies whole
evaluations are put together, each with a copy of every episode drawn at random, and summed up as the row itself is. The
spread of a number is the largest minus the smallest value that it takes in them.

The check accepts a number that is no farther from the recorded one than `MULTIPLE` times its spread plus what is left
for rounding (`RELATIVE`, `ABSOLUTE`). Two evaluations differ like two draws, each from a range of about 5.8 standard
deviations: a multiple of 2 leaves eight standard deviations of such a difference, because ratios have long tails.
Between two machines with different instruction sets 172 numbers moved by more than rounding, the farthest by 0.9 of its
spread. Where nothing is amplified the spread is a millionth of the number, and the rounding rules.

`nominal` is one episode for each training seed: for a chaotic policy that single draw ranges widely, and so does what
the check accepts. On the sets of 100 episodes it is held to a few per cent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.evaluation.candidates import Candidate
from agents.evaluation.episodes import Act, Policy, evaluate, scores
from agents.evaluation.sets import EvaluationSet
from agents.evaluation.statistics import estimate
from agents.evaluation.tables import MEASURES, SHARE
from capsule_gym.task import HORIZON

# Of full action; the standard deviation.
NOISE = 1e-7
NOISE_SEED = 1_000_000_007
# Noisy episodes of a training seed on a set: 10 copies of 100 plants, 1000 of one.
EPISODES = 1000
# Evaluations put together from them.
EVALUATIONS = 300
# Bootstrap resamples in each of those: with a fixed seed their number hardly moves the ends' spread.
RESAMPLES = 200

MULTIPLE = 2.0
RELATIVE = 1e-3
ABSOLUTE = 1e-4


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
        """As the policy's, with noise that differs from episode to episode."""
        act = self.policy.start(seeds)
        rng = np.random.default_rng(self.seed)

        def disturbed(observations: np.ndarray) -> np.ndarray:
            actions = act(observations)
            return (actions + NOISE * rng.standard_normal(actions.shape)).astype(np.float32)

        return disturbed


def measure(candidate: Candidate, evaluation_set: EvaluationSet, horizon: float = HORIZON) -> dict[str, Any]:
    """The spread of a row's numbers on one set under noise on the actions.

    Args:
        candidate: the row.
        evaluation_set: the set.
        horizon: length of an episode in s.

    Returns:
        For every measure of the board `{"iqm": .., "low": .., "high": ..}` in the measure's unit, infinite where a
        number exists in some evaluations and not in others; and `failures`, a count.
    """
    plants = evaluation_set.plants
    copies = math.ceil(EPISODES / len(plants))
    repeated = EvaluationSet(evaluation_set.name, plants * copies)
    noisy = [
        evaluate(Disturbed(run.load(), NOISE_SEED + n), repeated, horizon=horizon)
        for n, run in enumerate(candidate.runs)
    ]
    names = [name for name in (*MEASURES, SHARE.metric) if name in noisy[0][0]]
    # One axis each for the copies, the training seeds and the plants.
    values = {
        name: np.stack([scores(run, name).reshape(copies, -1) for run in noisy], axis=1) for name in (*names, "failed")
    }
    rng = np.random.default_rng(NOISE_SEED)
    seeds, episodes = np.ogrid[: len(noisy), : len(plants)]
    draws = [rng.integers(copies, size=(len(noisy), len(plants))) for _ in range(EVALUATIONS)]
    spread: dict[str, Any] = {}
    for name in names:
        found = [estimate(values[name][draw, seeds, episodes], resamples=RESAMPLES).to_dict() for draw in draws]
        spread[name] = {end: _width([summary[end] for summary in found]) for end in found[0]}
    failed = [int(values["failed"][draw, seeds, episodes].sum()) for draw in draws]
    return {**spread, "failures": max(max(failed) - min(failed), int(_part(values["mean_speed"])))}


def _part(speeds: np.ndarray) -> bool:
    """Whether copies of an episode part, so that another copy may fail where none of these did.

    Args:
        speeds: shape (copies, training seeds, plants).
    """
    return bool((np.ptp(speeds, axis=0) > np.maximum(RELATIVE * np.abs(speeds[0]), ABSOLUTE)).any())


def _width(values: Sequence[float]) -> float:
    """The largest minus the smallest; infinite where some are not finite, and 0 where none is."""
    finite = [value for value in values if math.isfinite(value)]
    if len(finite) not in (0, len(values)):
        return math.inf
    return max(finite) - min(finite) if finite else 0.0


def agree(recorded: float | None, found: float | None, spread: float | None) -> bool:
    """Whether the check accepts a number.

    Args:
        recorded: in leaderboard.json; None where it does not exist.
        found: evaluated now.
        spread: of the recorded one; None for infinite.
    """
    if spread is None:
        return True
    if recorded is None or found is None:
        return recorded is found
    return abs(found - recorded) <= MULTIPLE * spread + max(RELATIVE * abs(recorded), ABSOLUTE)


def agree_counts(recorded: int, found: int, spread: int) -> bool:
    """Whether the check accepts a number of failures."""
    return abs(found - recorded) <= MULTIPLE * spread
