"""Error of the plant's step against an independent reference of eighth order: `python -m benchmarks.accuracy`.

Each trajectory starts at theta = -pi/3 at rest and is driven for ten seconds by a random torque, uniform within the
amplitude, held for 20 ms. A trajectory in which the ball meets the platform (|theta| >= pi/2) or contact is lost ends
at the last torque change before that, as an episode of the environment would. The error is the largest deviation of
theta (rad), theta' (rad/s), x (m) or x' (m/s) from the reference at the end of the trajectory.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from baselines.tables import markdown_table, text_table
from benchmarks.measurement import OutputArgs
from capsule_gym import task
from capsule_gym.command_line import parse
from capsule_gym.parameters import Capsule

COMMAND = "python -m benchmarks.accuracy"
START = (task.START_THETA, 0.0, 0.0, 0.0)
SECONDS = 10.0
FRICTION = (0.01, 0.1, 0.3)
AMPLITUDES = (0.2, 0.5, 1.0, 1.5)
# For each friction coefficient and amplitude.
TRAJECTORIES = 16
STEPS = (0.0005, 0.001, 0.002, 0.004, 0.005, 0.01)


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """The integration error of the plant's step at several step sizes, against an independent reference.

    Examples:
      python -m benchmarks.accuracy --markdown docs/error_table.md
    """


class Expected(NamedTuple):
    """One trajectory of the reference.

    Attributes:
        torques: of every control interval, N m, also after the last valid one.
        intervals: number of intervals until the ball meets the platform or contact is lost.
        state: theta, theta_dot, x, x_dot at the end of these.
    """

    torques: np.ndarray
    intervals: int
    state: np.ndarray


def expected_trajectories(mu: float, amplitude: float) -> list[Expected]:
    """Trajectories of the reference; each is seeded by its index."""
    # scipy's solvers take a second to import, which --help need not wait for.
    from benchmarks import reference

    solved = []
    for seed in range(TRAJECTORIES):
        torques = np.random.default_rng(seed).uniform(-amplitude, amplitude, round(SECONDS / task.CONTROL_DT))
        found = reference.simulate(torques, START, Capsule(mu=mu).plant())
        ended = (np.abs(found.states[:, 0]) >= task.THETA_LIMIT) | (found.normal <= 0.0)
        last = int(np.argmax(ended)) - 1 if ended.any() else len(torques)
        solved.append(Expected(torques, last, found.states[last]))
    return solved


def errors(mu: float, solved: Sequence[Expected], steps: Sequence[float]) -> np.ndarray:
    """The error of every trajectory (rows) at every step size in seconds (columns)."""
    from benchmarks import reference

    plant, hold = Capsule(mu=mu).plant(), task.CONTROL_DT
    found = [
        [
            reference.run(each.torques[: each.intervals], START, plant, hold, round(hold / step)).states[-1]
            for step in steps
        ]
        for each in solved
    ]
    return np.abs(np.array(found) - np.array([each.state for each in solved])[:, None]).max(axis=2)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    table = [["mu", "torque, N m", *(f"{1e3 * step:g} ms" for step in STEPS), "length"]]
    for mu, amplitude in tqdm(list(product(FRICTION, AMPLITUDES)), desc="errors"):
        solved = expected_trajectories(mu, amplitude)
        deviations = errors(mu, solved, STEPS)
        length = float(np.median([task.CONTROL_DT * each.intervals for each in solved]))
        cells = [f"{column.max():.1e} ({np.median(column):.1e})" for column in deviations.T]
        table.append([f"{mu:g}", f"±{amplitude:g}", *cells, f"{length:.1f} s"])
    note = (
        f"Largest (in brackets: median) error in any state after {SECONDS:g} s of random torque held for "
        f"{1e3 * task.CONTROL_DT:g} ms, {TRAJECTORIES} trajectories a row, against DOP853 at a relative tolerance "
        "of 1e-12. Trajectories in which the ball meets the platform or contact is lost are compared at the last "
        "torque change before that; the last column is the median length."
    )
    print(note, text_table(table), sep="\n\n")
    args.write(COMMAND, note, markdown_table(table))
    return 0


if __name__ == "__main__":
    sys.exit(main())
