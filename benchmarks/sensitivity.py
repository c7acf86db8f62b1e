"""Accuracy and cost of `capsule_gym.sensitivity`: `python -m benchmarks.sensitivity`."""

import timeit
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from capsule_gym import Capsule, sensitivity
from capsule_gym.command_line import PositiveCount, command
from capsule_gym.identification.derivatives import simulate, trajectory_inputs

NAMES = ("torque", "M", "mu", "k", "c")
START = (0.1, 0.0, 0.0, 0.0)
INTERVALS = 200
PERIODS = {"control_dt": 0.01, "physics_dt": 1e-3}
# Relative steps of the differences: the estimate that changes least from one to the next is kept.
STEPS = 10.0 ** np.arange(-3.0, -7.1, -0.5)
# Relative to smaller derivatives by the logarithm of a constant, m, differences are only rounding
# errors.
SMALLEST = 1e-5


def draw(generator: np.random.Generator) -> tuple[Capsule, np.ndarray]:
    """A plant of which the platform sticks and slips, and a multisine of 2 to 8 Hz."""
    uniform = generator.uniform
    capsule = Capsule(
        M=uniform(0.35, 0.75),
        mu=0.02 * 15.0 ** uniform(),
        static_ratio=1.2,
        k=0.36 * uniform(0.9, 1.1),
        c=0.0923 * uniform(0.9, 1.1),
    )
    amplitudes = uniform(0.3, 0.7, 4)
    frequencies = uniform(2.0, 8.0, 4)
    phases = uniform(0.0, 2.0 * np.pi, 4)
    t = PERIODS["control_dt"] * np.arange(INTERVALS)
    angles = 2.0 * np.pi * np.outer(t, frequencies) + phases
    return capsule, np.sin(angles) @ amplitudes


def extrapolated(capsule: Capsule, torques: np.ndarray, name: str) -> float:
    """The derivative of x(2 s) by the logarithm of a constant.

    It is that of extrapolated central differences.
    """

    def end(change: float) -> float:
        plant, own = capsule, torques
        if name == "torque":
            own = (1.0 + change) * torques
        else:
            constant: dict[str, Any] = {name: (1.0 + change) * getattr(capsule, name)}
            plant = replace(capsule, **constant)
        return sensitivity(START, own, (), capsule=plant, **PERIODS).states[-1, 2]

    changes = np.outer((1.0, -1.0, 2.0, -2.0), STEPS)
    up, down, far_up, far_down = np.vectorize(end)(changes)
    estimates = (8.0 * (up - down) - (far_up - far_down)) / (12.0 * STEPS)
    changes_between = np.abs(np.diff(estimates))
    return estimates[1 + int(changes_between.argmin())]


def errors(count: int, seed: int) -> tuple[np.ndarray, float]:
    """The errors of derivatives by `NAMES` on random trajectories.

    Returns:
        Relative errors, shape (trajectories, names), and the mean number of events.
    """
    generator = np.random.default_rng(seed)
    rows: list[np.ndarray] = []
    events: list[int] = []
    while len(rows) < count:
        capsule, torques = draw(generator)
        try:
            exact = sensitivity(START, torques, NAMES, capsule=capsule, **PERIODS)
            expected = np.array([extrapolated(capsule, torques, name) for name in NAMES])
        except ValueError:  # the episode would terminate
            continue
        slopes = [exact.derivatives[name][-1, 2] * getattr(capsule, name, 1.0) for name in NAMES]
        size = np.maximum(np.abs(expected), SMALLEST)
        rows.append(np.abs(slopes - expected) / size)
        events.append(exact.events[-1])
    return np.array(rows), float(np.mean(events))


@command("python -m benchmarks.sensitivity")
def main(trajectories: PositiveCount = 300) -> None:
    """Compares derivatives of x(2 s) with extrapolated differences, and their cost.

    Examples:
      python -m benchmarks.sensitivity --trajectories 300

    Args:
        trajectories: Number of random plants and torques.
    """
    found, events = errors(trajectories, seed=1)
    names = ", ".join(NAMES)
    average = f"{events:.0f} events on average"
    print(f"{trajectories} trajectories with {average}, derivatives by {names}")
    print(f"relative error: median {np.median(found):.1e}, largest {found.max():.1e}")
    # Half of the drawn torques keep the nominal plant from terminating.
    _, torques = draw(np.random.default_rng(1))
    inputs = trajectory_inputs(Capsule(), START, torques / 2.0)
    steps_per_interval = round(PERIODS["control_dt"] / PERIODS["physics_dt"])
    identity = np.eye(len(inputs))

    def seconds(directions: int) -> float:
        partials = identity[:, :directions]
        program = partial(simulate, inputs, partials, steps_per_interval, PERIODS["physics_dt"])
        return min(timeit.repeat(program, number=1, repeat=200))

    ratio = seconds(8) / seconds(0)
    print(f"8 derivatives take {ratio:.1f} times the time of the trajectory")


if __name__ == "__main__":
    main()
