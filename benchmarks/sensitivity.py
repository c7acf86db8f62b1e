"""Accuracy and cost of `capsule_gym.sensitivity`: `python -m benchmarks.sensitivity`."""

import timeit
from dataclasses import replace
from functools import partial

import numpy as np

from capsule_gym import Capsule, sensitivity
from capsule_gym.command_line import PositiveCount, command
from capsule_gym.identification.derivatives import constant_inputs, simulate

NAMES = ("torque", "M", "mu", "k", "c")
START, INTERVALS, PERIODS = (0.1, 0.0, 0.0, 0.0), 200, {"control_dt": 0.01, "physics_dt": 1e-3}
# Relative steps of the differences: the estimate that changes least from one to the next is kept.
# Relative to smaller derivatives by the logarithm of a constant than SMALLEST, m, differences are
# only rounding errors.
STEPS, SMALLEST = 10.0 ** np.arange(-3.0, -7.1, -0.5), 1e-5


def draw(generator: np.random.Generator) -> tuple[Capsule, np.ndarray]:
    """A plant of which the platform sticks and slips, and a multisine of 2 to 8 Hz."""
    uniform = generator.uniform
    constants = {"M": uniform(0.35, 0.75), "mu": 0.02 * 15.0 ** uniform(), "static_ratio": 1.2}
    capsule = Capsule(**constants, k=0.36 * uniform(0.9, 1.1), c=0.0923 * uniform(0.9, 1.1))
    amplitude, frequency, phase = (
        uniform(0.3, 0.7, 4),
        uniform(2.0, 8.0, 4),
        uniform(0.0, 2.0 * np.pi, 4),
    )
    t = 0.01 * np.arange(INTERVALS)
    return capsule, np.sin(2.0 * np.pi * np.outer(t, frequency) + phase) @ amplitude


def extrapolated(capsule: Capsule, torques: np.ndarray, name: str) -> float:
    """The derivative of x(2 s) by the logarithm of a constant, by extrapolated central
    differences.
    """

    def end(h: float) -> float:
        scaled = {} if name == "torque" else {name: (1.0 + h) * getattr(capsule, name)}
        own = torques if scaled else (1.0 + h) * torques
        return sensitivity(START, own, (), capsule=replace(capsule, **scaled), **PERIODS).states[
            -1, 2
        ]

    up, down, far_up, far_down = np.vectorize(end)(np.outer((1.0, -1.0, 2.0, -2.0), STEPS))
    estimates = (8.0 * (up - down) - (far_up - far_down)) / (12.0 * STEPS)
    return estimates[1 + int(np.argmin(np.abs(np.diff(estimates))))]


def errors(count: int, seed: int) -> tuple[np.ndarray, float]:
    """Relative errors of the derivatives, shape (trajectories, names), and the mean number of
    events.
    """
    generator, rows, events = np.random.default_rng(seed), list[np.ndarray](), list[int]()
    while len(rows) < count:
        capsule, torques = draw(generator)
        try:
            exact = sensitivity(START, torques, NAMES, capsule=capsule, **PERIODS)
            expected = np.array([extrapolated(capsule, torques, name) for name in NAMES])
        except ValueError:  # the episode would terminate
            continue
        slopes = [exact.derivatives[name][-1, 2] * getattr(capsule, name, 1.0) for name in NAMES]
        rows.append(np.abs(slopes - expected) / np.maximum(np.abs(expected), SMALLEST))
        events.append(exact.events[-1])
    return np.array(rows), float(np.mean(events))


@command("python -m benchmarks.sensitivity")
def main(trajectories: PositiveCount = 300) -> None:
    """Compares derivatives of x(2 s) with extrapolated differences, and their cost with that of a
    trajectory.

    Examples:
      python -m benchmarks.sensitivity --trajectories 300

    Args:
        trajectories: Number of random plants and torques.
    """
    found, events = errors(trajectories, seed=1)
    print(
        f"{trajectories} trajectories with {events:.0f} events on average, derivatives by {', '.join(NAMES)}"
    )
    print(f"relative error: median {np.median(found):.1e}, largest {found.max():.1e}")
    torques = draw(np.random.default_rng(1))[1] / 2.0
    inputs = np.concatenate([constant_inputs(Capsule()), START, torques])
    identity = np.eye(len(inputs))
    programs = [
        partial(simulate, inputs, identity[:, :count], 10, PERIODS["physics_dt"])
        for count in (0, 8)
    ]
    alone, differentiated = (
        min(timeit.repeat(program, number=1, repeat=200)) for program in programs
    )
    print(f"8 derivatives take {differentiated / alone:.1f} times the time of the trajectory")


if __name__ == "__main__":
    main()
