"""Searches the parameters of `baselines:gait`, a law that does not observe the plant: `python -m baselines.gaits`.

A CMA-ES starts from a gait that tolerates other plants than the nominal one. Each generation runs all candidates in one
batch on newly drawn plants of `wide`, evenly over M and log(mu). Every episode changes its plant twice, and every
second one has a random residual torque: a law must be fast, tolerate changes and support a policy. At regular intervals
the mean of the distribution runs on fixed episodes; the best of these means replaces the parameters on file if it
scores better.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines.archive import make_strategy, run_search
from baselines.laws.gait import FILE, LIGHTEST, NO_REFERENCE, PARAMETERS
from capsule_gym import CapsuleVectorEnv
from capsule_gym.command_line import Count, command
from capsule_gym.controller import Controller, CoreLaw
from capsule_gym.files import write_atomically
from capsule_gym.layout import ROWS
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS
from capsule_gym.resets import plant_at, plant_ranges
from capsule_gym.task import HORIZON, TORQUE_LIMIT

# The coefficients of a gait that an earlier search found on the nominal plant: of its gaits, the fastest at the slowest
# of its speeds with M 10 % and mu about 20 % off.
START_COEFFICIENTS = (
    *(0.768173415, -1.52557133, 0.45381311, 0.0205869179, 0.78444579, 2.36305225, 0.415021591, 0.102463659),
    *(-1.23348699, -0.787626445, -0.687351086, -0.689480601, -0.615375647, 0.361390553, -0.608135802, 0.84640501),
    *(-2.1999663, -0.244974388, -0.0201974728, -2.62489784, 0.837836861),
)
# Scale of every parameter in the search.
UNITS = (*(1.0 for _ in PARAMETERS[:-2]), 0.03, 20.0)
FIRST_STEP = 0.2
# The guard starts with 0.05 N m for every 1/s^2 beyond 0.8 of the value that lifts the lightest platform of `wide`.
START_GUARD = (0.05, 0.8 * (LIGHTEST + NOMINAL.m) * NOMINAL.g / (NOMINAL.m * NOMINAL.l))
POPULATION = 24
PLANTS = 64
TRIAL = 12.0
# Plants of an episode, one after the other.
PLANTS_PER_EPISODE = 3
CONTROL_DT = 0.1
# N m: limit of the random residual torque, which is constant over an agent step.
RESIDUAL_LIMIT = 0.3
TEST_INTERVAL = 50
TEST_EPISODES = 512
TEST_SEED = (20186, 1)
FAILURE = -30.0


def make_batch(count: int) -> CapsuleVectorEnv:
    """A batch of environments for candidates, each on a plant of its own."""
    # The law reads its parameters from its memory, so that one batch serves all candidates.
    law = CoreLaw("gait_candidate", torque_limit=TORQUE_LIMIT)
    # The first millisecond has no torque: a reset calls the law before its memory can be written.
    return CapsuleVectorEnv(
        count,
        controller=Controller("candidate", law, NO_REFERENCE, memory=(0.0,) * law.cells),
        residual_limit=RESIDUAL_LIMIT,
        randomization="wide",
        control_dt=CONTROL_DT,
        max_episode_steps=round(HORIZON / CONTROL_DT),
        autoreset_mode=AutoresetMode.DISABLED,
        threads=os.cpu_count() or 1,
    )


def run_candidates(
    env: CapsuleVectorEnv, parameters: np.ndarray, plants: np.ndarray, actions: np.ndarray
) -> dict[str, np.ndarray]:
    """The metrics of one episode of every candidate, and their scores, shape (n,).

    `parameters` are of shape (n, size), in the order of `PARAMETERS`; `plants` are M in kg and mu in every part of the
    episode, shape (parts, 2, n); `actions` are of shape (steps, n).
    """
    steps = len(actions)
    times = [steps * CONTROL_DT * part / len(plants) for part in range(1, len(plants))]
    changes = [
        [{"t": t, "M": M, "mu": mu} for t, (M, mu) in zip(times, jumps, strict=True)]
        for jumps in plants[1:].transpose(2, 0, 1).tolist()
    ]
    env.reset(seed=0, options={"M": plants[0, 0], "mu": plants[0, 1], "changes": changes})
    for cell, column in enumerate(parameters.T):
        env.simulation.write(ROWS + cell, column)
    for row in actions.astype(np.float32):
        env.step(row[:, None])
    metrics = env.simulation.metrics(np.arange(env.num_envs), steps)
    return {**metrics, "score": score(metrics, steps * CONTROL_DT)}


def score(metrics: dict[str, np.ndarray], horizon: float) -> np.ndarray:
    """The mean speed, cm/s; failures in episodes of `horizon` s score far below all others, early ones lowest."""
    failed = FAILURE * (2.0 - metrics["duration"] / horizon)
    return np.where(metrics["failed"] > 0.0, failed, metrics["mean_speed"])


def draw_episodes(
    rng: np.random.Generator, count: int, horizon: float, repeats: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Draws the plants and actions of `run_candidates`; every second episode has random actions.

    There are `count` sequences of plants, each a Latin hypercube in M and log(mu) over `wide`; they are repeated with
    other actions. An episode lasts `horizon` s.
    """
    ranges = plant_ranges(RANDOMIZATIONS["wide"], NOMINAL)

    def draw_plants() -> np.ndarray:
        shares = [(rng.permutation(count) + rng.random(count)) / count for _ in range(2)]
        return np.array([plant_at(ranges, *pair) for pair in np.transpose(shares).tolist()]).T

    plants = np.tile([draw_plants() for _ in range(PLANTS_PER_EPISODE)], repeats)
    disturbed = np.tile(np.arange(count) % 2, repeats)
    return plants, disturbed * rng.uniform(-1.0, 1.0, (round(horizon / CONTROL_DT), disturbed.size))


