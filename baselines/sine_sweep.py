"""Mean speed of the nominal plant under a sine torque, over frequency and amplitude: `python -m baselines.sine_sweep`.

The torque has no bias and is constant over a control interval. Every environment starts at rest at the default angle;
its speed is that over whole periods after the transient.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from baselines.drawing import add_note, new_figure, save, style
from capsule_gym import CapsuleVectorEnv
from capsule_gym.command_line import parse
from capsule_gym.elementary import sincos
from capsule_gym.layout import Row
from capsule_gym.parameters import NOMINAL
from capsule_gym.task import CONTROL_DT, TORQUE_LIMIT

# Periods in control intervals, and amplitudes, N m.
PERIODS = np.arange(17, 168, 2)
AMPLITUDES = np.linspace(0.02, TORQUE_LIMIT, 64)
# s, after which the motion is periodic; and the number of periods of the means.
TRANSIENT, MEASURED = 40.0, 8
# rad: a mean angle beyond it is in the left or right well of spring and gravity.
WELL = 0.3


class Sweep(NamedTuple):
    """Mean speeds (cm/s) and angles (rad), shape (amplitudes, periods); NaN where the pendulum falls."""

    speed: np.ndarray
    theta: np.ndarray


def sweep(periods: np.ndarray = PERIODS, amplitudes: np.ndarray = AMPLITUDES) -> Sweep:
    """Simulates all pairs of period, in control intervals, and amplitude, N m, in one batch."""
    amplitude, period = (each.ravel() for each in np.meshgrid(amplitudes, periods, indexing="ij"))
    begin = np.ceil(TRANSIENT / CONTROL_DT / period).astype(np.int64) * period
    end = begin + MEASURED * period
    steps = int(end.max())
    env = CapsuleVectorEnv(
        len(period), randomization="none", initial_noise=0.0, max_episode_steps=steps + 1, autoreset_mode="DISABLED"
    )
    env.reset(seed=0)
    moved, theta, failed = (np.zeros(len(period)) for _ in range(3))
    for step in range(steps):
        angle, x = env.simulation.rows(Row.theta, Row.x + 1)[[0, Row.x - Row.theta]]
        moved -= np.where(step == begin, x, 0.0)
        theta += np.where((step >= begin) & (step < end), angle, 0.0)
        sine, _ = sincos(2.0 * np.pi * (step % period) / period)
        actions = (amplitude / TORQUE_LIMIT * sine).astype(np.float32)
        _, _, terminated, _, _ = env.step(actions[:, None])
        moved += np.where(step + 1 == end, env.simulation.row(Row.x), 0.0)
        failed = np.where((step < end) & terminated, 1.0, failed)
    env.close()
    speed, theta = 100.0 * moved / (MEASURED * period * CONTROL_DT), theta / (MEASURED * period)
    shape = len(amplitudes), len(periods)
    return Sweep(*(np.where(failed, np.nan, each).reshape(shape) for each in (speed, theta)))


def describe(found: Sweep) -> list[str]:
    """One line for each well: its share of the completed runs and the range of its speeds."""
    completed = np.isfinite(found.speed)
    left, right = found.theta < -WELL, found.theta > WELL
    lines = []
    for name, inside in (("left well", left), ("right well", right), ("across both", completed & ~left & ~right)):
        if not inside.any():
            continue
        speed, share = found.speed[inside], inside.sum() / completed.sum()
        lines.append(f"{name}: {share:.0%} of the completed runs, {speed.min():.2f} to {speed.max():.2f} cm/s")
    return lines


def draw(found: Sweep, periods: np.ndarray = PERIODS, amplitudes: np.ndarray = AMPLITUDES) -> Any:
    """Draws the figure; to be called within `baselines.drawing.style`."""
    figure = new_figure(3.1)
    panels = figure.subplots(1, 2, sharey=True)
    largest = np.nanmax(np.abs(found.speed))
    scales = (("RdBu", largest, "mean speed (cm/s)"), ("PuOr", 1.0, "mean angle of the pendulum (rad)"))
    for axes, values, (colours, limit, title) in zip(panels, found, scales, strict=True):
        axes.set_facecolor("0.75")
        axes.grid(False)
        mesh = axes.pcolormesh(
            1.0 / (periods * CONTROL_DT), amplitudes, values, cmap=colours, vmin=-limit, vmax=limit, rasterized=True
        )
        figure.colorbar(mesh, ax=axes)
        axes.set(xlabel="frequency (Hz)", title=title)
    panels[0].set_ylabel("amplitude of the torque (N m)")
    add_note(
        figure,
        f"A sine torque without bias on the nominal plant (M = {NOMINAL.M:g} kg, μ = {NOMINAL.mu:g}), from rest at "
        f"-60 degrees; means over {MEASURED} periods after {TRANSIENT:g} s. Grey: the pendulum falls to 90 degrees.",
    )
    return figure


@dataclass(frozen=True)
class Args:
    """Prints the mean speeds under a sine torque in each well, and draws them over frequency and amplitude.

    Examples:
      python -m baselines.sine_sweep --figure docs/figures/sine_torque
    """

    figure: Path | None = None
    """Write the figure to this name, with the endings .svg and .png (needs matplotlib)."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, "python -m baselines.sine_sweep", arguments)
    found = sweep()
    print(*describe(found), sep="\n")
    best = np.unravel_index(np.nanargmax(found.speed), found.speed.shape)
    print(f"fastest: {AMPLITUDES[best[0]]:.2f} N m at {1.0 / (PERIODS[best[1]] * CONTROL_DT):.2f} Hz")
    if args.figure is not None:
        with style():
            save(draw(found), args.figure)
    return 0


if __name__ == "__main__":
    sys.exit(main())
