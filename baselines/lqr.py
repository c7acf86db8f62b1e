"""LQR about a limit cycle of dynamic programming, the policy `lqr`.

`python -m baselines.tuning lqr` designs it.

The cycle is one period of `dp-nominal` on the nominal plant, closed by small corrections of its
torques. Along it the step of the environment is linearised, and the periodic Riccati equation gives
a gain for every phase:

    u = u_d(phase) - K(phase) (z - z_d(phase)),    z = (theta, theta_dot, x_dot).

The phase is that of the nearest state of the cycle, since a phase that depends on the time would
accelerate a slow platform instead of waiting for it.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from baselines.dynamic_programming.policy import TORQUES, Lookahead
from baselines.dynamic_programming.problem import (
    ACTIONS,
    NOMINAL_MARGIN,
    Problem,
    Transitions,
    run_episodes,
)
from capsule_gym.policies.scripted import Act
from capsule_gym.tasks.task import EPISODE_STEPS, START_THETA, TORQUE_LIMIT

FILE = Path(__file__).with_name("lqr.json")
# Acceptable deviations of theta (rad), theta_dot (rad/s) and x_dot (m/s), and of the torque (N m):
# the weights of the cost are the inverse squares (Bryson's rule).
DEVIATIONS = np.array([0.2, 2.0, 0.05])
TORQUE_DEVIATIONS = (0.05, 0.1, 0.2)
# Differences of the states and of the torque for the derivatives.
DIFFERENCES = np.array([1e-4, 1e-3, 1e-4, 1e-3])
# Scales of states in the distance to the cycle and of corrections that close it, and that of the
# torques, N m.
SCALES = np.array([0.3, 3.0, 0.15])
TORQUE_SCALE = 0.3
# Of the Newton steps; CLOSED is the largest gap of a closed cycle, over SCALES.
ITERATIONS = 60
DAMPING = 0.7
CLOSED = 1e-6
# Cycles until the solution of the Riccati equation is periodic.
RICCATI_CYCLES = 60
# Phases in a control interval, between which cycle and gains are interpolated, and the largest
# difference, in phases, between the phase and that expected from the previous step.
SUBPHASES = 8
WINDOW = 12


def linearise(
    transitions: Transitions, state: np.ndarray, torques: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Simulates a sequence of torques in N m and linearises every step.

    Args:
        transitions: nine states of the nominal plant.
        state: theta (rad), theta_dot (rad/s), x_dot (m/s).
        torques: shape (n,).

    Returns:
        The states, shape (n + 1, 3); the distance, cm; and the derivatives of the next state with
        respect to the state, shape (n, 3, 3), and to the torque, shape (n, 3).
    """
    differences = np.diag(DIFFERENCES)
    centre = np.zeros((4, 1))
    offsets = np.concatenate([centre, differences, -differences], axis=1)
    states = [state]
    distance = 0.0
    derivatives = np.empty((len(torques), 3, 4))
    for n, torque in enumerate(torques):
        point = np.append(states[-1], torque)
        points = point[:, None] + offsets
        ends, rewards, _ = transitions.step(points[:3], points[3] / TORQUE_LIMIT)
        states.append(ends[:, 0])
        distance += rewards[0]
        _, forwards, backwards = np.split(ends, [1, 5], axis=1)
        derivatives[n] = (forwards - backwards) / (2.0 * DIFFERENCES)
    A = derivatives[..., :3]
    B = derivatives[..., 3]
    return np.array(states), distance, A, B