def parameters_at(point: np.ndarray) -> np.ndarray:
    """The parameters of a point of the search, rounded as in the file; the guard's gain is not negative."""
    values = np.array([float(f"{value:.9g}") for value in point * UNITS])
    values[-2] = abs(values[-2])
    return values


def evaluate(batch: CapsuleVectorEnv, parameters: np.ndarray) -> tuple[float, dict[str, Any]]:
    """The mean score of parameters in the fixed episodes; their mean speed, cm/s, and failures."""
    episodes = draw_episodes(np.random.default_rng(TEST_SEED), TEST_EPISODES, HORIZON)
    metrics = run_candidates(batch, np.tile(parameters, (TEST_EPISODES, 1)), *episodes)
    speed, failures = round(float(metrics["mean_speed"].mean()), 4), int(metrics["failed"].sum())
    return float(metrics["score"].mean()), {"mean_speed": speed, "failures": failures, "episodes": TEST_EPISODES}


def search_law(num_generations: int, seed: int) -> Iterator[None]:
    """Runs one generation per iteration; writes the mean of the distribution if it scores better than the file."""
    rng = np.random.default_rng([seed, 3])
    start = np.array([*START_COEFFICIENTS, *START_GUARD]) / UNITS
    strategy = make_strategy(start, FIRST_STEP, POPULATION, rng)
    trials, tests = make_batch(POPULATION * PLANTS), make_batch(TEST_EPISODES)
    best = -math.inf
    if FILE.is_file():
        known = json.loads(FILE.read_text(encoding="utf-8"))["parameters"]
        best, _ = evaluate(tests, np.array([known[name] for name in PARAMETERS]))
    for generation in range(1, num_generations + 1):
        points = strategy.ask()
        parameters = np.repeat([parameters_at(point) for point in points], PLANTS, axis=0)
        scores = run_candidates(trials, parameters, *draw_episodes(rng, PLANTS, TRIAL, POPULATION))["score"]
        strategy.tell(points, (-scores.reshape(POPULATION, PLANTS).mean(axis=1)).tolist())
        if generation % TEST_INTERVAL == 0 or generation == num_generations:
            mean = parameters_at(strategy.mean)
            reached, found = evaluate(tests, mean)
            print(f"generation {generation}: score {reached:.3f}, best {best:.3f}", flush=True)
            if reached > best:
                best = reached
                origin = {
                    "command": f"python -m baselines.gaits --generations {num_generations} --seed {seed}",
                    **found,
                }
                named = dict(zip(PARAMETERS, mean.tolist(), strict=True))
                content = {"parameters": named, "found": {"generation": generation, **origin}}
                write_atomically(FILE, json.dumps(content, indent=1) + "\n")
        yield


@command("python -m baselines.gaits")
def main(generations: Count = 700, seed: int = 0) -> int:
    """Searches the parameters of the law `baselines:gait`; baselines/laws/gait.json keeps the better ones.

    Examples:
      python -m baselines.gaits --generations 700

    Args:
        generations: Generations of the search.
        seed: Seed of the search.
    """
    return 130 if run_search(search_law(generations, seed), lambda: None) else 0


if __name__ == "__main__":
    sys.exit(main())
