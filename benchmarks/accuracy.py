"""Error of the plant's step against an independent reference: `python -m benchmarks.accuracy`.

Each trajectory starts at theta = -pi/3 at rest, under a random torque. The error is that of theta
(rad), theta' (rad/s), x (m) or x' (m/s). Where MuJoCo is installed, a second table contains the
same capsule in MuJoCo.

The reference does not use the equations of `capsule_gym`. Its equations are typed again from the
paper, corrected, and solved differently: the first row of Eq. (1) gives theta'' in terms of x'',
the normal force is linear in x'', and the second row then contains only x''. SciPy's DOP853
integrates the phases of contact (slip = +1, -1 or 0 for stick) one after another.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from benchmarks import mujoco
from benchmarks.measurement import machine, report
from capsule_gym import sensitivity
from capsule_gym.command_line import check_output, command
from capsule_gym.parameters import Capsule, Plant
from capsule_gym.tasks import task

COMMAND = "python -m benchmarks.accuracy"
START = (task.START_THETA, 0.0, 0.0, 0.0)
SECONDS = 10.0
STEPS = (0.00025, 0.0005, 0.001, 0.002, 0.005, 0.01)
# Trajectories for each friction coefficient and amplitude, N m.
TRAJECTORIES = 16
FRICTION = (0.01, 0.1, 0.3)
AMPLITUDES = (0.2, 0.5, 1.0, 1.5)
# Number of plants that differ in every constant, each with its own trajectory, and the amplitude of
# the torque, N m.
PLANTS = 40
AMPLITUDE = 0.7
RANGES = {
    "M": (0.3, 1.0),
    "m": (0.1, 0.2),
    "l": (0.2, 0.4),
    "k": (0.2, 0.6),
    "c": (0.05, 0.15),
    "mu": (0.01, 0.5),
    "static_ratio": (1.0, 1.5),
    "backward_ratio": (0.5, 2.0),
    "viscous": (0.0, 0.5),
    "stribeck_speed": (0.05, 0.5),
    "slope": (-0.05, 0.05),
    "motor_friction": (0.0, 0.1),
}
# Friction coefficients and amplitudes that are compared with MuJoCo, and its steps, s.
MUJOCO_CASES = ((0.01, 0.5), (0.1, 1.0))
MUJOCO_STEPS = (0.002, 0.0005)
# The share of the friction limit that loads the platform at rest.
LOAD = 0.5
# Tolerances of the reference, and its longest step, s, in which the boundary of a phase is crossed
# only once.
RTOL = 2e-13
ATOL = 1e-15
LONGEST = 0.002
# A rate, rad/s, or acceleration, rad/s^2, of the pendulum that is rounding.
REST = 1e-12


class Trajectory(NamedTuple):
    """The result of `solve`; row i of the arrays belongs to the time i * hold.

    Attributes:
        states: theta, theta_dot, x, x_dot.
        sums: since the start, distances moved forwards and backwards, m, time in stick, s, and the
            integral of |theta_dot|, rad.
        events: number of changes of phase within control intervals.
        phases: start, s, and phase of each phase of contact, also of those that a change of the
            torque begins.
        valid: number of control intervals before the one in which the ball meets the platform or
            contact is lost.
    """

    states: np.ndarray
    sums: np.ndarray
    events: int
    phases: list[tuple[float, float]]
    valid: int


def rates(
    theta: float, omega: float, v: float, slip: float, u: float, p: Plant
) -> tuple[float, float, float]:
    """Computes theta'', x'' and the normal force in one phase of contact."""
    s = math.sin(theta)
    c = math.cos(theta)
    ratio = min(1.0, max(-1.0, omega))
    # 16 times the smooth sign of omega
    sign = 35.0 * ratio - 35.0 * ratio**3 + 21.0 * ratio**5 - 5.0 * ratio**7
    u -= p.motor_friction * sign / 16.0
    mass = p.M + p.m
    moment = p.m * p.l
    internal = p.k * theta + p.c * omega
    gravity = p.g * s + p.downhill * c
    # theta'' on a platform that does not accelerate
    free = (u - internal + moment * gravity) / (p.m * p.l**2)
    weight = mass * p.g - p.pivot_torque_on_contact * internal * s
    normal_rest = weight - moment * (free * s + omega**2 * c)
    load = moment * (free * c - omega**2 * s) - mass * p.downhill - p.viscous * v
    if slip == 0.0:
        return free, 0.0, normal_rest
    mu = p.mu if slip > 0.0 else p.mu * p.backward_ratio
    mu *= 1.0 + p.stribeck_excess / (1.0 + (v * p.stribeck_rate) ** 2)
    # theta'' = free + cos x'' / l and N = normal_rest - m sin cos x'', so that x'' is the only
    # unknown.
    inertia = p.M + p.m * s**2
    friction = slip * mu
    x_ddot = (load - friction * normal_rest) / (inertia - friction * p.m * s * c)
    normal = normal_rest - p.m * s * c * x_ddot
    if normal < 0.0:
        x_ddot = load / inertia
        normal = 0.0
    return free + c * x_ddot / p.l, x_ddot, normal


def margins(theta: float, omega: float, u: float, p: Plant) -> tuple[float, float]:
    """The static limit minus the load on a platform at rest, forwards and backwards, in N."""
    alpha, _, normal = rates(theta, omega, 0.0, 0.0, u, p)
    acceleration = alpha * math.cos(theta) - omega**2 * math.sin(theta)
    load = p.m * p.l * acceleration - (p.M + p.m) * p.downhill
    limit = p.static_ratio * p.mu * max(0.0, normal)
    return limit - load, p.backward_ratio * limit + load


def integrate_phase(t: float, y: np.ndarray, end: float, slip: float, u: float, p: Plant) -> Any:
    """Integrates one phase until it ends, theta_dot changes its sign, or `end`.

    Returns:
        SciPy's result.
    """
    # Imported here, since SciPy's solvers take a second to import and --help does not need them.
    from scipy.integrate import solve_ivp

    def derivative(_: float, y: np.ndarray) -> tuple[float, float, float, float]:
        theta, omega, _, v = y
        alpha, acceleration, _ = rates(theta, omega, v, slip, u, p)
        return omega, alpha, v, acceleration

    def margin(_: float, y: np.ndarray) -> float:
        theta, omega, _, v = y
        return slip * v if slip else min(margins(theta, omega, u, p))

    def turn(_: float, y: np.ndarray) -> float:
        return y[1]

    # scipy reads these attributes of its events.
    vars(margin).update(terminal=True, direction=-1.0)
    # After a turn, theta_dot is 0 up to rounding.
    omega = y[1]
    if abs(omega) <= REST:
        _, omega, _, _ = derivative(t, y)
    vars(turn).update(terminal=True, direction=-omega)
    # A pendulum at rest turns at every step.
    events = (margin,) if abs(omega) <= REST else (margin, turn)
    solver: dict[str, Any] = {"method": "DOP853", "rtol": RTOL, "atol": ATOL}
    longest = min(LONGEST, end - t)
    for _ in range(20):
        steps = {"first_step": longest, "max_step": longest}
        found = solve_ivp(derivative, (t, end), y, events=events, **solver, **steps)
        if found.t[-1] > t or slip == 0.0 or y[3] != 0.0:
            return found
        # The slip begins on its boundary, with velocity 0, and ends within one step.
        longest /= 4.0
    raise RuntimeError("a phase of contact ends where it starts")


def solve(
    torques: Sequence[float] | np.ndarray,
    p: Plant,
    hold: float = task.CONTROL_DT,
    start: Sequence[float] = START,
) -> Trajectory:
    """Integrates the plant under torques in N m, each held for `hold` seconds."""
    y = np.array(start)
    states, sums = [y], [np.zeros(4)]
    events, valid = 0, len(torques)
    phases: list[tuple[float, float]] = []
    for i, u in enumerate(map(float, torques)):
        t, total = 0.0, sums[-1]
        slip = math.copysign(1.0, y[3]) if y[3] != 0.0 else phase_at_rest(y, u, p)
        while t < hold:
            if not phases or phases[-1][1] != slip:
                phases.append((i * hold + t, slip))
            found = integrate_phase(t, y, hold, slip, u, p)
            end = found.y[:, -1].copy()
            angle, _, moved, _ = end - y
            stuck = 0.0 if slip else found.t[-1] - t
            total = total + np.array([max(0.0, moved), max(0.0, -moved), stuck, abs(angle)])
            normal = min(rates(theta, omega, v, slip, u, p)[2] for theta, omega, _, v in found.y.T)
            if abs(found.y[0]).max() >= task.THETA_LIMIT or normal <= 0.0:
                valid = min(valid, i)
            t, y = found.t[-1], end
            # Without friction, theta_dot and x_dot change their signs at the same time.
            if found.t_events[0].size or slip * y[3] < 0.0:
                y[3] = 0.0
                slip = phase_at_rest(y, u, p) if slip else direction_of_load(y, u, p)
                events += 1
        states.append(y)
        sums.append(total)
    return Trajectory(np.array(states), np.array(sums), events, phases, valid)


def phase_at_rest(y: np.ndarray, u: float, p: Plant) -> float:
    """The phase of a platform at rest.

    It sticks below the static limit, and otherwise slips in the direction of the load.
    """
    theta, omega, _, _ = y
    sticks = min(margins(theta, omega, u, p)) >= 0.0
    return 0.0 if sticks else direction_of_load(y, u, p)


def direction_of_load(y: np.ndarray, u: float, p: Plant) -> float:
    """1 if the load on a platform at rest is nearer to the limit of moving forwards, else -1."""
    theta, omega, _, _ = y
    margin_forwards, margin_backwards = margins(theta, omega, u, p)
    return math.copysign(1.0, margin_backwards - margin_forwards)


def expected_trajectories(
    capsules: Sequence[Capsule], amplitude: float
) -> list[tuple[Capsule, np.ndarray, np.ndarray]]:
    """Plants, torques in valid control intervals, and the reference's state at their end.

    The torques of plant i have the seed i.
    """
    solved = []
    intervals = round(SECONDS / task.CONTROL_DT)
    for seed, capsule in enumerate(capsules):
        torques = np.random.default_rng(seed).uniform(-amplitude, amplitude, intervals)
        found = solve(torques, capsule.plant())
        solved.append((capsule, torques[: found.valid], found.states[found.valid]))
    return solved


def run(torques: np.ndarray, capsule: Capsule, step: float, friction: str = "") -> np.ndarray:
    """The state after control intervals with torques in N m.

    It is that of the plant's step or, with a friction, of MuJoCo.
    """
    if friction:
        model, data = mujoco.build(friction, step, capsule)
        return [mujoco.hold(model, data, torque) for torque in torques][-1]
    periods = {"control_dt": task.CONTROL_DT, "physics_dt": step}
    return sensitivity(START, torques, (), capsule=capsule, **periods).states[-1]


def cell(values: Sequence[float]) -> str:
    """The largest and the median value."""
    return f"{max(values):.1e} ({np.median(values):.1e})"


def compare_mujoco() -> list[list[str]]:
    """The table of the comparison with MuJoCo."""
    head = ["", f"hold at {LOAD:.0%}, m/s"]
    cases = []
    for mu, amplitude in MUJOCO_CASES:
        solved = expected_trajectories([Capsule(mu=mu)] * TRAJECTORIES, amplitude)
        for step in MUJOCO_STEPS:
            cases.append((solved, step))
            case = f"μ = {mu:g}, ±{amplitude:g} N m, {1e3 * step:g} ms"
            head.append(f"error of x, mm: {case}")
    table = [head]
    for friction in tqdm(("", *mujoco.FRICTIONS), desc="MuJoCo"):
        speed = creep(friction)
        row = [f"MuJoCo, {friction}" if friction else "capsule_gym"]
        row.append(f"{speed:.0e}" if speed else "0")
        for solved, step in cases:
            errors = []
            for capsule, torques, expected in solved:
                x = run(torques, capsule, step, friction)[2]
                errors.append(1e3 * abs(x - expected[2]))
            row.append(cell(errors))
        table.append(row)
    return table


def creep(friction: str) -> float:
    """The speed, m/s, of a platform that is loaded by a share of its friction limit."""
    capsule = Capsule(mu=MUJOCO_CASES[-1][0])
    step = MUJOCO_STEPS[0]
    if friction:
        load = LOAD * capsule.mu * (capsule.M + capsule.m) * capsule.g
        return mujoco.creep(*mujoco.build(friction, step, capsule), load)
    # A floor that slopes by the same load.
    sloped = replace(capsule, slope=-math.atan(LOAD * capsule.mu))
    return abs(run(np.zeros(500), sloped, step)[3])


def draw_capsule(seed: int) -> Capsule:
    """A plant with every constant drawn from its range."""
    generator = np.random.default_rng(seed)
    constants: dict[str, Any] = {}
    for name, limits in RANGES.items():
        constants[name] = generator.uniform(*limits)
    return Capsule(**constants)


@command(COMMAND, ValueError)
def main(markdown: Path | None = None) -> None:
    """The integration error of the plant's step at several step sizes.

    Errors are those against an independent reference.

    Examples:
      python -m benchmarks.accuracy --markdown docs/error_table.md

    Args:
        markdown: Write the tables to this file.
    """
    check_output("--markdown", markdown, overwrite=True)
    kinds = []
    for mu in FRICTION:
        for amplitude in AMPLITUDES:
            capsules = [Capsule(mu=mu)] * TRAJECTORIES
            kinds.append((f"μ = {mu:g}", capsules, amplitude))
    capsules = [draw_capsule(seed) for seed in range(PLANTS)]
    kinds.append((f"{PLANTS} random", capsules, AMPLITUDE))
    columns = [f"{1e3 * step:g} ms" for step in STEPS]
    table = [["plant", "torque, N m", *columns, "length"]]
    for kind, capsules, amplitude in tqdm(kinds, desc="errors"):
        solved = expected_trajectories(capsules, amplitude)
        row = [kind, f"±{amplitude:g}"]
        for step in STEPS:
            errors = [run(torques, plant, step) - state for plant, torques, state in solved]
            row.append(cell([np.abs(error).max() for error in errors]))
        length = task.CONTROL_DT * np.median([len(torques) for _, torques, _ in solved])
        table.append([*row, f"{length:.1f} s"])
    parts = [table, compare_mujoco()] if find_spec("mujoco") else [table]
    report(COMMAND, markdown, *parts, f"{machine()}.")


if __name__ == "__main__":
    sys.exit(main())
