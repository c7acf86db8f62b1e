"""How far the paper's two profiles carry the platform on other plants, contacts and integration steps.

The pendulum follows its profile exactly here, so a run is the platform's motion under known forces:
`python -m baselines.paper.sensitivity` prints the numbers, `baselines.paper.figures.studies` draws them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from baselines.laws.feedback_linearisation import feedback_linearising_law
from baselines.laws.gains import K_P, K_V
from baselines.laws.profiles import Profile
from baselines.laws.reference import COLUMNS, slide
from baselines.paper.traces import CYCLES, UNLIMITED
from capsule_gym import Capsule, Controller, dynamics
from capsule_gym.compilation import compile_cached
from capsule_gym.parameters import NOMINAL, EnvConfig, NormalForce, Plant, check_number
from capsule_gym.simulation import Simulation

M_RANGE = (0.3, 1.0)
MU_RANGE = (0.003, 1.0)
NORMAL_FORCES: tuple[NormalForce, ...] = ("newton", "paper")
# Refined fivefold, no speed of the map moves by more than 1e-5 cm/s.
MAP_STEP = 1e-4
STEPS = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2)
AGENT_STEP = 0.02
# Below this both profiles rest but for their first push, and a ratio says nothing; cm/s.
ALL_BUT_AT_REST = 0.01


def contact_loads(
    angle: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray, p: Plant
) -> tuple[np.ndarray, np.ndarray]:
    """The pendulum's push on the platform and the floor's normal force before its clamp, N, along a motion.

    Args:
        angle: theta, rad, shape (n,).
        velocity: theta', rad/s.
        acceleration: theta'', rad/s^2.
        p: the plant.
    """
    force, normal = np.empty_like(angle), np.empty_like(angle)
    for n in range(len(angle)):
        force[n] = dynamics.driving_force(angle[n], velocity[n], acceleration[n], p)
        normal[n] = dynamics.normal_force(angle[n], velocity[n], acceleration[n], p)
    return force, normal


def displacements(
    force: np.ndarray, normal: np.ndarray, friction: np.ndarray, total: float, h: float, cycles: int
) -> np.ndarray:
    """Where the platform is after some cycles from rest, m, for many friction coefficients at once.

    Neither load depends on the friction while the pendulum's motion is given, which is what makes a map cheap.

    Args:
        force: the pendulum's push at the middle of every step of one cycle, N.
        normal: the normal force there, N, before its clamp at zero.
        friction: friction coefficients, static and kinetic, both ways.
        total: M + m, kg.
        h: s.
        cycles: repetitions.
    """
    result = np.zeros(len(friction))
    for i in range(len(friction)):
        x = x_dot = 0.0
        for _ in range(cycles):
            for n in range(len(force)):
                limit = friction[i] * max(0.0, normal[n])
                x, x_dot, _ = slide(force[n], limit, limit, 1.0, total, x, x_dot, h)
        result[i] = x
    return result


@lru_cache(maxsize=2)
def _compiled(function: Callable[..., Any]) -> Any:
    """One of the two functions above, compiled."""
    return compile_cached(function)


@dataclass(frozen=True)
class SpeedMap:
    """Mean speed along one profile over a grid of plants.

    Attributes:
        profile: the profile's name.
        M: kg, shape (rows,).
        mu: friction coefficients, shape (columns,).
        speed: over five cycles from rest, cm/s, shape (rows, columns).
        smallest_normal_ratio: smallest N / ((M + m) g), shape (rows,); 0.0 or less means that contact is lost, and the
            speed beside it belongs to a floor without friction for as long as that lasts.
    """

    profile: str
    M: np.ndarray
    mu: np.ndarray
    speed: np.ndarray
    smallest_normal_ratio: np.ndarray


def grid(rows: int = 29, columns: int = 61) -> tuple[np.ndarray, np.ndarray]:
    """Evenly spaced M in kg over M_RANGE, and mu over MU_RANGE in equal ratios."""
    return np.linspace(*M_RANGE, rows), np.geomspace(*MU_RANGE, columns)


def speed_map(
    profile: Profile,
    M: Sequence[float] | np.ndarray,
    mu: Sequence[float] | np.ndarray,
    *,
    normal_force: NormalForce = "newton",
    cycles: int = CYCLES,
    h: float = MAP_STEP,
) -> SpeedMap:
    """Mean speed along a profile that is tracked exactly, for every M with every mu.

    Args:
        profile: what the pendulum follows.
        M: masses of the platform, kg.
        mu: friction coefficients.
        normal_force: as in `Capsule`.
        cycles: cycles from rest.
        h: integration step, s; divides the profile's period.

    Raises:
        TypeError: if M, mu or h is no number.
        ValueError: if one is out of range, or h does not divide the period.
    """
    h = check_number("h", h, "a finite number > 0 (s)", 0.0, open_low=True)
    if cycles < 1:
        raise ValueError(f"cycles must be at least 1, got {cycles!r}")
    steps = round(profile.period / h)
    if abs(steps * h - profile.period) > 1e-9:
        raise ValueError(f"h must divide the profile's period of {profile.period:g} s, got {h!r} s")
    masses = np.array([check_number("M", value, "a finite number > 0 (kg)", 0.0, open_low=True) for value in M])
    friction = np.array([check_number("mu", value, "a finite number >= 0", 0.0) for value in mu])
    if not len(masses) or not len(friction):
        raise ValueError(f"M and mu must hold at least one value each, got {len(masses)} and {len(friction)}")
    capsule = Capsule(normal_force=normal_force)
    # In the middle of the steps, where the jumps of theta_d'' do not lie.
    motion = profile.evaluate((np.arange(steps) + 0.5) * h)
    speed, smallest = np.empty((len(masses), len(friction))), np.empty(len(masses))
    for row, mass in enumerate(masses):
        capsule.check_plant(mass, friction.max())
        plant = capsule.plant(M=mass)
        total = plant.M + plant.m
        force, normal = _compiled(contact_loads)(*motion, plant)
        travelled = _compiled(displacements)(force, normal, friction, total, h, cycles)
        speed[row] = 100.0 * travelled / (cycles * profile.period)
        smallest[row] = normal.min() / (total * plant.g)
    return SpeedMap(profile.name, masses, friction, speed, smallest)


def turning_points(first: SpeedMap, second: SpeedMap) -> list[tuple[float, float]]:
    """Plants (M, mu) on the map's rows where the faster of two profiles changes; mu is interpolated in its logarithm.

    Raises:
        ValueError: if the maps do not share their grid.
    """
    if not (np.array_equal(first.M, second.M) and np.array_equal(first.mu, second.mu)):
        raise ValueError("both maps must have the same M and mu")
    lead = first.speed - second.speed
    logs = np.log(first.mu)
    points = []
    for row, mass in enumerate(first.M):
        for n in np.flatnonzero(lead[row, :-1] * lead[row, 1:] < 0.0):
            share = lead[row, n] / (lead[row, n] - lead[row, n + 1])
            points.append((float(mass), float(np.exp(logs[n] + share * (logs[n + 1] - logs[n])))))
    return points


@dataclass(frozen=True)
class StepStudy:
    """A run of the nominal plant at several steps.

    Attributes:
        profile: the profile's name.
        steps: s.
        speed: mean speed, cm/s.
        peak_torque: N m.
    """

    profile: str
    steps: np.ndarray
    speed: np.ndarray
    peak_torque: np.ndarray

    def errors(self) -> tuple[np.ndarray, np.ndarray]:
        """|difference| of speed (cm/s) and peak torque (N m) from the first, which is the finest, step."""
        return np.abs(self.speed - self.speed[0])[1:], np.abs(self.peak_torque - self.peak_torque[0])[1:]


def step_study(profile: Profile, steps: Sequence[float] = STEPS, law_step: float | None = None) -> StepStudy:
    """Five cycles under feedback linearisation with the true plant as nominal, in the environment's own simulation.

    Args:
        profile: what the pendulum follows.
        steps: integration steps, s, the finest first; each divides the law's step, and that one 20 ms.
        law_step: time that the torque is held, s; None gives the law the integrator's step, as a simulation with one
            fixed step for everything does.

    Raises:
        ValueError: if the steps do not grow or do not divide.
    """
    if len(steps) < 2 or (np.diff(steps) <= 0.0).any():
        raise ValueError(f"steps must hold at least two values that grow, got {tuple(steps)}")
    speed, torque = [], []
    plant = NOMINAL.plant()
    for step in steps:
        held = step if law_step is None else law_step
        times = np.arange(round(profile.period / held)) * held
        # The columns of the platform stay empty: this law does not read them, and shares its machine code by the count.
        table = np.zeros((len(times), len(COLUMNS)))
        table[:, :3] = np.stack(profile.evaluate(times), axis=1)
        controller = Controller("feedback-linearising", feedback_linearising_law(plant, K_P, K_V), table, dt=held)
        options = EnvConfig(
            controller=controller,
            randomization="none",
            torque_limit=UNLIMITED,
            residual_limit=0.0,
            control_dt=AGENT_STEP,
            physics_dt=step,
        )
        simulation = Simulation(1, options)
        everyone = np.zeros(1, np.int64)
        simulation.reset(everyone, M=[plant.M], mu=[plant.mu])
        for _ in range(round(CYCLES * profile.period / AGENT_STEP)):
            simulation.step(np.zeros((1, 1), np.float32), np.ones(1, np.bool_))
        metrics = simulation.metrics(everyone)
        speed.append(float(metrics["mean_speed"][0]))
        torque.append(float(metrics["peak_torque"][0]))
    return StepStudy(profile.name, np.array(steps), np.array(speed), np.array(torque))


@dataclass(frozen=True)
class ContactEffect:
    """What the paper's normal force (7) changes at the nominal mass.

    Attributes:
        profile: the profile's name.
        mu: friction coefficients.
        newton: mean speed with Newton's normal force, cm/s.
        paper: mean speed with the paper's, cm/s.
    """

    profile: str
    mu: np.ndarray
    newton: np.ndarray
    paper: np.ndarray


def contact_effect(profile: Profile, mu: Sequence[float] | np.ndarray) -> ContactEffect:
    """Mean speeds of the nominal mass with either normal force.

    Args:
        profile: what the pendulum follows.
        mu: friction coefficients.
    """
    newton, paper = (speed_map(profile, [NOMINAL.M], mu, normal_force=force) for force in NORMAL_FORCES)
    return ContactEffect(profile.name, newton.mu, newton.speed[0], paper.speed[0])


def friction_for(speeds: SpeedMap, M: float, speed: float) -> float:
    """The smallest friction coefficient at which a row of the map falls through a speed; NaN where it never does.

    Args:
        speeds: the map.
        M: mass of the platform, kg; one of the map's.
        speed: cm/s.
    """
    row = speeds.speed[int(np.flatnonzero(np.isclose(speeds.M, M))[0])]
    falls = np.flatnonzero((row[:-1] >= speed) & (row[1:] < speed))
    if not len(falls):
        return float("nan")
    n = int(falls[0])
    share = (row[n] - speed) / (row[n] - row[n + 1])
    return float(speeds.mu[n] * (speeds.mu[n + 1] / speeds.mu[n]) ** share)


def least_mass_in_contact(speeds: SpeedMap) -> float:
    """The platform mass in kg below which the profile lifts it off the floor, interpolated between the map's rows."""
    return float(np.interp(0.0, speeds.smallest_normal_ratio, speeds.M))
