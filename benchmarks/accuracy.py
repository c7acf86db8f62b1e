"""Error of the plant's step against an independent reference of eighth order: `python -m benchmarks.accuracy`.

Each trajectory starts at theta = -pi/3 at rest. A random torque drives it for ten seconds; the torque is uniform within
the amplitude and held for 20 ms. If the ball meets the platform (|theta| >= pi/2) or contact is lost, the trajectory
ends at the last torque change before this event. The error is the largest deviation of theta (rad), theta' (rad/s),
x (m) or x' (m/s) from the reference at the end of the trajectory. Where MuJoCo is installed, a second table contains
the same capsule in MuJoCo: the speed at which a loaded platform creeps, and the error of x alone.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from benchmarks import mujoco
from benchmarks.measurement import OutputArgs, machine
from capsule_gym import sensitivity, task
from capsule_gym.command_line import parse
from capsule_gym.parameters import Capsule

COMMAND = "python -m benchmarks.accuracy"
START = (task.START_THETA, 0.0, 0.0, 0.0)
SECONDS = 10.0
FRICTION = (0.01, 0.1, 0.3)
AMPLITUDES = (0.2, 0.5, 1.0, 1.5)
# Number of trajectories for each friction coefficient and amplitude.
TRAJECTORIES = 16
# Number of plants that differ in every constant, each with its own trajectory, and the amplitude of the torque, N m.
PLANTS, AMPLITUDE = 40, 0.7
RANGES = {
    **{"M": (0.3, 1.0), "m": (0.1, 0.2), "l": (0.2, 0.4), "k": (0.2, 0.6), "c": (0.05, 0.15), "mu": (0.01, 0.5)},
    **{"static_ratio": (1.0, 1.5), "backward_ratio": (0.5, 2.0), "viscous": (0.0, 0.5), "stribeck_speed": (0.05, 0.5)},
    **{"slope": (-0.05, 0.05), "motor_friction": (0.0, 0.1)},
}
# Friction coefficients and amplitudes that are compared with MuJoCo, its steps (s), and the share of the friction limit
# that loads the platform at rest.
MUJOCO_CASES = ((0.01, 0.5), (0.1, 1.0))
MUJOCO_STEPS = (0.002, 0.0005)
LOAD = 0.5
STEPS = (0.00025, 0.0005, 0.001, 0.002, 0.005, 0.01)


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """The integration error of the plant's step at several step sizes, against an independent reference.

    Examples:
      python -m benchmarks.accuracy --markdown docs/error_table.md
    """


class Expected(NamedTuple):
    """One trajectory of the reference.

    Attributes:
        capsule: the plant.
        torques: torque in every control interval, N m, also after the last valid interval.
        intervals: number of valid intervals, before the ball meets the platform or contact is lost.
        state: theta, theta_dot, x, x_dot at the end of the valid intervals.
    """

    capsule: Capsule
    torques: np.ndarray
    intervals: int
    state: np.ndarray


def random_capsule(seed: int) -> Capsule:
    """A random plant with a slope, a Stribeck curve, and all kinds of friction."""
    rng = np.random.default_rng(seed)
    constants: dict[str, Any] = {name: rng.uniform(*limits) for name, limits in RANGES.items()}
    return Capsule(**constants)


def expected_trajectories(capsules: Sequence[Capsule], amplitude: float) -> list[Expected]:
    """Computes a trajectory of the reference for each plant; the index of the plant is the seed of its torque."""
    # Imported here, since scipy's solvers take a second to import and --help does not need them.
    from benchmarks import reference

    solved = []
    for seed, capsule in enumerate(capsules):
        torques = np.random.default_rng(seed).uniform(-amplitude, amplitude, round(SECONDS / task.CONTROL_DT))
        found = reference.simulate(torques, START, capsule.plant())
        ended = (np.abs(found.states[:, 0]) >= task.THETA_LIMIT) | (found.normal <= 0.0)
        last = int(np.argmax(ended)) - 1 if ended.any() else len(torques)
        solved.append(Expected(capsule, torques, last, found.states[last]))
    return solved


def run(torques: np.ndarray, capsule: Capsule, step: float) -> np.ndarray:
    """The states at the end of control intervals with torques in N m: theta, theta_dot, x, x_dot, shape (n, 4)."""
    return sensitivity(START, torques, (), capsule=capsule, control_dt=task.CONTROL_DT, physics_dt=step).states[1:]


def deviations(solved: Sequence[Expected], step: float, friction: str = "") -> np.ndarray:
    """Deviations of theta, theta_dot, x and x_dot at the ends, shape (trajectories, 4); MuJoCo's with a friction."""
    found = []
    for capsule, torques, intervals, state in solved:
        if friction:
            states = mujoco.simulate(mujoco.build_model(friction, step, capsule), torques[:intervals])
        else:
            states = run(torques[:intervals], capsule, step)
        found.append(np.abs(states[-1] - state))
    return np.array(found)


