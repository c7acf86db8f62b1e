"""The search of `python -m baselines.gaits.law_search` for the parameters of `baselines:gait`, all over `wide`.

A CMA-ES starts from the tolerant gait of the nominal plant. Each of its generations draws plants anew, evenly over M
and log(mu), lets every one of them jump twice to another, and nudges every second one by a random residual torque: what
is fast must also bear a change, and a policy on top. At regular intervals the mean of its distribution runs whole
episodes on plants and under nudges that stay the same; the best of these is kept, and written where it beats the one on
file.

All candidates run in one batch: what is the law's closure in `baselines.laws.gait` is its memory here.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines.gaits.performance import tolerant_nominal
from baselines.gaits.rounds import import_cma, score
from baselines.laws.gait import LIGHTEST, NO_REFERENCE, PARAMETERS, guarded_torque
from capsule_gym import CapsuleVectorEnv
from capsule_gym.controller import Controller
from capsule_gym.layout import ROWS
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS
from capsule_gym.resets import plant_at, plant_ranges
from capsule_gym.task import HORIZON

# Steps of the search in the parameters' own units.
UNITS = (*(1.0 for _ in PARAMETERS[:-2]), 0.03, 20.0)
FIRST_STEP = 0.2
# Where the guard starts: a twentieth of a N m for every 1/s^2 beyond 0.8 of what lifts the lightest platform of `wide`.
START_GUARD = (0.05, 0.8 * (LIGHTEST + NOMINAL.m) * NOMINAL.g / (NOMINAL.m * NOMINAL.l))
POPULATION = 24
PLANTS = 64
TRIAL = 12.0
# Parts of an episode, each with a plant of its own.
PARTS = 3
CONTROL_DT = 0.1
# N m; of the random residual torque, held for an agent step.
NUDGE = 0.3
LOOK_EVERY = 50
LOOK_EPISODES = 512
# Of the episodes by which the search chooses, whatever seed it has itself.
LOOK_SEED = (20186, 1)


def candidate(
    theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
) -> tuple[float, tuple[float, ...]]:
    """The law with its parameters in its memory, so that one kernel serves all candidates."""
    return guarded_torque(theta, theta_dot, x_dot, memory), memory


class Trials:
    """A batch of candidates, each on a plant of its own.

    Args:
        count: of environments.
        threads: that share the batch; the results do not depend on it.
    """

    def __init__(self, count: int, threads: int) -> None:
        # The first millisecond passes without a torque: a reset asks the law before its memory can be written.
        self.env = CapsuleVectorEnv(
            count,
            controller=Controller("candidate", candidate, NO_REFERENCE, memory=(0.0,) * len(PARAMETERS)),
            residual_limit=NUDGE,
            randomization="wide",
            control_dt=CONTROL_DT,
            max_episode_steps=round(HORIZON / CONTROL_DT),
            autoreset_mode=AutoresetMode.DISABLED,
            threads=threads,
        )

    def run(self, parameters: np.ndarray, plants: np.ndarray, actions: np.ndarray) -> dict[str, np.ndarray]:
        """The metrics of one episode each, shape (n,).

        Args:
            parameters: shape (n, size), in the order of `PARAMETERS`.
            plants: M in kg and mu of each part of the episode, shape (parts, 2, n).
            actions: shape (steps, n).
        """
        steps = len(actions)
        times = [steps * CONTROL_DT * part / len(plants) for part in range(1, len(plants))]
        changes = [
            [{"t": t, "M": M, "mu": mu} for t, (M, mu) in zip(times, later, strict=True)]
            for later in plants[1:].transpose(2, 0, 1).tolist()
        ]
        self.env.reset(seed=0, options={"M": plants[0, 0], "mu": plants[0, 1], "changes": changes})
        simulation = self.env.simulation
        for cell, column in enumerate(parameters.T):
            simulation.write(ROWS + cell, column)
        for row in actions.astype(np.float32):
            self.env.step(row[:, None])
        return simulation.metrics(np.arange(simulation.num_envs), steps)


def draw_plants(rng: np.random.Generator, count: int) -> np.ndarray:
    """M in kg and mu of plants that lie evenly over `wide`, a Latin hypercube in M and log(mu), shape (2, count)."""
    shares = [(rng.permutation(count) + rng.random(count)) / count for _ in range(2)]
    lines = plant_ranges(RANDOMIZATIONS["wide"], NOMINAL)
    return np.array([plant_at(lines, *pair) for pair in np.transpose(shares).tolist()]).T


def draw_episodes(
    rng: np.random.Generator, count: int, horizon: float, repeats: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """The plants and the actions of as many episodes, every second of which is nudged, as `Trials.run` takes them.

    Args:
        rng: where they come from.
        count: of different sequences of plants.
        horizon: length of an episode, s.
        repeats: how often they follow each other; the nudges differ.
    """
    plants = np.tile([draw_plants(rng, count) for _ in range(PARTS)], repeats)
    nudged = np.tile(np.arange(count) % 2, repeats)
    return plants, nudged * rng.uniform(-1.0, 1.0, (round(horizon / CONTROL_DT), nudged.size))


class Search:
    """The search; `best` holds the parameters with the best score so far, in episodes that stay the same.

    Args:
        seed: of the search.
        threads: for the batch.
    """

    def __init__(self, seed: int, threads: int) -> None:
        self.rng = np.random.default_rng([seed, 3])
        start = np.array([*tolerant_nominal().parameters, *START_GUARD]) / UNITS
        options = {
            "popsize": POPULATION,
            "verbose": -9,
            # A stream of its own: the package would seed numpy's global generator.
            "seed": math.nan,
            "randn": lambda *shape: self.rng.standard_normal(shape),
        }
        self.strategy = import_cma().CMAEvolutionStrategy(start, FIRST_STEP, options)
        self.trials = Trials(POPULATION * PLANTS, threads)
        self.looks = Trials(LOOK_EPISODES, threads)
        self.generation = 0
        self.best: tuple[float, int, np.ndarray] = (-math.inf, 0, self.parameters(start))

    @staticmethod
    def parameters(point: np.ndarray) -> np.ndarray:
        """The parameters of a point of the search, as they are written; a guard that pushes is its mirror image."""
        values = np.array([float(f"{value:.9g}") for value in point * UNITS])
        values[-2] = abs(values[-2])
        return values

    def advance(self) -> float:
        """One generation; returns the best of its scores."""
        points = self.strategy.ask()
        plants, actions = draw_episodes(self.rng, PLANTS, TRIAL, POPULATION)
        parameters = np.repeat([self.parameters(point) for point in points], PLANTS, axis=0)
        scores = _scores(self.trials.run(parameters, plants, actions), TRIAL)
        means = scores.reshape(POPULATION, PLANTS).mean(axis=1)
        self.strategy.tell(points, (-means).tolist())
        self.generation += 1
        return float(means.max())

    def look(self) -> dict[str, Any]:
        """Runs the mean of the distribution in the episodes that stay the same, and keeps it where it is the best."""
        found = self.parameters(self.strategy.mean)
        score, summary = judge(self.looks, found)
        if score > self.best[0]:
            self.best = (score, self.generation, found)
        return summary


def _scores(metrics: dict[str, np.ndarray], horizon: float) -> np.ndarray:
    """The mean speed, cm/s, and failures far below."""
    return score({**metrics, "late_speed": metrics["mean_speed"]}, horizon)


def judge(trials: Trials, parameters: np.ndarray) -> tuple[float, dict[str, Any]]:
    """The mean score over `LOOK_EPISODES` whole episodes, with jumps and nudges as in the search, and a summary.

    Args:
        trials: of `LOOK_EPISODES` environments.
        parameters: in the order of `PARAMETERS`.
    """
    plants, actions = draw_episodes(np.random.default_rng(LOOK_SEED), LOOK_EPISODES, HORIZON)
    metrics = trials.run(np.tile(parameters, (LOOK_EPISODES, 1)), plants, actions)
    value = float(_scores(metrics, HORIZON).mean())
    return value, {
        "mean_speed": round(float(metrics["mean_speed"].mean()), 4),
        "failures": int(metrics["failed"].sum()),
        "episodes": LOOK_EPISODES,
    }


def known_score(path: Path, trials: Trials) -> float:
    """The score of the parameters on file; minus infinity where there is no file."""
    if not path.is_file():
        return -math.inf
    content = json.loads(path.read_text(encoding="utf-8"))["parameters"]
    return judge(trials, np.array([content[name] for name in PARAMETERS]))[0]
