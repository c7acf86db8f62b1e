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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from baselines.tables import markdown_table, text_table
from benchmarks.machine import machine
from benchmarks.output import Output, check_at_least_one
from benchmarks.timing import Progress
from capsule_gym import task
from capsule_gym.command_line import Count, parse
from capsule_gym.parameters import Capsule

if TYPE_CHECKING:
    from benchmarks import reference

COMMAND = "python -m benchmarks.accuracy"
START = (task.START_THETA, 0.0, 0.0, 0.0)
HOLD = task.CONTROL_DT
SECONDS = 10.0
FRICTION = (0.01, 0.1, 0.3)
AMPLITUDES = (0.2, 0.5, 1.0, 1.5)
STEPS_MS = (0.5, 1.0, 2.0, 4.0, 5.0, 10.0)
TRAJECTORIES = 16


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """The integration error of the plant's step at several step sizes, against an independent reference.

    Examples:
      python -m benchmarks.accuracy --markdown docs/error_table.md
    """

    trajectories: Count = TRAJECTORIES
    """Trajectories of random torque for each friction coefficient and amplitude."""

    def check(self) -> None:
        """Refuses what cannot be measured or written."""
        super().check()
        check_at_least_one("--trajectories", self.trajectories)


def valid_holds(expected: reference.Trajectory) -> int:
    """How many holds the trajectory lasts before the ball meets the platform or contact is lost."""
    ended = (np.abs(expected.states[:, 0]) >= task.THETA_LIMIT) | (expected.normal <= 0.0)
    return int(np.argmax(ended)) - 1 if ended.any() else len(ended) - 1


class Expected(NamedTuple):
    """One trajectory of the reference.

    Attributes:
        torques: of every hold, N m, also after the last valid one.
        holds: how many of them the trajectory lasts.
        state: theta, theta_dot, x, x_dot after these.
    """

    torques: np.ndarray
    holds: int
    state: np.ndarray


def expected_trajectories(mu: float, amplitude: float, trajectories: int) -> list[Expected]:
    """Solves as many trajectories with the reference; the first of more are the same."""
    # scipy's solvers take a second to import, which --help need not wait for.
    from benchmarks import reference

    solved = []
    for seed in range(trajectories):
        torques = np.random.default_rng(seed).uniform(-amplitude, amplitude, round(SECONDS / HOLD))
        trajectory = reference.simulate(torques, START, reference.Constants(mu=mu))
        last = valid_holds(trajectory)
        solved.append(Expected(torques, last, trajectory.states[last]))
    return solved


def errors(mu: float, solved: list[Expected]) -> np.ndarray:
    """Errors of every trajectory (rows) at every step size."""
    from benchmarks import driver

    plant = Capsule(mu=mu).plant()
    table = np.empty((len(solved), len(STEPS_MS)))
    for row, expected in enumerate(solved):
        for column, milliseconds in enumerate(STEPS_MS):
            steps = round(1000.0 * HOLD / milliseconds)
            run = driver.run(expected.torques[: expected.holds], START, plant, HOLD, steps)
            table[row, column] = np.abs(run.states[-1] - expected.state).max()
    return table


@dataclass(frozen=True)
class Case:
    """The errors of one friction coefficient and amplitude.

    Attributes:
        mu: friction coefficient.
        amplitude: of the torque, N m.
        length: median length of the trajectories, s.
        errors: a row per trajectory, a column per step size.
    """

    mu: float
    amplitude: float
    length: float
    errors: np.ndarray


def rows(cases: Sequence[Case]) -> list[list[str]]:
    """The table: largest (median) error per step size."""
    table = [["mu", "torque, N m", *(f"{milliseconds:g} ms" for milliseconds in STEPS_MS), "length"]]
    for case in cases:
        cells = [f"{column.max():.1e} ({np.median(column):.1e})" for column in case.errors.T]
        table.append([f"{case.mu:g}", f"±{case.amplitude:g}", *cells, f"{case.length:.1f} s"])
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    found, cases = machine(), []
    progress = Progress("errors", len(FRICTION) * len(AMPLITUDES))
    for mu in FRICTION:
        for amplitude in AMPLITUDES:
            solved = expected_trajectories(mu, amplitude, options.trajectories)
            length = float(np.median([HOLD * expected.holds for expected in solved]))
            cases.append(Case(mu, amplitude, length, errors(mu, solved)))
            progress.step(f"mu = {mu:g}, ±{amplitude:g} N m")
    note = (
        f"Largest (in brackets: median) error in any state after {SECONDS:g} s of random torque held for "
        f"{1e3 * HOLD:g} ms, {options.trajectories} trajectories a row, against DOP853 at a relative tolerance of "
        "1e-12. Trajectories in which the ball meets the platform or contact is lost are compared at the last torque "
        "change before that; the last column is the median length."
    )
    print(note, text_table(rows(cases)), sep="\n\n")
    entries = [
        {"mu": case.mu, "amplitude": case.amplitude, "length": case.length, "errors": case.errors.tolist()}
        for case in cases
    ]
    numbers = {"machine": found, "steps_ms": STEPS_MS, "cases": entries}
    options.write(COMMAND, numbers, [note, "", markdown_table(rows(cases))])
    return 0


if __name__ == "__main__":
    sys.exit(main())
