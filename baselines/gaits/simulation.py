"""Simulates many gaits at once, each on its own plant: their metrics, their robustness and the oracle's map."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import product

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines.gaits.archive import Archive, Gait, GaitMap
from baselines.gaits.families import FAMILIES, GAIT_DT, actions, encode
from capsule_gym import CapsuleVectorEnv
from capsule_gym.task import HORIZON, START_THETA

SHORT_HORIZON = 12.0
LARGEST_SENSITIVITY = 0.01
PERTURBATION = 1e-3
# Changes of a robust gait: factors of M and mu, and rad that are added to the first angle. The first changes nothing.
PERTURBED = np.array(
    [(1.0, 1.0, 0.0), *((1.0 + a, 1.0 + b, c) for a, b, c in product((-PERTURBATION, PERTURBATION), repeat=3))]
)
# Changes of a tolerant gait: the plant and four corners around it.
TOLERATED = np.array([(1.0, 1.0, 0.0), (0.9, 0.8, 0.0), (0.9, 1.25, 0.0), (1.1, 1.0 / 1.25, 0.0), (1.1, 1.25, 0.0)])
STARTS = np.array([(1.0, 1.0, 0.0), (1.0, 1.0, PERTURBATION)])
# The oracle's map covers the evaluation sets: M in kg, evenly spaced, and mu, evenly spaced in its logarithm.
MAP_M, MAP_MU = (0.25, 1.2, 20), (0.002, 0.6, 16)


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
        family: of the gaits, a name of `FAMILIES`.
        parameters: shape (n, parameters).
        M: masses of the platforms, kg, shape (n,).
        mu: friction coefficients, shape (n,).
        variants: factors of M and mu and changes of the first angle, shape (variants, 3).
        horizon: length of an episode, s.

    Returns:
        The metrics of `capsule_gym.task.Metrics` and `late_speed`, the mean speed over the second half of the episode
        in cm/s, each of shape (variants, n).
    """
    count, steps = len(variants) * len(parameters), round(horizon / GAIT_DT)
    gaits = encode([family] * count, np.tile(parameters, (len(variants), 1)).tolist())
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
        observations, info = env.reset(seed=0, options={**plants, "state": states})
        middle = info["state"][:, 2]
        for step in range(steps):
            observations, _, terminated, _, info = env.step(actions(gaits, step * GAIT_DT, observations))
            if step + 1 == steps // 2:
                middle = info["state"][:, 2]
            if terminated.all():
                break
        results = env.episode_metrics()
    finally:
        env.close()
    results["late_speed"] = 100.0 * (info["state"][:, 2] - middle) / (0.5 * horizon)
    return {name: values.reshape(len(variants), -1) for name, values in results.items()}


def worst_speed(results: dict[str, np.ndarray]) -> np.ndarray:
    """The slowest mean speeds over the variants, cm/s; -2 to -1 where one fails, whatever distance it had covered."""
    speeds = np.where(results["failed"] > 0.0, -2.0 + results["duration"] / HORIZON, results["mean_speed"])
    return speeds.min(axis=0)


def sensitivity(results: dict[str, np.ndarray]) -> np.ndarray:
    """The largest relative change of the mean speed over the variants, against the first; 1 where one fails."""
    speeds = results["mean_speed"]
    scale = np.maximum(np.abs(speeds[0]), 1e-9)
    return np.where((results["failed"] > 0.0).any(axis=0), 1.0, np.abs(speeds - speeds[0]).max(axis=0) / scale)


def check(archive: Archive) -> list[str]:
    """Simulates every gait again; returns what differs from the archive by more than the tolerance, one line each.

    Rounding differs between machines and a gait may amplify it, by as much as the search allows for a thousandth.
    """
    stale = []
    for family in FAMILIES:
        gaits = [gait for gait in archive.everything() if gait.family == family]
        if not gaits:
            continue
        parameters, M, mu = (np.array([getattr(gait, each) for gait in gaits]) for each in ("parameters", "M", "mu"))
        results = simulate(family, parameters, M, mu)
        for n, gait in enumerate(gaits):
            for metric in ("mean_speed", "cost_of_transport"):
                old, new = getattr(gait, metric), float(results[metric][0, n])
                if not abs(new - old) <= LARGEST_SENSITIVITY * abs(old):
                    stale.append(
                        f"{family} at M={gait.M}, mu={gait.mu}: {metric} is {old:.6g} on file and {new:.6g} now"
                    )
    return stale


def compute_map(gaits: Sequence[Gait]) -> GaitMap:
    """Computes the map of `gait-oracle`: in every cell the gait whose slowest run is fastest.

    The runs cover the cell and two starts, since a small change may lead to another, slower motion.

    Args:
        gaits: to choose from.
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
    best = worst.argmax(axis=0).reshape(len(M), len(mu))
    rows = tuple(tuple(gaits[index] for index in row) for row in best)
    return GaitMap(tuple(np.round(M, 6).tolist()), tuple(float(f"{value:.6g}") for value in mu), rows)
