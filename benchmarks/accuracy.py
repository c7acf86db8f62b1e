"""Integration error of the plant's step against an independent reference of eighth order.

    python -m benchmarks.accuracy [--markdown FILE] [--trajectories 16]

Each trajectory starts at theta = -pi/3 at rest and is driven for ten seconds by a random torque, uniform within the
amplitude, held for 20 ms. A trajectory in which the ball meets the platform (|theta| >= pi/2) or contact is lost ends
at the last torque change before that, as an episode of the environment would. The error is the largest deviation of
theta (rad), theta' (rad/s), x (m) or x' (m/s) from the reference at the end of the trajectory.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import driver, reference
from capsule_gym.parameters import Capsule

START = (-math.pi / 3, 0.0, 0.0, 0.0)
HOLD = 0.02
SECONDS = 10.0
FRICTION = (0.01, 0.1, 0.3)
AMPLITUDES = (0.2, 0.5, 1.0, 1.5)
STEPS_MS = (0.5, 1.0, 2.0, 4.0, 5.0, 10.0)


def valid_holds(expected: reference.Trajectory) -> int:
    """How many holds the trajectory lasts before the ball meets the platform or contact is lost."""
    ended = (np.abs(expected.states[:, 0]) >= math.pi / 2) | (expected.normal <= 0.0)
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
    solved = []
    for seed in range(trajectories):
        torques = np.random.default_rng(seed).uniform(-amplitude, amplitude, round(SECONDS / HOLD))
        trajectory = reference.simulate(torques, START, reference.Constants(mu=mu))
        last = valid_holds(trajectory)
        solved.append(Expected(torques, last, trajectory.states[last]))
    return solved


def errors(mu: float, solved: list[Expected]) -> np.ndarray:
    """Errors of every trajectory (rows) at every step size."""
    plant = Capsule(mu=mu).plant()
    table = np.empty((len(solved), len(STEPS_MS)))
    for row, expected in enumerate(solved):
        for column, milliseconds in enumerate(STEPS_MS):
            steps = round(1000.0 * HOLD / milliseconds)
            run = driver.run(expected.torques[: expected.holds], START, plant, HOLD, steps)
            table[row, column] = np.abs(run.states[-1] - expected.state).max()
    return table


def markdown(results: list[tuple[float, float, np.ndarray, float]], trajectories: int) -> str:
    """The results as a table, with a line that says what they are."""
    names = [f"{milliseconds:g} ms" for milliseconds in STEPS_MS]
    lines = [
        "<!-- Written by python -m benchmarks.accuracy: do not edit. -->",
        "",
        f"Largest (in brackets: median) error in any state after {SECONDS:g} s of random torque held for 20 ms, "
        f"{trajectories} trajectories a row, against DOP853 at a relative tolerance of 1e-12. Trajectories in which "
        "the ball meets the platform or contact is lost are compared at the last torque change before that; "
        "the last column is the median length.",
        "",
        "| mu | torque, N m | " + " | ".join(names) + " | length |",
        "|---|---|" + "---|" * (len(names) + 1),
    ]
    for mu, amplitude, table, length in results:
        cells = [f"{column.max():.1e} ({np.median(column):.1e})" for column in table.T]
        lines.append(f"| {mu:g} | ±{amplitude:g} | " + " | ".join(cells) + f" | {length:.1f} s |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> None:
    """Runs the measurement, prints the table and writes it where asked.

    Args:
        arguments: the command line's; sys.argv where None.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table to this file too")
    parser.add_argument(
        "--trajectories", type=int, default=16, metavar="N", help="trajectories a row (default: %(default)s)"
    )
    options = parser.parse_args(arguments)
    if options.trajectories < 1:
        parser.error(f"--trajectories must be at least 1, got {options.trajectories}")
    results = []
    start = time.perf_counter()
    for mu in FRICTION:
        for amplitude in AMPLITUDES:
            solved = expected_trajectories(mu, amplitude, options.trajectories)
            length = float(np.median([HOLD * expected.holds for expected in solved]))
            results.append((mu, amplitude, errors(mu, solved), length))
            done, total = len(results), len(FRICTION) * len(AMPLITUDES)
            elapsed = time.perf_counter() - start
            print(f"{done}/{total}: mu = {mu:g}, +-{amplitude:g} N m, {elapsed:.0f} s", file=sys.stderr, flush=True)
    text = markdown(results, options.trajectories)
    print(text)
    if options.markdown is not None:
        options.markdown.parent.mkdir(parents=True, exist_ok=True)
        options.markdown.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
