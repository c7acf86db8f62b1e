"""Sect. 5 of the paper: both profiles, tracked exactly and under feedback linearisation (35).

Under exact tracking the platform's motion follows from M, m, l, g and mu alone: `speed_map`
evaluates it on many plants. `simulate` and `track` run the environment's own simulation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsule_gym import Capsule, Controller
from capsule_gym.control.controller import LAW_DT
from capsule_gym.control.laws.feedback_linearisation import feedback_linearising
from capsule_gym.control.laws.profiles import EPC, PROPOSED, Profile, platform_motion
from capsule_gym.core.layout import NUM_ROWS, Row
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.simulation import Simulation
from capsule_gym.parameters import NOMINAL, NormalForce, Plant

PROFILES = (PROPOSED, EPC)
UNLIMITED = 50.0  # beyond any torque of the paper: its Figures 5 and 8 show no limit
CYCLES = 5
M_RANGE, MU_RANGE = (0.3, 1.0), (0.003, 1.0)
# s. Fivefold refinement changes no speed of the map by more than 1e-5 cm/s.
MAP_STEP = 1e-4
# Below this speed in cm/s a profile moves only during its first push, and a ratio of speeds is
# meaningless.
AT_REST = 0.01


@dataclass(frozen=True)
class Trajectory:
    """One run in SI units, a sample per millisecond from the start.

    Arrays have the shape (n,) or (n, columns).
    """

    t: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    x: np.ndarray
    x_dot: np.ndarray
    torque: np.ndarray  # of the motor in the millisecond that ends at t
    reference: np.ndarray  # rows of the reference table
    memory: np.ndarray  # of the law after its call at t
    metrics: dict[str, float]  # see `Simulation.metrics`

    @property
    def completed(self) -> bool:
        """Whether the pendulum did not reach the platform, and the platform kept contact."""
        return self.metrics["failed"] == 0.0

    @property
    def error(self) -> np.ndarray:
        """theta - theta_d, rad."""
        return self.theta - self.reference[:, 0]

    @property
    def rate_error(self) -> np.ndarray:
        """theta' - theta_d', rad/s."""
        return self.theta_dot - self.reference[:, 1]

    @property
    def error_rms(self) -> float:
        """Root mean square of theta - theta_d, rad."""
        return float(np.sqrt(np.mean(self.error**2)))


def simulate(
    controller: Controller,
    plants: Sequence[tuple[float, float]] = ((NOMINAL.M, NOMINAL.mu),),
    *,
    cycles: int = CYCLES,
    torque_limit: float = UNLIMITED,
    **options: Any,
) -> list[Trajectory]:
    """Runs a law at 1 kHz from rest at -pi/3 over cycles of its reference on plants, M (kg) and mu.

    `torque_limit` is in N m; `options` are further options of the environment.
    """
    simulation = make_simulation(controller, plants, LAW_DT, torque_limit=torque_limit, **options)
    count = len(plants)
    steps = cycles * len(simulation.reference)
    rows = NUM_ROWS + len(simulation.memory)
    states = np.zeros((steps + 1, rows, count))
    states[0] = simulation.rows(0, rows)
    no_residual = np.zeros(count)
    running = np.ones(count, np.bool_)
    last = np.zeros(count, np.int64)
    for n in range(1, steps + 1):
        simulation.step(no_residual, running)
        states[n] = simulation.rows(0, rows)
        last[running] = n
        running &= states[n, Row.termination] == 0.0
        if not running.any():
            break

    metrics = simulation.metrics(np.arange(count), steps)
    trajectories = []
    for i, end in enumerate(last):
        own = states[: end + 1, :, i]
        own_metrics = {name: float(values[i]) for name, values in metrics.items()}
        clock = own[:, Row.clock].astype(np.int64)
        trajectory = Trajectory(
            t=np.arange(end + 1) * LAW_DT,
            theta=own[:, Row.theta],
            theta_dot=own[:, Row.theta_dot],
            x=own[:, Row.x],
            x_dot=own[:, Row.x_dot],
            torque=own[:, Row.torque],
            reference=simulation.reference[clock],
            memory=own[:, NUM_ROWS:],
            metrics=own_metrics,
        )
        trajectories.append(trajectory)
    return trajectories


def make_simulation(
    controller: Controller, plants: Sequence[tuple[float, float]], control_dt: float, **options: Any
) -> Simulation:
    """The environment's simulation of plants (M, mu) at rest at -pi/3, without residual torque."""
    settings = {"randomization": "none", "residual_limit": 0.0, "physics_dt": LAW_DT, **options}
    config = EnvConfig(controller=controller, control_dt=control_dt, **settings)
    simulation = Simulation(len(plants), config)
    masses, frictions = zip(*plants, strict=True)
    simulation.reset(np.arange(len(plants)), masses, frictions)
    return simulation


