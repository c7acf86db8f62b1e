"""Reference trajectories with exact stick: `python -m benchmarks.stick_reference`.

The file `stick_reference.npz` beside this one contains 20 trajectories of 10 s by the method of
`benchmarks.accuracy`, at its tolerance. Its arrays, of which row i belongs to trajectory i:

    name      what happens
    plant     the constants, a JSON text; units and equations are those of docs/physics.md
    torque    N m, each held for 10 ms, shape (20, 1000)
    state     theta, theta_dot, x, x_dot every 10 ms, shape (20, 1001, 4)

and of every phase of contact, in the order of the trajectories and of time, `phase_trajectory`,
`phase_start` in s, and `phase`: 1 or -1 for slip forwards or backwards, 0 for stick.
"""

import json
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from baselines.tables import text_table
from benchmarks.accuracy import Trajectory, solve
from capsule_gym import sensitivity
from capsule_gym.command_line import command
from capsule_gym.files import replacing
from capsule_gym.parameters import Capsule
from capsule_gym.tasks.task import START_THETA

COMMAND = "python -m benchmarks.stick_reference"
FILE = Path(__file__).with_suffix(".npz")
# Times at which the torque changes and the state is listed, s, and their number.
HOLD = 0.01
STEPS = 1000
TIMES = HOLD * np.arange(STEPS)
# Step of this package's integrator with which the reference is compared, s.
PHYSICS_DT = 1e-4
ROUGH = Capsule(mu=0.1)
STICKY = Capsule(mu=0.07, static_ratio=1.3)
SMOOTH = Capsule(mu=0.03)
# Amplitudes of a sine torque of 0.5 Hz, N m, between which the platform of `SMOOTH` begins to slip.
BELOW = 0.143594
ABOVE = 0.143595


@dataclass(frozen=True)
class Case:
    """A trajectory.

    Attributes:
        name: what happens.
        capsule: the plant.
        torque: torques in N m at the times `TIMES`.
        theta: initial angle, at rest, rad.
    """

    name: str
    capsule: Capsule
    torque: np.ndarray
    theta: float = START_THETA

    @property
    def start(self) -> tuple[float, float, float, float]:
        """The initial state."""
        return (self.theta, 0.0, 0.0, 0.0)

    def solve(self, steps: int = STEPS) -> Trajectory:
        """The trajectory, or its first steps.

        Raises:
            RuntimeError: if it leaves the limits of the task.
        """
        found = solve(self.torque[:steps], self.capsule.plant(), HOLD, self.start)
        if found.valid < steps:
            raise RuntimeError(f"{self.name!r} fails after {HOLD * found.valid} s")
        return found


