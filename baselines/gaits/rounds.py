"""The rounds of the gait search: one CMA-ES for every plant, side by side, all candidates in one batch."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from baselines.gaits.archive import Archive, Gait
from baselines.gaits.families import FAMILIES, Family
from baselines.gaits.simulation import TOLERATED, robust_metrics, simulate, worst_speeds
from capsule_gym.parameters import Capsule
from capsule_gym.task import HORIZON

NOMINAL = Capsule()
SHORT_HORIZON = 12.0
POPULATION = 16
RANDOM_STARTS = 128


@dataclass(frozen=True)
class Purpose:
    """What a round is for.

    Attributes:
        generations: of its CMA-ES runs.
        restarts: such runs per plant, or per goal of the front.
        sigmas: range of the first steps, in the families' units.
        short: whether it looks at the second half of 12 s instead of the whole 33 s.
        known: whether it starts from known gaits instead of random ones.
        variants: factors of M and mu of the plants that a candidate must do well on, all of them.
    """

    generations: int
    restarts: int
    sigmas: tuple[float, float]
    short: bool
    known: bool
    variants: tuple[tuple[float, float], ...] = ((1.0, 1.0),)


# They take turns in this order. Three corners say nearly as much as all: a heavy platform forgives.
PURPOSES = {
    "explore": Purpose(80, 4, (0.6, 0.6), short=True, known=False),
    "refine": Purpose(80, 4, (0.1, 0.4), short=True, known=True),
    "finish": Purpose(40, 2, (0.03, 0.15), short=False, known=True),
    "front": Purpose(40, 2, (0.15, 0.4), short=False, known=True),
    "tolerate": Purpose(40, 2, (0.1, 0.4), short=True, known=True, variants=(TOLERATED[1], TOLERATED[2], TOLERATED[3])),
}
FRONT_SHARES = tuple(i / 10.0 for i in range(1, 11))
# Centimetres per second below the asked speed cost far more than any transport is worth.
FRONT_PENALTY = 3.0
# The fastest goal of the front, in cm/s, while no gait of the nominal plant is known.
FIRST_GOAL = 10.0
FINALISTS = 3
LARGEST_SENSITIVITY = 0.01
FAILURE = -30.0
PROGRESS_SECONDS = 10.0


@dataclass
class Job:
    """One CMA-ES run inside a round.

    Attributes:
        M: mass of its plant, kg.
        mu: friction coefficient of its plant.
        goal: speed in cm/s that a gait of the front must have; None maximises the speed.
        start: where it starts, in the family's units.
        sigma: its first step.
        best: the finalists as (score, parameters in the family's units), best first.
    """

    M: float
    mu: float
    goal: float | None
    start: np.ndarray
    sigma: float
    best: list[tuple[float, np.ndarray]] = field(default_factory=list)

    def remember(self, scores: np.ndarray, points: Sequence[np.ndarray]) -> None:
        """Keeps the best candidates seen."""
        fresh = [(float(scores[i]), np.asarray(points[i])) for i in np.argsort(-scores)[:FINALISTS]]
        self.best = sorted([*self.best, *fresh], key=lambda each: -each[0])[:FINALISTS]


def score(results: dict[str, np.ndarray], horizon: float, goals: np.ndarray | None = None) -> np.ndarray:
    """What the search maximises: the late mean speed, cm/s, or the cost of transport at a speed; failures far below.

    Args:
        results: of `simulate`.
        horizon: length of the episodes, s.
        goals: cm/s, one per candidate, for the front.
    """
    value = results["late_speed"]
    if goals is not None:
        transport = np.minimum(results["cost_of_transport"], 20.0)
        value = -transport - FRONT_PENALTY * np.maximum(0.0, goals - results["mean_speed"])
    # Surviving longer is better, so that a search that starts with failures finds its way out.
    return np.where(results["failed"] > 0.0, FAILURE * (2.0 - results["duration"] / horizon), value)


def import_cma() -> Any:
    """The package cma.

    Raises:
        ImportError: if it is not installed, with what would install it.
    """
    try:
        return importlib.import_module("cma")
    except ImportError as error:
        raise ImportError(
            'the gait search needs the package cma, which is not installed: pip install "capsule-gym[paper]"'
        ) from error


class Search:
    """The search over an archive of gaits.

    Args:
        archive: what is known; changed in place.
        families: names of the families that take turns; None is all of them.
        purposes: names of the purposes that take turns; None is all of them.
        seed: of the whole search; round r draws from the stream (seed, r).
        threads: for the batch.
        report: takes the progress, a line of text.
        command: for the provenance.
    """

    def __init__(
        self,
        archive: Archive,
        *,
        families: Sequence[str] | None = None,
        purposes: Sequence[str] | None = None,
        seed: int = 0,
        threads: int = 1,
        report: Callable[[str], None] = print,
        command: str = "",
    ) -> None:
        self.archive = archive
        self.families = tuple(families or FAMILIES)
        self.purposes = tuple(purposes or PURPOSES)
        self.seed = seed
        self.threads = threads
        self.report = report
        self.command = command
        self.cma = import_cma()
        self.began = perf_counter()
        self.deadline = math.inf
        self.steps = 0
        self.candidates = 0
        self._reported = self.began

    def run(self, *, minutes: float = math.inf, rounds: float = math.inf, save: Callable[[Archive], None]) -> bool:
        """Runs rounds until the time or their number is up, or Ctrl-C; returns whether it was Ctrl-C.

        Args:
            minutes: time for this call.
            rounds: number of rounds for this call.
            save: called with the archive after every round, also the interrupted one.
        """
        self.deadline = self.began + 60.0 * minutes
        done = 0
        interrupted = False
        while done < rounds and perf_counter() < self.deadline and not interrupted:
            interrupted = self._round(self.archive.rounds)
            done += 1
            save(self.archive)
        return interrupted

    def _round(self, number: int) -> bool:
        """One round; returns whether Ctrl-C ended it."""
        family = FAMILIES[self.families[number % len(self.families)]]
        purpose = self.purposes[number // len(self.families) % len(self.purposes)]
        rng = np.random.default_rng([self.seed, number])
        began, interrupted = perf_counter(), False
        jobs: list[Job] = []
        before = self.candidates
        try:
            jobs = self._jobs(family, purpose, rng)
            self._evolve(family, purpose, jobs, rng, number)
        except KeyboardInterrupt:
            interrupted = True
            self.report("interrupted: keeping what this round has found")
        seconds = perf_counter() - began
        self.archive.rounds += 1
        self.archive.evaluations += self.candidates - before
        self.archive.seconds += seconds
        better = self._harvest(family, purpose, [job for job in jobs if job.best], number)
        self.report(
            f"round {number} ({purpose}, {family.name}): {better} entries better, "
            f"{self.candidates - before} candidates in {seconds:.0f} s; {self._standing()}"
        )
        return interrupted

    def _standing(self) -> str:
        speeds = self.archive.table().values()
        nominal = self.archive.of_plant(NOMINAL.M, NOMINAL.mu)
        return (
            f"nominal {nominal[0].mean_speed if nominal else 0.0:.2f} cm/s, "
            f"mean of {len(speeds)} plants {np.mean([each.mean_speed for each in speeds] or [0.0]):.2f} cm/s"
        )

    def _jobs(self, family: Family, purpose: str, rng: np.random.Generator) -> list[Job]:
        """The CMA-ES runs of a round, each with its starting point."""
        units = np.array(family.units)
        plants: list[tuple[float, float, float | None]] = [(*plant, None) for plant in self.archive.plants]
        if purpose == "front":
            best = self.archive.of_plant(NOMINAL.M, NOMINAL.mu)
            top = best[0].mean_speed if best else FIRST_GOAL
            plants = [(NOMINAL.M, NOMINAL.mu, share * top) for share in FRONT_SHARES]
        known = [gait.parameters for gait in self.archive.everything() if gait.family == family.name]
        if known and PURPOSES[purpose].known:
            starts = np.broadcast_to(np.array(known), (len(plants), len(known), len(units)))
        else:
            draws = rng.standard_normal((len(plants), RANDOM_STARTS, len(units)))
            starts = np.array(family.start) + np.array(family.spread) * draws
        low, high = PURPOSES[purpose].sigmas
        first = [Job(M, mu, goal, np.zeros(len(units)), low) for M, mu, goal in plants]
        count = starts.shape[1]
        owners = [job for job in first for _ in range(count)]
        values = self._scores(family, purpose, starts.reshape(-1, len(units)), owners, SHORT_HORIZON)
        jobs = []
        for job, own, points in zip(first, values.reshape(len(first), count), starts, strict=True):
            order = np.argsort(-own)
            for restart in range(PURPOSES[purpose].restarts):
                # Half of the restarts take the best, half the next best ones, which may lie in other basins.
                rank = min((restart + 1) // 2 if restart % 2 else 0, count - 1)
                sigma = low * (high / low) ** rng.random()
                jobs.append(Job(job.M, job.mu, job.goal, points[order[rank]] / units, sigma))
        return jobs

    def _scores(
        self, family: Family, purpose: str, parameters: np.ndarray, jobs: Sequence[Job], horizon: float
    ) -> np.ndarray:
        """The scores of candidates, each for its job: the worst over the purpose's variants of the plant."""
        worst = np.full(len(jobs), math.inf)
        goals = np.array([math.nan if job.goal is None else job.goal for job in jobs])
        for factor_M, factor_mu in PURPOSES[purpose].variants:
            results = simulate(
                family,
                parameters,
                np.array([job.M * factor_M for job in jobs]),
                np.array([job.mu * factor_mu for job in jobs]),
                horizon=horizon,
                late_from=horizon / 2.0 if horizon < HORIZON else 0.0,
                threads=self.threads,
            )
            self.steps += int(results["steps"].sum())
            worst = np.minimum(worst, score(results, horizon, None if np.isnan(goals).any() else goals))
        return worst

    def _evolve(self, family: Family, purpose: str, jobs: Sequence[Job], rng: np.random.Generator, number: int) -> None:
        """Runs the generations of all jobs side by side."""
        horizon = SHORT_HORIZON if PURPOSES[purpose].short else HORIZON
        units = np.array(family.units)
        options = {
            "popsize": POPULATION,
            "verbose": -9,
            # A stream of its own: the package would seed numpy's global generator.
            "seed": math.nan,
            "randn": lambda *shape: rng.standard_normal(shape),
        }
        strategies = [self.cma.CMAEvolutionStrategy(job.start, job.sigma, dict(options)) for job in jobs]
        generations = PURPOSES[purpose].generations
        for generation in range(generations):
            points = [strategy.ask() for strategy in strategies]
            flat = np.concatenate(points)
            owners = [job for job in jobs for _ in range(POPULATION)]
            values = self._scores(family, purpose, flat * units, owners, horizon).reshape(len(jobs), POPULATION)
            for strategy, job, own, value in zip(strategies, jobs, points, values, strict=True):
                strategy.tell(own, (-value).tolist())
                job.remember(value, own)
            self.candidates += flat.shape[0]
            now = perf_counter()
            if now > self.deadline:
                break
            if now - self._reported > PROGRESS_SECONDS:
                self._reported = now
                left = "" if math.isinf(self.deadline) else f", {(self.deadline - now) / 60.0:.1f} min left"
                self.report(
                    f"round {number} ({purpose}, {family.name}), generation {generation + 1}/{generations}: "
                    f"{self.steps / (now - self.began):.3g} steps/s, best {max(job.best[0][0] for job in jobs):.2f}, "
                    f"{self._standing()}{left}"
                )

    def _harvest(self, family: Family, purpose: str, jobs: Sequence[Job], number: int) -> int:
        """Takes the finalists over the whole horizon and keeps what is better and robust; returns how many."""
        if not jobs:
            return 0
        points = np.array([point for job in jobs for _, point in job.best]) * np.array(family.units)
        # What is written is what is judged.
        points = np.array([[float(f"{value:.9g}") for value in point] for point in points])
        owners = [job for job in jobs for _ in job.best]
        M, mu = np.array([(job.M, job.mu) for job in owners]).T
        speeds, transports, sensitivities = robust_metrics(family, points, M, mu, threads=self.threads)
        worst = worst_speeds(family, points, M, mu, threads=self.threads) if purpose == "tolerate" else speeds
        better = 0
        # The best first, so that an entry is replaced, and counted, once.
        for i in np.argsort(-worst):
            if not sensitivities[i] < LARGEST_SENSITIVITY:
                continue
            gait = Gait(
                M=float(M[i]),
                mu=float(mu[i]),
                family=family.name,
                parameters=tuple(points[i].tolist()),
                mean_speed=float(speeds[i]),
                cost_of_transport=float(transports[i]),
                sensitivity=float(sensitivities[i]),
                worst_speed=float(worst[i]) if purpose == "tolerate" else None,
                seed=(self.seed, number),
                evaluations=self.archive.evaluations,
                seconds=round(self.archive.seconds, 1),
                command=self.command,
            )
            if gait.worst_speed is not None:
                better += self.archive.offer_tolerant(gait)
                continue
            better += self.archive.offer(gait)
            if (gait.M, gait.mu) == (NOMINAL.M, NOMINAL.mu):
                self.archive.offer_front(gait)
        return better