def track(profile: Profile, contact: NormalForce = "newton") -> dict[str, float]:
    """Runs five cycles of a profile under (35) at 1 kHz.

    Plant and law have the same option for the normal force.

    Returns:
        `peak_velocity` (rad/s), `swing` (largest angle, degrees), `mean_speed` (cm/s),
        `peak_torque` (N m), `energy` (mechanical energy per cycle, J), `cost_of_transport`,
        `backward` (travel backwards per cycle, cm), `backward_ratio` (over travel forwards) and
        `error` (rms of theta - theta_d, rad).
    """
    capsule = Capsule(normal_force=contact)
    (run,) = simulate(feedback_linearising(profile, nominal=capsule), capsule=capsule)
    metrics = run.metrics
    ratio = metrics["backward_ratio"]
    backward = 100.0 * metrics["distance"] * ratio / (1.0 - ratio)
    return {
        "peak_velocity": metrics["largest_theta_dot"],
        "swing": math.degrees(metrics["largest_theta"]),
        "mean_speed": metrics["mean_speed"],
        "peak_torque": metrics["peak_torque"],
        "energy": metrics["energy"] / CYCLES,
        "cost_of_transport": metrics["cost_of_transport"],
        "backward": backward / CYCLES,
        "backward_ratio": ratio,
        "error": run.error_rms,
    }


def displacement(motion: Sequence[np.ndarray], p: Plant, h: float) -> float:
    """The position in m of the platform after `CYCLES` cycles from rest.

    `motion` is theta (rad), theta' and theta'' in the middle of every step of h seconds of one
    cycle.
    """

    def slide(cycles: int) -> tuple[float, float]:
        # With the first step of the next cycle, whose start is the end.
        theta, theta_dot, theta_ddot = (
            np.append(np.tile(samples, cycles), samples[0]) for samples in motion
        )
        x, x_dot, _ = platform_motion(theta, theta_dot, theta_ddot, h, p)
        return float(x[-1]), float(x_dot[-1])

    x, x_dot = slide(1)
    if x_dot == 0.0:
        # A platform that rests at the end of the cycle moves in the same way in the next one.
        return CYCLES * x
    x, _ = slide(CYCLES)
    return x


def grid(rows: int = 29, columns: int = 61) -> tuple[list[float], list[float]]:
    """Evenly spaced M in kg over M_RANGE, and mu over MU_RANGE in equal ratios."""
    M = np.linspace(*M_RANGE, rows)
    mu = np.geomspace(*MU_RANGE, columns)
    return M.tolist(), mu.tolist()


def speed_map(
    profile: Profile,
    M: Sequence[float] = (NOMINAL.M,),
    mu: Sequence[float] = (NOMINAL.mu,),
    h: float = MAP_STEP,
) -> np.ndarray:
    """Mean speed along a profile, tracked exactly for five cycles from rest, for every M and mu.

    The steps last h seconds. Where the motion would lift the platform, the floor is without
    friction.

    Returns:
        Shape (M, mu), cm/s.
    """
    # In the middle of the steps, where theta_d'' does not jump.
    steps = round(profile.period / h)
    t = (np.arange(steps) + 0.5) * h
    motion = profile.evaluate(t)
    travelled = np.empty((len(M), len(mu)))
    for i, mass in enumerate(M):
        for j, friction in enumerate(mu):
            plant = NOMINAL.plant(M=mass, mu=friction)
            travelled[i, j] = displacement(motion, plant, h)
    return 100.0 * travelled / (CYCLES * profile.period)


def friction_for(profile: Profile, speed: float) -> list[float]:
    """Every mu of `grid` at which the nominal mass has a speed (cm/s), interpolated in log mu."""
    _, mu = grid()
    excess = speed_map(profile, mu=mu)[0] - speed
    logs = np.log(mu)
    (crossings,) = np.nonzero(excess[:-1] * excess[1:] < 0.0)
    before = excess[crossings]
    after = excess[crossings + 1]
    shares = before / (before - after)
    widths = np.diff(logs)[crossings]
    found: list[float] = np.exp(logs[crossings] + shares * widths).tolist()
    return found


def speed_ratio(proposed: np.ndarray, epc: np.ndarray) -> np.ndarray:
    """Speed of the proposed profile over EPC's; NaN where EPC does not move."""
    ratio = np.full_like(epc, np.nan)
    return np.divide(proposed, epc, out=ratio, where=epc > AT_REST)
