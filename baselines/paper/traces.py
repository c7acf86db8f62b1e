"""The course of a scripted run at the law's own rate: what tables and figures of the reproduction are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from capsule_gym import Capsule, Controller
from capsule_gym.layout import ROWS, Row
from capsule_gym.parameters import LAW_DT, NOMINAL, EnvConfig
from capsule_gym.simulation import Simulation

# Beyond any torque of the paper: its Figures 5 and 8 show no limit.
UNLIMITED = 50.0
CYCLES = 5


@dataclass(frozen=True)
class Trace:
    """One run, a sample per millisecond; the first is the start.

    Attributes:
        t: s, shape (n,).
        theta: rad.
        theta_dot: rad/s.
        x: m.
        x_dot: m/s; exactly 0.0 in stick.
        torque: the motor's in the millisecond that ends at t, N m.
        normal_force: the smallest in that millisecond, N.
        theta_d: reference angle, rad.
        theta_d_dot: reference rate, rad/s.
        reference: all columns of the reference table, shape (n, columns).
        memory: the law's memory after its call at t, shape (n, cells).
        metrics: the episode's, by name; see `Simulation.metrics`.
        completed: whether it ran to its end without losing contact or the pendulum meeting the platform.
    """

    t: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    x: np.ndarray
    x_dot: np.ndarray
    torque: np.ndarray
    normal_force: np.ndarray
    theta_d: np.ndarray
    theta_d_dot: np.ndarray
    reference: np.ndarray
    memory: np.ndarray
    metrics: dict[str, float]
    completed: bool

    @property
    def error(self) -> np.ndarray:
        """theta - theta_d, rad."""
        return self.theta - self.theta_d

    @property
    def rate_error(self) -> np.ndarray:
        """theta' - theta_d', rad/s."""
        return self.theta_dot - self.theta_d_dot

    @property
    def error_rms(self) -> float:
        """Root of the mean square of theta - theta_d, rad."""
        return float(np.sqrt(np.mean(self.error**2)))


def trace(
    controller: Controller,
    *,
    M: float = NOMINAL.M,
    mu: float = NOMINAL.mu,
    cycles: int = CYCLES,
    torque_limit: float = UNLIMITED,
    capsule: Capsule | None = None,
    physics_dt: float = LAW_DT,
) -> Trace:
    """Runs a controller from rest at -pi/3 and records every millisecond.

    Args:
        controller: the law with its reference, at the samples' 1 kHz.
        M: mass of the platform, kg.
        mu: friction coefficient.
        cycles: cycles of the reference.
        torque_limit: N m.
        capsule: the other constants, and the option for the normal force.
        physics_dt: step of the integrator, s; divides 1 ms.

    Raises:
        ValueError: if the law runs at another rate.
    """
    return traces(
        controller, [(M, mu)], cycles=cycles, torque_limit=torque_limit, capsule=capsule, physics_dt=physics_dt
    )[0]


def traces(controller: Controller, plants: list[tuple[float, float]], **settings: Any) -> list[Trace]:
    """The same for several plants (M, mu) at once; the settings are those of `trace`."""
    if controller.dt != LAW_DT:
        raise ValueError(f"controller must run every {LAW_DT} s, got dt={controller.dt!r} s")
    cycles = settings.pop("cycles", CYCLES)
    settings.setdefault("torque_limit", UNLIMITED)
    settings.setdefault("physics_dt", LAW_DT)
    options = EnvConfig(controller=controller, randomization="none", residual_limit=0.0, control_dt=LAW_DT, **settings)
    simulation = Simulation(len(plants), options)
    everywhere = np.arange(len(plants))
    simulation.reset(everywhere, M=[M for M, _ in plants], mu=[mu for _, mu in plants])
    steps = cycles * len(simulation.reference)
    rows = ROWS + len(simulation.memory)
    course = np.zeros((steps + 1, rows, len(plants)))
    course[0] = simulation.rows(0, rows)
    running = np.ones(len(plants), np.bool_)
    last = np.zeros(len(plants), np.int64)
    nothing = np.zeros(len(plants))
    for n in range(1, steps + 1):
        simulation.step(nothing, running)
        course[n] = simulation.rows(0, rows)
        last[running] = n
        running &= course[n, Row.termination] == 0.0
        if not running.any():
            break
    metrics = simulation.metrics(everywhere, steps)
    return [
        _cut(course[: last[i] + 1, :, i], simulation.reference, {name: float(v[i]) for name, v in metrics.items()})
        for i in range(len(plants))
    ]


def _cut(course: np.ndarray, table: np.ndarray, metrics: dict[str, float]) -> Trace:
    """The trace of one plant from its rows of `world`, shape (samples, rows)."""
    reference = table[course[:, Row.clock].astype(np.int64)]
    return Trace(
        t=np.arange(len(course)) * LAW_DT,
        theta=course[:, Row.theta],
        theta_dot=course[:, Row.theta_dot],
        x=course[:, Row.x],
        x_dot=course[:, Row.x_dot],
        torque=course[:, Row.torque],
        normal_force=course[:, Row.normal_force],
        theta_d=reference[:, 0],
        theta_d_dot=reference[:, 1],
        reference=reference,
        memory=course[:, ROWS:],
        metrics=metrics,
        completed=metrics["failed"] == 0.0,
    )