def close_cycle(
    transitions: Transitions, state: np.ndarray, torques: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Closes a cycle by Newton steps: the smallest corrections of its first state and its torques.

    Returns:
        The distance, cm, or minus infinity if the steps do not converge; the first state; and the
        torques, N m.
    """
    for _ in range(ITERATIONS):
        states, distance, A, B = linearise(transitions, state, torques)
        gap = states[-1] - states[0]
        if (np.abs(gap) < CLOSED * SCALES).all():
            return distance, state, torques
        # The derivatives of the last state with respect to the first one and to every torque.
        by_state = np.eye(3)
        by_torque = np.empty((3, len(torques)))
        for n in reversed(range(len(torques))):
            by_torque[:, n] = by_state @ B[n]
            by_state = by_state @ A[n]
        changes = [(by_state - np.eye(3)) * SCALES, by_torque * TORQUE_SCALE]
        matrix = np.concatenate(changes, axis=1)
        solution, *_ = np.linalg.lstsq(matrix, -gap, rcond=1e-6)
        correction = DAMPING * solution
        state = state + SCALES * correction[:3]
        corrected = torques + TORQUE_SCALE * correction[3:]
        torques = np.clip(corrected, -TORQUE_LIMIT, TORQUE_LIMIT)
    return -np.inf, state, torques


def riccati_gains(A: np.ndarray, B: np.ndarray, torque_deviation: float) -> np.ndarray:
    """The gains of the periodic linear-quadratic regulator, shape (n, 3): u = u_d - K (z - z_d)."""
    Q = np.diag(DEVIATIONS**-2.0)
    R = torque_deviation**-2.0
    P = Q
    K = np.empty_like(B)
    for _ in range(RICCATI_CYCLES):
        for n in reversed(range(len(B))):
            cost = B[n] @ P
            K[n] = cost @ A[n] / (R + cost @ B[n])
            closed = A[n] - np.outer(B[n], K[n])
            P = Q + A[n].T @ P @ closed
    return K


def candidates() -> Iterator[dict[str, list]]:
    """Designs regulators for the fastest closed cycle of `dp-nominal` of each length.

    Yields:
        The content of `lqr.json` with each of `TORQUE_DEVIATIONS`: states, torques (N m) and gains
        at every step of the cycle.
    """
    transitions = Transitions(Problem(margin=NOMINAL_MARGIN), 9)
    for state, torques in _fastest_cycles(transitions):
        states, _, A, B = linearise(transitions, state, torques)
        for deviation in TORQUE_DEVIATIONS:
            gains = riccati_gains(A, B, deviation)
            yield {
                "states": states[:-1].tolist(),
                "torques": torques.tolist(),
                "gains": gains.tolist(),
            }


def _fastest_cycles(transitions: Transitions) -> list[tuple[np.ndarray, np.ndarray]]:
    """First state and torques (N m) of the fastest closed cycle of `dp-nominal` of each length."""
    problem = Problem(margin=NOMINAL_MARGIN)
    lookahead = Lookahead(1, NOMINAL_MARGIN, problem)
    stride = (len(ACTIONS) - 1) // (len(TORQUES) - 1)

    def choose(step: int, states: np.ndarray) -> np.ndarray:
        observations = states[[0, 1, 3]].T.astype(np.float32)
        return stride * lookahead.scores(observations).argmax(axis=1)

    trajectory = run_episodes(problem, np.array([START_THETA]), EPISODE_STEPS, choose)
    starts = trajectory.cycle_starts(problem.control_dt)
    distances: dict[int, float] = {}
    fastest = {}
    for first, last in pairwise(starts.tolist()):
        torques = TORQUE_LIMIT * ACTIONS[trajectory.choices[first:last, 0]]
        state = trajectory.states[first, [0, 1, 3], 0]
        distance, state, torques = close_cycle(transitions, state, torques)
        length = last - first
        if distance > distances.get(length, -np.inf):
            distances[length] = distance
            fastest[length] = (state, torques)
    return list(fastest.values())


def interpolate(content: Mapping[str, Any]) -> np.ndarray:
    """States (3), torque and gains (3) at all phases of a regulator of `candidates`.

    Shape (7, phases).
    """
    nodes = np.column_stack([content["states"], content["torques"], content["gains"]]).T
    share = np.tile(np.arange(SUBPHASES) / SUBPHASES, nodes.shape[1])
    here = np.repeat(nodes, SUBPHASES, axis=1)
    following = np.roll(here, -SUBPHASES, axis=1)
    return here + share * (following - here)


def start(seeds: Sequence[int], regulator: np.ndarray | None = None) -> Act:
    """The policy `lqr`, with a regulator of `interpolate` or that of `lqr.json`."""
    if regulator is None:
        regulator = interpolate(json.loads(FILE.read_text(encoding="utf-8")))
    z_d, u_d, K = np.split(regulator, [3, 4])
    phases = z_d.shape[1]
    phase = np.zeros((len(seeds), 1), np.int64)
    # At the first step any phase; then those around the phase that follows the previous one by a
    # control interval.
    offsets = np.arange(phases)

    def act(observations: np.ndarray) -> np.ndarray:
        nonlocal phase, offsets
        z = observations[:, :3].T.astype(np.float64)
        near = (phase + offsets) % phases
        a, b, c = (z[..., None] - z_d[:, near]) / SCALES[:, None, None]
        distances = a * a + b * b + c * c
        nearest = distances.argmin(axis=1)
        phase = np.take_along_axis(near, nearest[:, None], axis=1)
        offsets = SUBPHASES + np.arange(-WINDOW, WINDOW + 1)
        i = phase[:, 0]
        a, b, c = K[:, i] * (z - z_d[:, i])
        torque = u_d[0, i] - (a + b + c)
        action = np.clip(torque / TORQUE_LIMIT, -1.0, 1.0)
        return action.astype(np.float32)[:, None]

    return act
