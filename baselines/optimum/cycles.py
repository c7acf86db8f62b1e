"""The optimum's cycle: one period of the motion that is kept, for figures and comparisons."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from baselines.optimum.motion import ACTIONS, SETTLED, Motion, cycle_starts, repeat
from baselines.optimum.records import key_of, known_optima
from baselines.optimum.solver import Problem
from capsule_gym.parameters import DIRECT_PHYSICS_DT

NOMINAL_PROBLEM = Problem()
# rad, rad/s, m, m/s: by how much the ends of a cycle may differ in each to count alike.
SCALES = np.array([0.1, 1.0, np.inf, 0.05])


@dataclass(frozen=True)
class Cycle:
    """One period, sampled at every step of the integrator; every array is float64 of shape (samples,).

    It begins where the pendulum turns forwards on the left; the motion repeats itself but for a few percent, and this
    is the period whose ends differ the least.

    Attributes:
        time: s, from 0.
        theta: rad.
        theta_dot: rad/s.
        x: m, from 0.
        x_dot: m/s.
        normal_force: N, the smaller of the step that begins there.
        torque: N m, held from there on.
        stick: 1.0 where the platform sticks throughout the step that begins there, else 0.0.
        period: s.
        speed: mean of the cycle, cm/s.
    """

    time: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    x: np.ndarray
    x_dot: np.ndarray
    normal_force: np.ndarray
    torque: np.ndarray
    stick: np.ndarray
    period: float
    speed: float


@lru_cache(maxsize=8)
def cycle(problem: Problem = NOMINAL_PROBLEM) -> Cycle:
    """One period of the motion on file; of the nominal plant unless another problem is named.

    Args:
        problem: one of those that `python -m baselines.optimum` solves.

    Raises:
        ValueError: if there is no motion of it, or no cycle in that.
    """
    archive = known_optima()
    if key_of(problem) not in archive.records:
        raise ValueError(f"problem must be one of those on file, got {problem}")
    choices = archive.choices[key_of(problem)]
    # The same steps of the integrator, each a hold of its own: the same motion.
    substeps = round(problem.hold / DIRECT_PHYSICS_DT)
    fine = replace(problem, hold=problem.hold / substeps)
    begin, end = _most_periodic(repeat(problem, choices), problem)
    # One hold more, for where the cycle ends.
    motion = repeat(fine, np.repeat(choices[: end + 1], substeps))
    part = slice(begin * substeps, end * substeps)
    theta, theta_dot, x, x_dot = (motion.states[part, row, 0] for row in range(4))
    period = (end - begin) * problem.hold
    stuck = np.diff(motion.stuck[:, 0], prepend=0.0)[part]
    return Cycle(
        time=fine.hold * np.arange(theta.size),
        theta=theta,
        theta_dot=theta_dot,
        x=x - x[0],
        x_dot=x_dot,
        normal_force=motion.normal_forces[part, 0],
        torque=problem.torque_limit * ACTIONS[motion.choices[part, 0]],
        stick=(stuck > 0.5 * fine.hold).astype(np.float64),
        period=period,
        speed=float(100.0 * (motion.states[part.stop, 2, 0] - x[0]) / period),
    )


def _most_periodic(motion: Motion, problem: Problem) -> tuple[int, int]:
    """The first and last hold of the settled cycle whose ends differ the least."""
    starts = cycle_starts(motion)
    starts = starts[starts * problem.hold >= SETTLED]
    if starts.size < 2:
        raise ValueError(f"the motion of {problem} has no cycle after {SETTLED:g} s")
    states = motion.states[starts, :, 0]
    apart = np.abs(np.diff(states, axis=0) / SCALES).max(axis=1)
    n = int(apart.argmin())
    return int(starts[n]), int(starts[n + 1])
