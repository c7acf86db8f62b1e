"""Runs many gaits at once, each on its own plant, in one batch of environments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines.gaits.archive import Gait
from baselines.gaits.families import FAMILIES, GAIT_DT, Family, actions, pack
from baselines.gaits.performance import Choice
from capsule_gym import CapsuleVectorEnv
from capsule_gym.task import HORIZON, START_THETA

PERTURBATION = 1e-3
# The oracle's map covers what the evaluation sets hold: M in kg, evenly spaced, and mu, evenly in its logarithm.
MAP_M, MAP_MU = (0.25, 1.2, 20), (0.002, 0.6, 16)
TRIAL = 12.0
FINALISTS = 6
# Factors of M and mu that a tolerant gait must bear: the plant and four corners around it.
TOLERATED = ((1.0, 1.0), (0.9, 0.8), (0.9, 1.25), (1.1, 1.0 / 1.25), (1.1, 1.25))


def simulate(
    family: Family,
    parameters: np.ndarray,
    M: np.ndarray,
    mu: np.ndarray,
    *,
    horizon: float = HORIZON,
    late_from: float = 0.0,
    states: np.ndarray | None = None,
    threads: int = 1,
) -> dict[str, np.ndarray]:
    """Runs n gaits of one family, each from rest on its own plant.

    Args:
        family: of the gaits.
        parameters: shape (n, size).
        M: masses of the platforms, kg, shape (n,).
        mu: friction coefficients, shape (n,).
        horizon: length of an episode, s.
        late_from: where `late_speed` starts to count, s.
        states: where the episodes start instead, shape (n, 4): theta, theta_dot, x, x_dot.
        threads: that share the batch; the results do not depend on it.

    Returns:
        The metrics of `capsule_gym.task.Metrics`, `late_speed` in cm/s, the mean from `late_from` on, and
        `steps`, the agent steps taken; each of shape (n,).
    """
    count = len(parameters)
    steps = round(horizon / GAIT_DT)
    late_step = round(late_from / GAIT_DT)
    env = CapsuleVectorEnv(
        count,
        max_episode_steps=steps,
        autoreset_mode=AutoresetMode.DISABLED,
        randomization="none",
        control_dt=GAIT_DT,
        threads=threads,
    )
    gaits = pack([family.name] * count, parameters.tolist())
    try:
        options = {"M": M, "mu": mu} | ({} if states is None else {"state": states})
        observations, info = env.reset(seed=0, options=options)
        start = info["state"][:, 2]
        for step in range(steps):
            observations, _, terminated, _, info = env.step(actions(gaits, step * GAIT_DT, observations))
            if step + 1 == late_step:
                start = info["state"][:, 2]
            if terminated.all():
                break
        results = env.episode_metrics()
    finally:
        env.close()
    late = 100.0 * (info["state"][:, 2] - start) / (horizon - late_from)
    return {**results, "late_speed": late, "steps": np.round(results["duration"] / GAIT_DT)}


def robust_metrics(
    family: Family, parameters: np.ndarray, M: np.ndarray, mu: np.ndarray, *, threads: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed and cost over the whole horizon, and how far the speed moves where the plant or the start moves a little.

    Args:
        family: of the gaits.
        parameters: shape (n, size).
        M: kg, shape (n,).
        mu: shape (n,).
        threads: that share the batch.

    Returns:
        Mean speed in cm/s, cost of transport, and the largest relative change of the speed over M and mu changed by
        one part in 1000 either way, and the first angle by a thousandth of a radian either way; 1 where one of these
        runs fails. Each of shape (n,).
    """
    changes = [(0.0, 0.0, 0.0), *product((-PERTURBATION, PERTURBATION), repeat=3)]
    count = len(parameters)
    relative_M, relative_mu, angles = np.repeat(np.array(changes).T, count, axis=1)
    states = np.zeros((count * len(changes), 4))
    states[:, 0] = START_THETA + angles
    results = simulate(
        family,
        np.tile(parameters, (len(changes), 1)),
        np.tile(M, len(changes)) * (1.0 + relative_M),
        np.tile(mu, len(changes)) * (1.0 + relative_mu),
        states=states,
        threads=threads,
    )
    speeds = results["mean_speed"].reshape(len(changes), count)
    failed = results["failed"].reshape(len(changes), count).any(axis=0)
    scale = np.maximum(np.abs(speeds[0]), 1e-9)
    sensitivity = np.where(failed, 1.0, np.abs(speeds - speeds[0]).max(axis=0) / scale)
    return speeds[0], results["cost_of_transport"][:count], sensitivity


