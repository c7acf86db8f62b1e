"""Accuracy and cost of `capsule_gym.sensitivity`: `python -m benchmarks.sensitivity`."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from capsule_gym import Capsule, sensitivity
from capsule_gym._core import TRAJECTORY
from capsule_gym.command_line import Count, parse
from capsule_gym.trajectory import constant_inputs, simulate

NAMES = ("torque", "M", "mu", "k", "c")
START, CONTROL_DT, PHYSICS_DT, INTERVALS = (0.1, 0.0, 0.0, 0.0), 0.01, 1e-3, 200
# Relative steps of the differences: the estimate that changes least from one to the next is kept.
STEPS = 10.0 ** np.arange(-3.0, -7.1, -0.5)
# m, of the derivative by the logarithm of a constant: relative to smaller ones, differences are only rounding errors.
SMALLEST = 1e-5


@dataclass(frozen=True)
class Args:
    """Compares derivatives of x(2 s) with extrapolated differences, and their cost with that of a trajectory.

    Examples:
      python -m benchmarks.sensitivity --trajectories 300
    """

    trajectories: Count = 300
    """Number of random plants and torques."""
    seed: Count = 1
    """Seed of the plants and torques."""


def draw(generator: np.random.Generator) -> tuple[Capsule, np.ndarray]:
    """A plant of which the platform sticks and slips, and a multisine of 2 to 8 Hz."""
    uniform = generator.uniform
    constants = {"M": uniform(0.35, 0.75), "mu": 0.02 * 15.0 ** uniform(), "static_ratio": 1.2}
    capsule = Capsule(**constants, k=0.36 * uniform(0.9, 1.1), c=0.0923 * uniform(0.9, 1.1))
    amplitude, frequency, phase = uniform(0.3, 0.7, 4), uniform(2.0, 8.0, 4), uniform(0.0, 2.0 * np.pi, 4)
    t = CONTROL_DT * np.arange(INTERVALS)
    return capsule, np.sin(2.0 * np.pi * np.outer(t, frequency) + phase) @ amplitude


def final(capsule: Capsule, torques: np.ndarray, wrt: tuple[str, ...] = ()) -> tuple[float, np.ndarray, int]:
    """x(2 s), its derivatives, and the number of events."""
    found = sensitivity(START, torques, wrt, capsule=capsule, control_dt=CONTROL_DT, physics_dt=PHYSICS_DT)
    return found.states[-1, 2], np.array([found.derivatives[name][-1, 2] for name in wrt]), found.events[-1]


def extrapolated(capsule: Capsule, torques: np.ndarray, name: str) -> float:
    """The derivative of x(2 s) by the logarithm of a constant, by extrapolated central differences."""

    def shifted(factor: float) -> float:
        if name == "torque":
            return final(capsule, factor * torques)[0]
        return final(replace(capsule, **{name: factor * getattr(capsule, name)}), torques)[0]

    near, far = (np.array([shifted(1.0 + n * h) - shifted(1.0 - n * h) for h in STEPS]) for n in (1, 2))
    estimates = (8.0 * near - far) / (12.0 * STEPS)
    return estimates[1 + int(np.argmin(np.abs(np.diff(estimates))))]


def errors(count: int, seed: int) -> tuple[np.ndarray, float]:
    """Relative errors of the derivatives, shape (trajectories, names), and the mean number of events."""
    generator, rows, events = np.random.default_rng(seed), list[np.ndarray](), list[int]()
    while len(rows) < count:
        capsule, torques = draw(generator)
        try:
            _, slopes, number = final(capsule, torques, NAMES)
            found = np.array([extrapolated(capsule, torques, name) for name in NAMES])
        except ValueError:  # the episode would terminate
            continue
        scale = [1.0 if name == "torque" else getattr(capsule, name) for name in NAMES]
        rows.append(np.abs(slopes * scale - found) / np.maximum(np.abs(found), SMALLEST))
        events.append(number)
    return np.array(rows), float(np.mean(events))


def cost(seed: int, repetitions: int = 200) -> float:
    """The time of a trajectory with 8 derivatives over that of the trajectory alone; the smallest of many times."""
    capsule, torques = Capsule(mu=0.05, static_ratio=1.2), draw(np.random.default_rng(seed))[1] / 2.0
    inputs = np.concatenate([constant_inputs(capsule), START, torques])
    partials = np.eye(len(inputs))[:, :8]
    partials[len(TRAJECTORY) :, 0] = torques
    times = [np.inf, np.inf]
    for _ in range(repetitions):
        for n, given in enumerate((None, partials)):
            start = time.perf_counter()
            simulate(inputs, given, round(CONTROL_DT / PHYSICS_DT), PHYSICS_DT)
            times[n] = min(times[n], time.perf_counter() - start)
    return times[1] / times[0]


def main() -> None:
    """Prints the errors and the cost."""
    args = parse(Args, "python -m benchmarks.sensitivity")
    found, events = errors(args.trajectories, args.seed)
    print(f"{args.trajectories} trajectories with {events:.0f} events on average, derivatives by {', '.join(NAMES)}")
    print(f"relative error: median {np.median(found):.1e}, largest {found.max():.1e}")
    print(f"8 derivatives take {cost(args.seed):.1f} times the time of the trajectory")


if __name__ == "__main__":
    main()