def random_torque(seed: int, amplitude: float) -> np.ndarray:
    """Torques in mN m, so that the file stays small, each held for 50 ms."""
    values = np.random.default_rng(seed).uniform(-amplitude, amplitude, STEPS // 5)
    return np.repeat(values.round(3), 5)


def sine(amplitude: float, frequency: float) -> np.ndarray:
    """A sine torque, N m."""
    return (amplitude * np.sin(2.0 * np.pi * frequency * TIMES)).round(6)


def growing_sine(amplitude: float, frequency: float) -> np.ndarray:
    """A sine torque whose amplitude grows linearly from 0, N m."""
    return (sine(amplitude, frequency) * TIMES / TIMES[-1]).round(6)


def rest_angle(capsule: Capsule) -> float:
    """The angle at which the pendulum rests without torque, right of the upright."""
    from scipy.optimize import brentq

    p = capsule.plant()

    def torque(theta: float) -> float:
        gravity = p.g * math.sin(theta) + p.downhill * math.cos(theta)
        return p.m * p.l * gravity - p.k * theta

    return float(brentq(torque, 0.4, 1.4, xtol=1e-15))


def on_slope(name: str, share: float, **constants: Any) -> Case:
    """A pendulum at rest on a floor that slopes by a share of the static limit, without torque."""
    capsule = Capsule(mu=0.1, **constants)
    limit = capsule.mu * capsule.static_ratio
    sloped = replace(capsule, slope=math.atan(share * limit))
    return Case(name, sloped, np.zeros(STEPS), rest_angle(sloped))


def cases() -> list[Case]:
    """All trajectories."""
    at_rest = rest_angle(SMOOTH)
    sticky = replace(SMOOTH, static_ratio=1.3)
    uneven = replace(ROUGH, backward_ratio=2.0)
    stribeck = replace(STICKY, stribeck_speed=0.05)
    light = replace(ROUGH, M=0.3)
    viscous = replace(ROUGH, viscous=0.5)
    return [
        Case("random torque, smooth floor", Capsule(), random_torque(0, 0.35)),
        Case("random torque", ROUGH, random_torque(1, 0.35)),
        Case("random torque, rough floor", Capsule(mu=0.15), random_torque(2, 0.35)),
        Case("random torque, reversals without stick", Capsule(), random_torque(3, 0.5)),
        Case("random torque, static ratio 1.3", STICKY, random_torque(4, 0.4)),
        Case("random torque, static ratio 1.3, Stribeck's curve", stribeck, random_torque(5, 0.5)),
        Case("random torque, twice the friction backwards", uneven, random_torque(6, 0.35)),
        Case("random torque on a slope", replace(ROUGH, slope=0.05), random_torque(7, 0.35)),
        Case("random torque, light platform", light, random_torque(8, 0.3)),
        Case("random torque, viscous friction", viscous, random_torque(9, 0.35)),
        on_slope("rests on a slope, 0.5 of the limit", 0.5),
        on_slope("rests on a slope, 0.999 of the limit", 0.999),
        on_slope("creeps on a slope, 1.001 of the limit", 1.001),
        on_slope("creeps steadily, 1.01 of the limit and viscous friction", 1.01, viscous=0.5),
        on_slope("rests on a slope, 1.25 of the kinetic limit", 0.9615, static_ratio=1.3),
        Case("breaks away under a growing load", SMOOTH, growing_sine(0.2, 1.0), at_rest),
        Case("breaks away, static ratio 1.3", sticky, growing_sine(0.2, 1.0), at_rest),
        Case("sticks in every cycle", SMOOTH, sine(0.2, 1.0), at_rest),
        Case("the load stays just below the limit", SMOOTH, sine(BELOW, 0.5), at_rest),
        Case("the load just exceeds the limit", SMOOTH, sine(ABOVE, 0.5), at_rest),
    ]


def error(case: Case, states: np.ndarray) -> float:
    """The largest difference of this package's states from the reference."""
    periods = {"control_dt": HOLD, "physics_dt": PHYSICS_DT}
    found = sensitivity(case.start, case.torque, (), capsule=case.capsule, **periods)
    return float(np.abs(found.states - states).max())


@command(COMMAND)
def main() -> None:
    """Solves the reference trajectories, and writes them to benchmarks/stick_reference.npz.

    Examples:
      python -m benchmarks.stick_reference
    """
    listed = cases()
    found = []
    lines = [["trajectory", "phases", "time in stick, s", "difference of the package"]]
    for case in tqdm(listed, "trajectories", file=sys.stderr, disable=None):
        solved = case.solve()
        found.append(solved)
        stuck = solved.sums[-1, 2]
        difference = error(case, solved.states)
        lines.append([case.name, str(len(solved.phases)), f"{stuck:.3f}", f"{difference:.1e}"])
    phases = []
    for number, solved in enumerate(found):
        for start, phase in solved.phases:
            phases.append((number, start, phase))
    trajectories, starts, kinds = np.array(phases).T
    with replacing(FILE) as temporary:
        np.savez_compressed(
            temporary,
            name=[case.name for case in listed],
            plant=[json.dumps(vars(case.capsule)) for case in listed],
            torque=np.array([case.torque for case in listed]),
            state=np.array([solved.states for solved in found]),
            phase_trajectory=trajectories.astype(int),
            phase_start=starts,
            phase=kinds.astype(int),
        )
    print(text_table(lines, left=1))


if __name__ == "__main__":
    main()