def worst_speeds(
    family: Family, parameters: np.ndarray, M: np.ndarray, mu: np.ndarray, *, threads: int = 1
) -> np.ndarray:
    """The slowest mean speeds over the plants of `TOLERATED`, cm/s, shape (n,); below -1 where one of them fails.

    Args:
        family: of the gaits.
        parameters: shape (n, size).
        M: kg, shape (n,).
        mu: shape (n,).
        threads: that share the batch.
    """
    factors = np.array(TOLERATED)
    count = len(parameters)
    results = simulate(
        family,
        np.tile(parameters, (len(factors), 1)),
        np.outer(factors[:, 0], M).reshape(-1),
        np.outer(factors[:, 1], mu).reshape(-1),
        threads=threads,
    )
    return _without_failures(results).reshape(len(factors), count).min(axis=0)


def _without_failures(results: dict[str, np.ndarray]) -> np.ndarray:
    """Mean speeds, but -2 to -1 cm/s for runs that fail: what they had covered would flatter them."""
    return np.where(results["failed"] > 0.0, -2.0 + results["duration"] / HORIZON, results["mean_speed"])


def recheck(gaits: Sequence[Gait], *, threads: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Simulates gaits again on their own plants.

    Args:
        gaits: of any families.
        threads: that share the batch.

    Returns:
        Mean speeds in cm/s and costs of transport, in order of the gaits.
    """
    speeds, transports = np.zeros(len(gaits)), np.zeros(len(gaits))
    for name, family in FAMILIES.items():
        rows = [i for i, gait in enumerate(gaits) if gait.family == name]
        if rows:
            parameters, M, mu = (
                np.array([getattr(gaits[i], field) for i in rows]) for field in ("parameters", "M", "mu")
            )
            results = simulate(family, parameters, M, mu, threads=threads)
            speeds[rows], transports[rows] = results["mean_speed"], results["cost_of_transport"]
    return speeds, transports


def choose(gaits: Sequence[Gait], *, threads: int = 1) -> Choice:
    """Makes the oracle's map.

    On every cell's centre all gaits are tried for a short time; the fastest few then run the whole horizon all over the
    cell and from two starts, and the one whose slowest run is fastest is chosen.

    Args:
        gaits: to choose from.
        threads: that share the batch.
    """
    M, mu = np.linspace(*MAP_M), np.geomspace(*MAP_MU)
    half_M, half_mu = 0.5 * (M[1] - M[0]), (mu[1] / mu[0]) ** 0.5
    centres = np.array(list(product(M, mu)))
    trials = np.zeros((len(gaits), len(centres)))
    for n, gait in enumerate(gaits):
        parameters = np.tile(gait.parameters, (len(centres), 1))
        family = FAMILIES[gait.family]
        results = simulate(family, parameters, *centres.T, horizon=TRIAL, late_from=TRIAL / 2.0, threads=threads)
        trials[n] = np.where(results["failed"] > 0.0, -1.0, results["late_speed"])
    worst = np.full(trials.shape, -math.inf)
    finalists = np.argsort(-trials, axis=0, kind="stable")[:FINALISTS]
    # All over the cell it shows how a gait bears the cell's width, from two starts whether it has a slow rival motion
    # that a small change leads to.
    offsets = np.array(list(product((-1.0, 0.0, 1.0), (-1.0, 0.0, 1.0), (0.0, PERTURBATION))))
    for name, family in FAMILIES.items():
        pairs = [(n, cell) for cell, own in enumerate(finalists.T) for n in own if gaits[n].family == name]
        if not pairs:
            continue
        parameters = np.repeat(np.array([gaits[n].parameters for n, _ in pairs]), len(offsets), axis=0)
        plants = np.repeat(centres[[cell for _, cell in pairs]], len(offsets), axis=0)
        steps_M, steps_mu, angles = np.tile(offsets, (len(pairs), 1)).T
        plants += np.outer(steps_M, (half_M, 0.0))
        plants[:, 1] *= half_mu**steps_mu
        states = np.zeros((len(plants), 4))
        states[:, 0] = START_THETA + angles
        speeds = _without_failures(simulate(family, parameters, *plants.T, states=states, threads=threads))
        for (n, cell), own in zip(pairs, speeds.reshape(len(pairs), len(offsets)), strict=True):
            worst[n, cell] = own.min()
    best = worst.argmax(axis=0).reshape(len(M), len(mu))
    rows = tuple(tuple(gaits[index] for index in row) for row in best)
    return Choice(tuple(np.round(M, 6).tolist()), tuple(float(f"{value:.6g}") for value in mu), rows)
