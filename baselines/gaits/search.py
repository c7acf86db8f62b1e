"""The search for gaits: an iteration runs a CMA-ES for every plant, with all candidates in one batch."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from importlib import import_module
from itertools import product
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines.archive import PLANTS
from baselines.gaits.archive import Archive, Gait, GaitMap
from baselines.gaits.families import FAMILIES, GAIT_DT, actions, encode
from capsule_gym import CapsuleVectorEnv
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import HORIZON, START_THETA

POPULATION = 16
RANDOM_STARTS = 128
# Horizon of most searches, s.
SHORT_HORIZON = 12.0
FAILURE = -30.0
# Shares of the largest speed for which the front looks for the cheapest gait; cm/s while no speed is known.
FRONT_SHARES = tuple(i / 10.0 for i in range(1, 11))
FIRST_GOAL = 10.0
# Penalty per cm/s below the required speed.
FRONT_PENALTY = 3.0
LARGEST_SENSITIVITY = 0.01
PERTURBATION = 1e-3
# Changes for a robust gait: factors of M and mu, and change of the first angle, rad. The first row changes nothing.
PERTURBED = np.array(
    [(1.0, 1.0, 0.0), *((1.0 + a, 1.0 + b, c) for a, b, c in product((-PERTURBATION, PERTURBATION), repeat=3))]
)
# Changes for a tolerant gait: the plant and four corners around it.
TOLERATED = np.array([(1.0, 1.0, 0.0), (0.9, 0.8, 0.0), (0.9, 1.25, 0.0), (1.1, 1.0 / 1.25, 0.0), (1.1, 1.25, 0.0)])
STARTS = np.array([(1.0, 1.0, 0.0), (1.0, 1.0, PERTURBATION)])
# The oracle's map covers the evaluation sets: M in kg, evenly spaced, and mu, evenly spaced in its logarithm.
MAP_M, MAP_MU = (0.25, 1.2, 20), (0.002, 0.6, 16)


class Purpose(NamedTuple):
    """The objective of an iteration.

    Attributes:
        generations: number of generations of its CMA-ES runs.
        restarts: runs per plant, or per required speed of the front.
        sigmas: range of the initial step sizes, in the families' units.
        horizon: length of the episodes, s.
        known: whether it starts from known gaits instead of random ones.
        variants: changes of the plant; the worst one determines the score of a candidate.
    """

    generations: int
    restarts: int
    sigmas: tuple[float, float]
    horizon: float = SHORT_HORIZON
    known: bool = True
    variants: np.ndarray = PERTURBED[:1]


# The purposes take turns in this order. A heavy platform tolerates more, so three corners are nearly as good as all.
PURPOSES = {
    "explore": Purpose(80, 4, (0.6, 0.6), known=False),
    "refine": Purpose(80, 4, (0.1, 0.4)),
    "finish": Purpose(40, 2, (0.03, 0.15), HORIZON),
    "front": Purpose(40, 2, (0.15, 0.4), HORIZON),
    "tolerate": Purpose(40, 2, (0.1, 0.4), variants=TOLERATED[1:4]),
}


def simulate(
    family: str,
    parameters: np.ndarray,
    M: np.ndarray,
    mu: np.ndarray,
    *,
    variants: np.ndarray = PERTURBED[:1],
    horizon: float = HORIZON,
) -> dict[str, np.ndarray]:
    """Runs gaits of one family, each from rest on its own plant and on variants of it.

    Args:
        family: family of the gaits, a name of `FAMILIES`.
        parameters: shape (n, parameters).
        M: masses of the platforms, kg, shape (n,).
        mu: friction coefficients, shape (n,).
        variants: factors of M and mu and changes of the first angle, shape (variants, 3).
        horizon: length of an episode, s.

    Returns:
        The metrics of `capsule_gym.task.Metrics`, each of shape (variants, n).
    """
    count, steps = len(variants) * len(parameters), round(horizon / GAIT_DT)
    gaits = np.tile(encode(family, parameters), (len(variants), 1))
    states = np.zeros((count, 4))
    states[:, 0] = START_THETA + np.repeat(variants[:, 2], len(parameters))
    env = CapsuleVectorEnv(
        count,
        max_episode_steps=steps,
        autoreset_mode=AutoresetMode.DISABLED,
        randomization="none",
        control_dt=GAIT_DT,
        threads=os.cpu_count() or 1,
    )
    try:
        plants = {"M": np.outer(variants[:, 0], M).reshape(-1), "mu": np.outer(variants[:, 1], mu).reshape(-1)}
        observations, _ = env.reset(seed=0, options={**plants, "state": states})
        for step in range(steps):
            observations, _, terminated, _, _ = env.step(actions(gaits, step * GAIT_DT, observations))
            if terminated.all():
                break
        return {name: values.reshape(len(variants), -1) for name, values in env.episode_metrics().items()}
    finally:
        env.close()


def worst_speed(results: dict[str, np.ndarray]) -> np.ndarray:
    """The slowest mean speeds over the variants, cm/s; -2 to -1 if one fails, independent of the distance."""
    speeds = np.where(results["failed"] > 0.0, -2.0 + results["duration"] / HORIZON, results["mean_speed"])
    return speeds.min(axis=0)


def sensitivity(results: dict[str, np.ndarray]) -> np.ndarray:
    """The largest change of the mean speed over the variants, relative to the first; 1 if one fails."""
    speeds = results["mean_speed"]
    scale = np.maximum(np.abs(speeds[0]), 1e-9)
    return np.where((results["failed"] > 0.0).any(axis=0), 1.0, np.abs(speeds - speeds[0]).max(axis=0) / scale)


def score(results: dict[str, np.ndarray], horizon: float, goals: np.ndarray | None = None) -> np.ndarray:
    """The objective of the search: the mean speed, cm/s, or the negative cost of transport at a required speed.

    The episodes last `horizon` s; `goals` are the required speeds of the front, cm/s, one per candidate.

    Returns:
        Scores in the shape of the metrics. Failures score far below all other episodes, early ones lowest.
    """
    value = results["mean_speed"]
    if goals is not None:
        transport = np.minimum(results["cost_of_transport"], 20.0)
        value = -transport - FRONT_PENALTY * np.maximum(0.0, goals - results["mean_speed"])
    return np.where(results["failed"] > 0.0, FAILURE * (2.0 - results["duration"] / horizon), value)


def cma_strategy(start: np.ndarray, sigma: float, population: int, rng: np.random.Generator) -> Any:
    """A CMA-ES with an initial mean and step size and `population` candidates per generation; draws from `rng`."""
    cma = import_module("cma")
    # The package would otherwise seed numpy's global generator.
    draws = {"seed": math.nan, "randn": lambda *shape: rng.standard_normal(shape)}
    return cma.CMAEvolutionStrategy(start, sigma, {"popsize": population, "verbose": -9, **draws})


def search(archive: Archive, seed: int, minutes: float) -> Iterator[None]:
    """Searches for gaits for a number of minutes; changes the archive in place and yields after every iteration.

    Iteration i draws from the stream (seed, i).
    """
    turns = list(product(PURPOSES, FAMILIES))
    deadline = perf_counter() + 60.0 * minutes
    while perf_counter() < deadline:
        began, number, better = perf_counter(), archive.iterations, 0
        purpose, family = turns[number % len(turns)]
        points, plants = find_candidates(archive, family, purpose, np.random.default_rng([seed, number]))
        for gait in robust_gaits(family, points, plants, purpose == "tolerate"):
            better += archive.offer(gait)
            if (gait.M, gait.mu, gait.worst_speed) == (NOMINAL.M, NOMINAL.mu, None):
                archive.offer_front(gait)
        archive.iterations += 1
        speeds = [gait.mean_speed for gait in archive.fastest().values()]
        print(
            f"iteration {number} ({purpose}, {family}): {better} entries better in {perf_counter() - began:.0f} s; "
            f"mean of {len(speeds)} plants {np.mean(speeds or [0.0]):.2f} cm/s",
            flush=True,
        )
        yield


def find_candidates(
    archive: Archive, family: str, purpose: str, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Runs every CMA-ES of an iteration from the best of known, or of random, gaits on its plant.

    Returns:
        The best parameters and the mean of every run, shape (candidates, parameters), and their plants, M in kg and mu,
        shape (candidates, 2).
    """
    settings, units = PURPOSES[purpose], np.array(FAMILIES[family].units)
    targets = np.array([(M, mu, math.nan) for M, mu in PLANTS])
    if purpose == "front":
        top = max((gait.mean_speed for gait in archive.of_plant(NOMINAL.M, NOMINAL.mu)), default=FIRST_GOAL)
        targets = np.array([(NOMINAL.M, NOMINAL.mu, share * top) for share in FRONT_SHARES])
    starts = np.array([gait.parameters for gait in archive.everything() if gait.family == family])
    if not (len(starts) and settings.known):
        draws = rng.standard_normal((RANDOM_STARTS, len(units)))
        starts = np.array(FAMILIES[family].start) + np.array(FAMILIES[family].spread) * draws

    def scores_of(parameters: np.ndarray, targets: np.ndarray, horizon: float) -> np.ndarray:
        """The scores of candidates for their targets: the worst over the variants of the plant."""
        M, mu, goals = targets.T
        results = simulate(family, parameters, M, mu, variants=settings.variants, horizon=horizon)
        return score(results, horizon, goals if purpose == "front" else None).min(axis=0)

    every = np.tile(starts, (len(targets), 1)), np.repeat(targets, len(starts), axis=0)
    low, high = settings.sigmas
    strategies = []
    for order in np.argsort(-scores_of(*every, SHORT_HORIZON).reshape(-1, len(starts)), axis=1):
        for restart in range(settings.restarts):
            # Half of the restarts take the best, half the next best ones, which may lie in other basins.
            rank = min((restart + 1) // 2 if restart % 2 else 0, len(starts) - 1)
            sigma = low * (high / low) ** rng.random()
            strategies.append(cma_strategy(starts[order[rank]] / units, sigma, POPULATION, rng))
    targets = np.repeat(targets, settings.restarts, axis=0)
    for _ in range(settings.generations):
        points = np.array([strategy.ask() for strategy in strategies])
        parameters = (points * units).reshape(-1, len(units))
        scores = scores_of(parameters, np.repeat(targets, POPULATION, axis=0), settings.horizon)
        for strategy, own, values in zip(strategies, points, scores.reshape(len(points), -1), strict=True):
            strategy.tell(list(own), (-values).tolist())
    results = [strategy.result for strategy in strategies]
    points = np.array([point for result in results for point in (result.xbest, result.xfavorite)])
    return points * units, np.repeat(targets[:, :2], 2, axis=0)


def robust_gaits(family: str, points: np.ndarray, plants: np.ndarray, tolerant: bool) -> Iterator[Gait]:
    """Simulates candidates over the whole horizon; yields the robust ones as gaits, the best first.

    `points` are parameters, shape (candidates, parameters), `plants` M in kg and mu, shape (candidates, 2).
    """
    # Rounded before the evaluation, as in the file.
    points = np.array([[float(f"{value:.9g}") for value in point] for point in points])
    results = simulate(family, points, *plants.T, variants=PERTURBED)
    changes, speeds = sensitivity(results), results["mean_speed"][0]
    if tolerant:
        speeds = worst_speed(simulate(family, points, *plants.T, variants=TOLERATED))
    for i in np.argsort(-speeds):
        if changes[i] < LARGEST_SENSITIVITY:
            yield Gait(
                M=float(plants[i, 0]),
                mu=float(plants[i, 1]),
                family=family,
                parameters=tuple(points[i].tolist()),
                mean_speed=float(results["mean_speed"][0, i]),
                cost_of_transport=float(results["cost_of_transport"][0, i]),
                sensitivity=float(changes[i]),
                worst_speed=float(speeds[i]) if tolerant else None,
            )


def check(archive: Archive) -> list[str]:
    """Simulates every gait again; returns one line for each difference from the archive above the tolerance.

    Rounding differs between machines, and a gait may amplify it as much as the search allows for 1 part in 1000.
    """
    stale = []
    for gait in archive.everything():
        results = simulate(gait.family, np.array([gait.parameters]), np.array([gait.M]), np.array([gait.mu]))
        for metric in ("mean_speed", "cost_of_transport"):
            old, new = getattr(gait, metric), float(results[metric][0, 0])
            if not abs(new - old) <= LARGEST_SENSITIVITY * abs(old):
                stale.append(f"{gait.family} at M={gait.M}, mu={gait.mu}: {metric} is {old:.6g} on file, {new:.6g} now")
    return stale


def compute_map(gaits: Sequence[Gait]) -> GaitMap:
    """Computes the map of `gait-oracle`: in every cell the gait whose slowest run is fastest.

    The runs cover the cell and two starts, since a small change may lead to another, slower motion.
    """
    M, mu = np.linspace(*MAP_M), np.geomspace(*MAP_MU)
    half_M, half_mu = 0.5 * (M[1] - M[0]), (mu[1] / mu[0]) ** 0.5
    centre_M, centre_mu, steps_M, steps_mu = np.array(list(product(M, mu, (-1.0, 0.0, 1.0), (-1.0, 0.0, 1.0)))).T
    worst = np.empty((len(gaits), len(M) * len(mu)))
    for n, gait in enumerate(gaits):
        parameters = np.tile(gait.parameters, (len(centre_M), 1))
        plants = centre_M + half_M * steps_M, centre_mu * half_mu**steps_mu
        results = simulate(gait.family, parameters, *plants, variants=STARTS)
        worst[n] = worst_speed(results).reshape(worst.shape[1], -1).min(axis=1)
    used, cells = np.unique(worst.argmax(axis=0), return_inverse=True)
    rows = tuple(map(tuple, cells.reshape(len(M), len(mu)).tolist()))
    centres = tuple(np.round(M, 6).tolist()), tuple(float(f"{value:.6g}") for value in mu)
    return GaitMap(*centres, tuple(gaits[index] for index in used), rows)