def cell(values: np.ndarray) -> str:
    """The largest and the median value."""
    return f"{values.max():.1e} ({np.median(values):.1e})"


def compare_mujoco() -> list[list[str]]:
    """The table of the comparison with MuJoCo."""
    table, cases = [["", f"hold at {LOAD:.0%}, m/s"]], []
    for mu, amplitude in MUJOCO_CASES:
        solved = expected_trajectories([Capsule(mu=mu)] * TRAJECTORIES, amplitude)
        for step in MUJOCO_STEPS:
            cases.append((solved, step))
            table[0].append(f"error of x, mm: μ = {mu:g}, ±{amplitude:g} N m, {1e3 * step:g} ms")
    capsule = Capsule(mu=MUJOCO_CASES[-1][0])
    load = LOAD * capsule.mu * (capsule.M + capsule.m) * capsule.g
    for friction in tqdm(("", *mujoco.FRICTIONS), desc="MuJoCo"):
        if friction:
            speed = mujoco.creep(mujoco.build_model(friction, MUJOCO_STEPS[0], capsule), load)
        else:
            # A floor that slopes by the same load.
            sloped = Capsule(mu=capsule.mu, slope=-math.atan(LOAD * capsule.mu))
            speed = abs(run(np.zeros(500), sloped, MUJOCO_STEPS[0])[-1, 3])
        cells = [cell(1e3 * deviations(*case, friction)[:, 2]) for case in cases]
        table.append([f"MuJoCo, {friction}" if friction else "capsule_gym", f"{speed:.0e}" if speed else "0", *cells])
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    table = [["plant", "torque, N m", *(f"{1e3 * step:g} ms" for step in STEPS), "length"]]
    kinds = [(f"μ = {mu:g}", [Capsule(mu=mu)] * TRAJECTORIES, a) for mu in FRICTION for a in AMPLITUDES]
    kinds.append((f"{PLANTS} random", [random_capsule(seed) for seed in range(PLANTS)], AMPLITUDE))
    for kind, capsules, amplitude in tqdm(kinds, desc="errors"):
        solved = expected_trajectories(capsules, amplitude)
        length = float(np.median([task.CONTROL_DT * each.intervals for each in solved]))
        cells = [cell(deviations(solved, step).max(axis=1)) for step in STEPS]
        table.append([kind, f"±{amplitude:g}", *cells, f"{length:.1f} s"])
    note = (
        f"Largest (in brackets: median) error in any state after {SECONDS:g} s of random torque held for "
        f"{1e3 * task.CONTROL_DT:g} ms, {TRAJECTORIES} trajectories of the paper's plant per row, against DOP853 at a "
        "relative tolerance of 2e-13. Trajectories in which the ball meets the platform or contact is lost are "
        "compared at the last torque change before that; the last column is the median length. The random plants "
        "differ in every constant, with a slope, viscous friction, Stribeck's curve, and friction of the motor."
    )
    compared = (
        "The same capsule in MuJoCo, with the settings that it documents against slip. Hold: the speed of a platform "
        f"that {LOAD:.0%} of the friction limit loads, at a step of {1e3 * MUJOCO_STEPS[0]:g} ms and "
        f"μ = {MUJOCO_CASES[-1][0]:g}; exactly 0 in stick. Errors of x as above: largest (in brackets: median). "
        f"frictionloss: friction of the joint, without a contact; contact: an elliptic cone with default settings; "
        f"impratio: {mujoco.IMPRATIO:g}; no-slip: {mujoco.NO_SLIP_ITERATIONS} iterations; stiff: the hardest contact "
        "that it accepts; discrete: the integrator discrete, elsewhere implicitfast."
    )
    further = [compared, compare_mujoco()] if find_spec("mujoco") else []
    args.report(COMMAND, note, table, *further, f"{machine()}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
