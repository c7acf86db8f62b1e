"""The adaptive law with other choices than its own, at other rates and for longer: one compiled kernel for all of it.

What stands in a law's closure is a constant of the compiler's, and every other value another kernel to compile. The
law here has what varies in cells of its memory, behind those of `MEMORY`, and is the same `adaptive_step` otherwise:
with the choices of `adaptive()` it gives the torque of `adaptive()`, bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from baselines.laws.adaptive import chosen, constants_of, initial_memory, root_of_eta
from baselines.laws.adaptive_terms import MEMORY, Constants, adaptive_step
from baselines.laws.gains import PUBLISHED, REGULARISED, UNREGULARISED
from baselines.laws.profiles import PROPOSED
from baselines.laws.reference import reference_table
from baselines.paper.traces import CYCLES, UNLIMITED
from capsule_gym.controller import Controller, Law
from capsule_gym.layout import ROWS, Row
from capsule_gym.parameters import LAW_DT, NOMINAL, EnvConfig
from capsule_gym.simulation import Simulation

CELLS = len(MEMORY)
# The cells behind those of the law: what varies (regularised as 1.0 or 0.0), and the largest |theta - theta_d| in rad,
# |theta' - theta_d'| and |delta_theta| in rad/s since somebody has set them to zero.
VARIED = ("beta", "n", "root_bound", "dt", "regularised")
PEAKS = ("angle_error", "rate_error", "sliding")
FIRST_PEAK = CELLS + len(VARIED)


def varied_law(regularised: Constants, unregularised: Constants) -> Law:
    """The law (39) with the constants of `VARIED` out of its memory and the others out of the form's own."""

    def law(
        theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
    ) -> tuple[float, tuple[float, ...]]:
        beta, n, root_bound, dt, form = memory[CELLS:FIRST_PEAK]
        fixed = regularised if form > 0.0 else unregularised
        constants = Constants(
            fixed.plant,
            fixed.gains,
            beta,
            int(n),
            fixed.saturation_width,
            root_bound,
            fixed.lowest,
            fixed.highest,
            fixed.anchored,
            fixed.cycle_advance,
            dt,
        )
        torque, kept = adaptive_step(theta, theta_dot, x, x_dot, memory[:CELLS], reference, constants)
        e, e_dot = theta - reference[0], theta_dot - reference[1]
        angle, rate, sliding = memory[FIRST_PEAK:]
        return torque, (
            *kept,
            beta,
            n,
            root_bound,
            dt,
            form,
            max(angle, abs(e)),
            max(rate, abs(e_dot)),
            max(sliding, abs(e_dot + fixed.gains.Lambda_theta * e)),
        )

    return law


@lru_cache(maxsize=1)
def _law() -> tuple[Law, Constants, Constants]:
    """The law above, and the constants of both forms that it starts from."""
    plant = NOMINAL.plant()
    table = reference_table(PROPOSED, plant)
    regularised, unregularised = (
        constants_of(PUBLISHED, choices, plant, table, LAW_DT) for choices in (REGULARISED, UNREGULARISED)
    )
    return varied_law(regularised, unregularised), regularised, unregularised


def varied(
    *,
    regularised: bool,
    beta: float | None = None,
    n: int | None = None,
    eta_0: float | None = None,
    dt: float = LAW_DT,
) -> Controller:
    """The adaptive law with other choices; the arguments, and the torque, are those of `adaptive`."""
    law, *forms = _law()
    choices = chosen(REGULARISED if regularised else UNREGULARISED, beta, n, eta_0)
    form = (forms[0] if regularised else forms[1])._replace(n=choices.n)
    memory = (
        *initial_memory(form, choices.eta_0),
        choices.beta,
        float(choices.n),
        root_of_eta(choices.eta_bound, choices.n),
        dt,
        float(regularised),
        *(0.0 for _ in PEAKS),
    )
    table = reference_table(PROPOSED, NOMINAL.plant(), dt)
    return Controller("adaptive, with its choices in its memory", law, table, memory, dt)


@dataclass(frozen=True)
class Endurance:
    """How long a controller lasts on some plants, and how well it does in each cycle.

    Attributes:
        until: how far it came, s, shape (plants,).
        failed: whether contact was lost or the pendulum met the platform, shape (plants,).
        peaks: the largest of each of `PEAKS` in every cycle, shape (cycles, 3, plants).
    """

    until: np.ndarray
    failed: np.ndarray
    peaks: np.ndarray

    @property
    def failures(self) -> int:
        """Number of plants that fail."""
        return int(self.failed.sum())


def endure(
    controller: Controller,
    plants: list[tuple[float, float]],
    *,
    cycles: int = CYCLES,
    torque_limit: float = UNLIMITED,
) -> Endurance:
    """Runs a controller of `varied` from rest at -pi/3, all plants at once.

    Args:
        controller: what `varied` returns.
        plants: M in kg and mu of each.
        cycles: of the reference.
        torque_limit: N m.
    """
    count = len(plants)
    # An agent step of one cycle: nothing but the law's memory has to be looked at in between.
    options = EnvConfig(
        controller=controller,
        randomization="none",
        torque_limit=torque_limit,
        residual_limit=0.0,
        control_dt=PROPOSED.period,
        physics_dt=min(controller.dt, LAW_DT),
    )
    simulation = Simulation(count, options)
    simulation.reset(np.arange(count), M=[M for M, _ in plants], mu=[mu for _, mu in plants])
    running, nothing = np.ones(count, np.bool_), np.zeros(count)
    first, last = ROWS + FIRST_PEAK, ROWS + FIRST_PEAK + len(PEAKS)
    peaks = np.zeros((cycles, len(PEAKS), count))
    for cycle in range(cycles):
        simulation.step(nothing, running)
        peaks[cycle] = np.where(running, simulation.rows(first, last), 0.0)
        for row in range(first, last):
            simulation.write(row, nothing)
        running &= simulation.row(Row.termination) == 0.0
        if not running.any():
            break
    return Endurance(simulation.row(Row.duration), ~running, peaks)
