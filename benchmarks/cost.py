"""Accuracy against cost: error after ten seconds, over the computing that a simulated second takes.

The error is that of `python -m benchmarks.accuracy`: the largest deviation in any state from DOP853 at the end of a
trajectory under random torque. The cost is that of a batch on one thread, per environment: all that `step` of
`gym.make_vec` does for ours, the physics alone for MuJoCo.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks import accuracy
from benchmarks.contenders import (
    ACTION_SCALE,
    DIRECT_BATCH,
    PEER_BATCH,
    STEPPED_INTEGRATOR,
    THREADS,
    mujoco_contender,
    our_batch,
)
from benchmarks.frictions import FRICTIONS, INTEGRATORS, Friction, series_name
from benchmarks.machine import available_cores
from benchmarks.timing import Contender, Progress, Rate, measure
from capsule_gym import task
from capsule_gym.parameters import DIRECT_PHYSICS_DT, Capsule

MUJOCO_STEPS_MS = (0.5, 1.0, 2.0, 5.0)
# Where a smaller step still helps MuJoCo: the default contacts stay at the error of their softness.
FINE_STEP_MS = 0.1
CLAIMED_RATIO = 100.0


class Case(NamedTuple):
    """A friction coefficient and an amplitude of the random torque, N m."""

    mu: float
    amplitude: float

    def __str__(self) -> str:
        return f"mu = {self.mu:g}, ±{self.amplitude:g} N m"


CASES = (Case(0.01, 0.5), Case(0.1, 1.0))


@dataclass(frozen=True)
class Point:
    """One model at one step.

    Attributes:
        series: the model, with its integrator.
        physics_dt: step of the integrator, s.
        cost: microseconds of computing per simulated second and environment.
        spread: interquartile range of the cost over the median.
        errors: largest error in any state over the trajectories, one per case.
    """

    series: str
    physics_dt: float
    cost: float
    spread: float
    errors: tuple[float, ...]


@dataclass(frozen=True)
class _Job:
    """What becomes a `Point`: MuJoCo's friction and integrator are None for ours."""

    series: str
    contender: Contender
    physics_dt: float
    friction: Friction | None = None
    integrator: str = ""


OURS = "capsule_gym"


def _jobs(with_mujoco: bool, quick: bool) -> list[_Job]:
    """Everything that is measured."""
    jobs = []
    for milliseconds in accuracy.STEPS_MS:
        dt = 1e-3 * milliseconds
        contender = our_batch(f"{OURS}, {milliseconds:g} ms", PEER_BATCH, dt, scale=ACTION_SCALE)
        jobs.append(_Job(OURS, contender, dt))
    for friction in FRICTIONS if with_mujoco else ():
        fine = (FINE_STEP_MS,) if friction.stiff and not quick else ()
        for integrator in INTEGRATORS:
            for milliseconds in (*fine, *MUJOCO_STEPS_MS):
                dt = 1e-3 * milliseconds
                contender = mujoco_contender(friction, integrator, dt)
                jobs.append(_Job(series_name(friction, integrator), contender, dt, friction, integrator))
    return jobs


def mujoco_error(
    case: Case, expected: list[accuracy.Expected], friction: Friction, integrator: str, timestep: float
) -> float:
    """The largest error in any state over the trajectories of a case.

    Args:
        case: the plant.
        expected: the reference's trajectories.
        friction: how MuJoCo models the floor.
        integrator: MuJoCo's.
        timestep: s.
    """
    from benchmarks import mujoco_capsule

    model = mujoco_capsule.build_model(Capsule(mu=case.mu), friction, integrator, timestep)
    torques = np.array([trajectory.torques for trajectory in expected])
    states = mujoco_capsule.simulate(model, torques, accuracy.START, accuracy.HOLD, available_cores())
    ends = zip(states, expected, strict=True)
    return max(float(np.abs(found[known.holds - 1] - known.state).max()) for found, known in ends)


def measure_points(with_mujoco: bool, turns: int, seconds: float, trajectories: int, quick: bool) -> list[Point]:
    """Errors and costs of ours and MuJoCo at every step.

    Args:
        with_mujoco: whether MuJoCo is installed.
        turns: turns of the timing.
        seconds: length of a turn.
        trajectories: per case.
        quick: leaves out what takes longest.
    """
    jobs = _jobs(with_mujoco, quick)
    rates = measure([job.contender for job in jobs], turns, seconds, "cost")
    progress = Progress("errors", len(CASES) * (1 + len(jobs)))
    errors: list[list[float]] = [[] for _ in jobs]
    for case in CASES:
        expected = accuracy.expected_trajectories(case.mu, case.amplitude, trajectories)
        own = dict(zip(accuracy.STEPS_MS, accuracy.errors(case.mu, expected).max(axis=0), strict=True))
        progress.step(f"{case}, reference")
        for job, found in zip(jobs, errors, strict=True):
            if job.friction is None:
                found.append(float(own[round(1e3 * job.physics_dt, 6)]))
            else:
                found.append(mujoco_error(case, expected, job.friction, job.integrator, job.physics_dt))
            progress.step(f"{case}, {job.contender.label}")
    return [
        Point(
            job.series, job.physics_dt, cost_of(rates[job.contender.name]), rates[job.contender.name].spread, tuple(e)
        )
        for job, e in zip(jobs, errors, strict=True)
    ]


def cost_of(rate: Rate) -> float:
    """Microseconds of computing per simulated second and environment."""
    return 1e6 / (task.CONTROL_DT * rate.median)


@dataclass(frozen=True)
class Claim:
    """Ours against one MuJoCo batch at the same step and number of threads.

    Attributes:
        peer: MuJoCo's friction and integrator.
        threads: of both.
        ours: env-steps/s.
        theirs: env-steps/s.
        our_errors: one per case.
        their_errors: likewise.
    """

    peer: str
    threads: int
    ours: float
    theirs: float
    our_errors: tuple[float, ...]
    their_errors: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """How many times as fast ours is."""
        return self.ours / self.theirs

    @property
    def holds(self) -> bool:
        """At least `CLAIMED_RATIO` times as fast with no larger error in any case."""
        no_worse = all(own <= other for own, other in zip(self.our_errors, self.their_errors, strict=True))
        return self.ratio >= CLAIMED_RATIO and no_worse


def claims(rates: Mapping[str, Rate], points: Iterable[Point]) -> list[Claim]:
    """The comparison at the default step, for every MuJoCo batch that was measured there.

    Args:
        rates: of the contenders, by name.
        points: errors and costs.
    """
    errors = {point.series: point.errors for point in points if abs(point.physics_dt - DIRECT_PHYSICS_DT) < 1e-9}
    found = []
    for threads in THREADS:
        own = our_batch(DIRECT_BATCH, PEER_BATCH, DIRECT_PHYSICS_DT, threads).name
        for friction in FRICTIONS:
            peer = mujoco_contender(friction, STEPPED_INTEGRATOR, DIRECT_PHYSICS_DT, threads).name
            series = series_name(friction, STEPPED_INTEGRATOR)
            if own in rates and peer in rates and series in errors:
                both = rates[own].median, rates[peer].median
                found.append(Claim(series, threads, *both, errors[OURS], errors[series]))
    return found
