"""The search for gaits: an iteration runs one CMA-ES for every plant, side by side, all candidates in one batch."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from baselines.archive import PLANTS
from baselines.gaits.archive import Archive, Gait
from baselines.gaits.families import FAMILIES
from baselines.gaits.simulation import (
    LARGEST_SENSITIVITY,
    PERTURBED,
    SHORT_HORIZON,
    TOLERATED,
    sensitivity,
    simulate,
    worst_speed,
)
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import HORIZON

POPULATION = 16
RANDOM_STARTS = 128
# Candidates that a run keeps for the evaluation at its end.
FINALISTS = 3
FAILURE = -30.0
# Shares of the largest speed for which the front looks for the cheapest gait; cm/s while no speed is known.
FRONT_SHARES = tuple(i / 10.0 for i in range(1, 11))
FIRST_GOAL = 10.0
# Missing the required speed by 1 cm/s costs more than any transport.
FRONT_PENALTY = 3.0


@dataclass(frozen=True)
class Purpose:
    """What an iteration looks for.

    Attributes:
        generations: of its CMA-ES runs.
        restarts: runs per plant, or per required speed of the front.
        sigmas: range of the initial step sizes, in the families' units.
        short: whether it maximises the speed in the second half of 12 s instead of that over 33 s.
        known: whether it starts from known gaits instead of random ones.
        variants: changes of the plant under all of which a candidate must do well.
    """

    generations: int
    restarts: int
    sigmas: tuple[float, float]
    short: bool
    known: bool
    variants: np.ndarray = field(default_factory=lambda: PERTURBED[:1])


# They take turns in this order. A heavy platform tolerates more, so three corners say nearly as much as all.
PURPOSES = {
    "explore": Purpose(80, 4, (0.6, 0.6), short=True, known=False),
    "refine": Purpose(80, 4, (0.1, 0.4), short=True, known=True),
    "finish": Purpose(40, 2, (0.03, 0.15), short=False, known=True),
    "front": Purpose(40, 2, (0.15, 0.4), short=False, known=True),
    "tolerate": Purpose(40, 2, (0.1, 0.4), short=True, known=True, variants=TOLERATED[1:4]),
}


def score(results: dict[str, np.ndarray], horizon: float, goals: np.ndarray | None = None) -> np.ndarray:
    """What the search maximises: the late speed, cm/s, or less cost of transport at a required speed.

    Args:
        results: metrics of candidates.
        horizon: length of the episodes, s.
        goals: required speeds of the front, cm/s, one per candidate.

    Returns:
        Of the metrics' shape; failures score far below all else, and the later they fail the better.
    """
    value = results["late_speed"]
    if goals is not None:
        transport = np.minimum(results["cost_of_transport"], 20.0)
        value = -transport - FRONT_PENALTY * np.maximum(0.0, goals - results["mean_speed"])
    return np.where(results["failed"] > 0.0, FAILURE * (2.0 - results["duration"] / horizon), value)


def cma_strategy(start: np.ndarray, sigma: float, population: int, rng: np.random.Generator) -> Any:
    """A CMA-ES, whose draws come from the generator.

    Args:
        start: the initial mean.
        sigma: the initial step size.
        population: candidates per generation.
        rng: the package would otherwise seed numpy's global generator.

    Raises:
        ImportError: if the package cma is not installed.
    """
    try:
        cma = importlib.import_module("cma")
    except ImportError as error:
        raise ImportError('the gait search needs the package cma: pip install "capsule-gym[paper]"') from error
    options = {
        "popsize": population,
        "verbose": -9,
        "seed": math.nan,
        "randn": lambda *shape: rng.standard_normal(shape),
    }
    return cma.CMAEvolutionStrategy(start, sigma, options)


@dataclass
class Run:
    """One CMA-ES run of an iteration.

    Attributes:
        target: M in kg and mu of its plant, and the required speed in cm/s, NaN to maximise the speed; shape (3,).
        strategy: the CMA-ES.
        best: the best candidates as (score, parameters in the family's units), best first.
    """

    target: np.ndarray
    strategy: Any
    best: list[tuple[float, np.ndarray]] = field(default_factory=list)


class Search:
    """The search for gaits.

    Args:
        archive: what is known; changed in place.
        families: names of the families that take turns; all where none is given.
        purposes: names of the purposes that take turns; all where none is given.
        seed: of the whole search; iteration i draws from the stream (seed, i).
        command: stored with the gaits that it finds.
    """

    def __init__(
        self,
        archive: Archive,
        families: Sequence[str] = (),
        purposes: Sequence[str] = (),
        seed: int = 0,
        command: str = "",
    ) -> None:
        self.archive = archive
        self.families, self.purposes = families or tuple(FAMILIES), purposes or tuple(PURPOSES)
        self.seed, self.command = seed, command

    def iterations(self, minutes: float = math.inf, count: float = math.inf) -> Iterator[None]:
        """Runs iterations as it is iterated, until the time or their number is up."""
        deadline, done = perf_counter() + 60.0 * minutes, 0
        while done < count and perf_counter() < deadline:
            self._iterate(deadline)
            done += 1
            yield

    def _iterate(self, deadline: float) -> None:
        """One iteration; Ctrl-C keeps what it has found so far."""
        archive, number, began = self.archive, self.archive.iterations, perf_counter()
        family = self.families[number % len(self.families)]
        purpose = self.purposes[number // len(self.families) % len(self.purposes)]
        rng = np.random.default_rng([self.seed, number])
        archive.iterations += 1
        runs: list[Run] = []
        interruption = None
        try:
            runs = self._start(family, purpose, rng)
            for _ in range(PURPOSES[purpose].generations):
                if perf_counter() > deadline:
                    break
                self._advance(family, purpose, runs)
        except KeyboardInterrupt as error:
            interruption = error
        archive.seconds += perf_counter() - began
        better = self._keep(family, purpose, [run for run in runs if run.best], number)
        speeds = [gait.mean_speed for gait in archive.fastest().values()]
        print(
            f"iteration {number} ({purpose}, {family}): {better} entries better in {perf_counter() - began:.0f} s; "
            f"mean of {len(speeds)} plants {np.mean(speeds or [0.0]):.2f} cm/s",
            flush=True,
        )
        if interruption is not None:
            raise interruption

    def _start(self, family: str, purpose: str, rng: np.random.Generator) -> list[Run]:
        """The CMA-ES runs of an iteration; each starts from the best of known, or of random, gaits on its plant."""
        units, (low, high) = np.array(FAMILIES[family].units), PURPOSES[purpose].sigmas
        targets = np.array([(M, mu, math.nan) for M, mu in PLANTS])
        if purpose == "front":
            nominal = self.archive.of_plant(NOMINAL.M, NOMINAL.mu)
            top = nominal[0].mean_speed if nominal else FIRST_GOAL
            targets = np.array([(NOMINAL.M, NOMINAL.mu, share * top) for share in FRONT_SHARES])
        starts = np.array([gait.parameters for gait in self.archive.everything() if gait.family == family])
        if not (len(starts) and PURPOSES[purpose].known):
            draws = rng.standard_normal((RANDOM_STARTS, len(units)))
            starts = np.array(FAMILIES[family].start) + np.array(FAMILIES[family].spread) * draws
        count = len(starts)
        every = np.tile(starts, (len(targets), 1)), np.repeat(targets, count, axis=0)
        scores = self._scores(family, PURPOSES[purpose].variants, *every, SHORT_HORIZON).reshape(-1, count)
        runs = []
        for target, order in zip(targets, np.argsort(-scores, axis=1), strict=True):
            for restart in range(PURPOSES[purpose].restarts):
                # Half of the restarts take the best, half the next best ones, which may lie in other basins.
                rank = min((restart + 1) // 2 if restart % 2 else 0, count - 1)
                sigma = low * (high / low) ** rng.random()
                runs.append(Run(target, cma_strategy(starts[order[rank]] / units, sigma, POPULATION, rng)))
        return runs

    def _scores(
        self, family: str, variants: np.ndarray, parameters: np.ndarray, targets: np.ndarray, horizon: float
    ) -> np.ndarray:
        """The scores of candidates for their targets: the worst over the variants of the plant."""
        M, mu, goals = targets.T
        results = simulate(family, parameters, M, mu, variants=variants, horizon=horizon)
        if horizon == HORIZON:
            results["late_speed"] = results["mean_speed"]
        return score(results, horizon, None if np.isnan(goals).any() else goals).min(axis=0)

    def _advance(self, family: str, purpose: str, runs: Sequence[Run]) -> None:
        """One generation of all runs."""
        points = np.array([run.strategy.ask() for run in runs])
        parameters = (points * FAMILIES[family].units).reshape(len(runs) * POPULATION, -1)
        targets = np.repeat([run.target for run in runs], POPULATION, axis=0)
        horizon = SHORT_HORIZON if PURPOSES[purpose].short else HORIZON
        scores = self._scores(family, PURPOSES[purpose].variants, parameters, targets, horizon)
        for run, own, values in zip(runs, points, scores.reshape(len(runs), -1), strict=True):
            run.strategy.tell(list(own), (-values).tolist())
            candidates = [*run.best, *zip(values.tolist(), own, strict=True)]
            run.best = sorted(candidates, key=lambda each: -each[0])[:FINALISTS]
        self.archive.evaluations += len(parameters)

    def _keep(self, family: str, purpose: str, runs: Sequence[Run], number: int) -> int:
        """Simulates the best candidates over the whole horizon and keeps better, robust ones; returns how many."""
        if not runs:
            return 0
        points = np.array([point for run in runs for _, point in run.best]) * FAMILIES[family].units
        # Rounded before the evaluation, as they are written.
        points = np.array([[float(f"{value:.9g}") for value in point] for point in points])
        M, mu = np.array([run.target[:2] for run in runs for _ in run.best]).T
        results = simulate(family, points, M, mu, variants=PERTURBED)
        changes, speeds, tolerant = sensitivity(results), results["mean_speed"][0], purpose == "tolerate"
        if tolerant:
            speeds = worst_speed(simulate(family, points, M, mu, variants=TOLERATED))
        better = 0
        # The best first, so that an entry is replaced, and counted, once.
        for i in np.argsort(-speeds):
            if not changes[i] < LARGEST_SENSITIVITY:
                continue
            gait = Gait(
                M=float(M[i]),
                mu=float(mu[i]),
                family=family,
                parameters=tuple(points[i].tolist()),
                mean_speed=float(results["mean_speed"][0, i]),
                cost_of_transport=float(results["cost_of_transport"][0, i]),
                sensitivity=float(changes[i]),
                worst_speed=float(speeds[i]) if tolerant else None,
                seed=(self.seed, number),
                evaluations=self.archive.evaluations,
                seconds=round(self.archive.seconds, 1),
                command=self.command,
            )
            better += self.archive.offer(gait)
            if (gait.M, gait.mu) == (NOMINAL.M, NOMINAL.mu) and not tolerant:
                self.archive.offer_front(gait)
        return better
