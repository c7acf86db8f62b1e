"""The course of an episode at the rate of its torque, the steady cycle in it, and the balance of that cycle."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from agents.evaluation.policies import Policy
from capsule_gym.evaluation_sets import EPISODE_SETTINGS, NOMINAL_PLANT, PlantSpec
from capsule_gym.parameters import DIRECT_PHYSICS_DT, NOMINAL, EnvConfig
from capsule_gym.task import CONTROL_DT, HORIZON

# The cycle is sought in the last so many seconds: three of the paper's cycles, of 6.6 s, and a little.
WINDOW = 20.0
# A steady motion may need so many swings to come back; the fewest count that do nearly as well as the best.
MOST_SWINGS = 6
NEARLY = 1.25
# States closer than this, in standard deviations, count as the same: what a section between samples leaves open.
SAME = 0.02
FORWARD, STICK, BACKWARD = 1, 0, -1


@dataclass(frozen=True, eq=False)
class Course:
    """One episode, a sample per period of the torque; the first is the start.

    Attributes:
        name: of the policy.
        t: s, shape (n,).
        theta: rad.
        theta_dot: rad/s.
        x: m.
        x_dot: m/s; exactly 0.0 in stick.
        torque: the motor's in the period that ends at t, N m.
        normal_force: the smallest in that period, N.
        torque_limit: N m.
        failed: whether the episode ended before its time.
    """

    name: str
    t: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    x: np.ndarray
    x_dot: np.ndarray
    torque: np.ndarray
    normal_force: np.ndarray
    torque_limit: float
    failed: bool

    @property
    def dt(self) -> float:
        """Seconds between samples."""
        return float(self.t[1] - self.t[0])

    def cut(self, first: int, last: int) -> Course:
        """The samples from `first` to `last`, both included, with the time and the place counted from the first."""
        part = slice(first, last + 1)
        series: dict[str, Any] = {
            each.name: getattr(self, each.name)[part]
            for each in fields(self)
            if isinstance(getattr(self, each.name), np.ndarray)
        }
        rest = {"t": series["t"] - self.t[first], "x": series["x"] - self.x[first]}
        return Course(**{**series, **rest}, name=self.name, torque_limit=self.torque_limit, failed=self.failed)


def follow(name: str, policy: Policy, plant: PlantSpec = NOMINAL_PLANT, *, seconds: float = HORIZON) -> Course:
    """Runs a policy on one plant and records every period of its torque: the motion is that of its episode.

    Args:
        name: for tables.
        policy: what acts, as often as in its own environment.
        plant: without jumps.
        seconds: length of the recording.
    """
    # Here, since numba comes with it, which takes most of a second to import.
    from capsule_gym.layout import Row
    from capsule_gym.simulation import Simulation, divide

    names = {each.name for each in fields(EnvConfig)}
    settings = {key: value for key, value in {**policy.env_kwargs, **EPISODE_SETTINGS}.items() if key in names}
    whole = Simulation(1, EnvConfig(**settings))
    # The torque is held for a period of the law, or, without one, for many steps of the integrator.
    dt = whole.controller.dt if whole.controller else settings.get("physics_dt") or DIRECT_PHYSICS_DT
    control_dt = settings.get("control_dt", CONTROL_DT)
    hold = divide("control_dt", control_dt, "a period of the torque", dt)
    simulation = Simulation(1, EnvConfig(**{**settings, "control_dt": dt}))
    only = np.zeros(1, np.int64)
    simulation.reset(only, M=[plant.M], mu=[plant.mu], state=np.array([(plant.theta, 0.0, 0.0, 0.0)]))
    act = policy.start([plant.seed])
    steps = round(seconds / dt)
    wanted = (Row.theta, Row.theta_dot, Row.x, Row.x_dot, Row.torque, Row.normal_force)
    samples = [[simulation.row(row)[0] for row in wanted]]
    action, failed = np.zeros(1), False
    for n in range(steps):
        if n % hold == 0:
            action = act(simulation.observations.copy())[:, 0].astype(np.float64)
        simulation.step(action)
        samples.append([simulation.row(row)[0] for row in wanted])
        failed = simulation.row(Row.termination)[0] != 0.0
        if failed:
            break
    theta, theta_dot, x, x_dot, torque, normal_force = np.array(samples).T
    return Course(
        name=name,
        t=np.arange(len(samples)) * dt,
        theta=theta,
        theta_dot=theta_dot,
        x=x,
        x_dot=x_dot,
        torque=torque,
        normal_force=normal_force,
        torque_limit=whole.settings.torque_limit,
        failed=bool(failed),
    )


@dataclass(frozen=True, eq=False)
class Cycle:
    """One cycle of a motion that is steady, or as nearly as it gets.

    Attributes:
        course: its samples, the first and the last one cycle apart; it begins where theta is smallest.
        swings: how many times the pendulum swings to and fro in it.
        mismatch: how far the state is from where it was a cycle before: the larger of the changes of theta_dot and
            x_dot over their standard deviations.
        window_speed: the mean speed over the window that the cycle was found in, cm/s.
    """

    course: Course
    swings: int
    mismatch: float
    window_speed: float


def find_cycle(course: Course, window: float = WINDOW) -> Cycle:
    """The cycle at the end of an episode that comes closest to closing.

    Whenever theta rises through the middle of its range a swing begins. The cycle is the smallest number of swings
    after which the motion nearly repeats itself.

    Args:
        course: long enough for the window.
        window: the seconds at the end that are searched.

    Raises:
        ValueError: if the episode failed, is shorter than the window, or holds no two swings there.
    """
    if course.failed or course.t[-1] < window:
        raise ValueError(f"course must last for {window:g} s without failure, got {course.name} until {course.t[-1]:g}")
    first = len(course.t) - 1 - round(window / course.dt)
    theta = course.theta[first:]
    middle = 0.5 * (theta.min() + theta.max())
    rises = first + 1 + np.flatnonzero((theta[:-1] < middle) & (theta[1:] >= middle))
    deviations = np.array([course.theta_dot[first:].std(), course.x_dot[first:].std()])
    if len(rises) < 2 or not (deviations > 0.0).all():
        raise ValueError(f"course must swing at least twice in its last {window:g} s, got {course.name}")
    states = np.array([course.theta_dot[rises], course.x_dot[rises]]) / deviations[:, None]
    gaps = {
        n: np.abs(states[:, n:] - states[:, :-n]).max(axis=0) for n in range(1, min(MOST_SWINGS, len(rises) - 1) + 1)
    }
    typical = {n: float(np.median(gap)) for n, gap in gaps.items()}
    swings = next(n for n in typical if typical[n] <= max(SAME, NEARLY * min(typical.values())))
    # Its beginning is moved to the smallest theta within it, so that the samples must reach further.
    fits = [i for i in range(len(gaps[swings])) if 2 * rises[i + swings] - rises[i] < len(course.t)]
    if not fits:
        raise ValueError(f"course must hold two cycles in its last {window:g} s, got {course.name}")
    i = min(fits, key=lambda i: gaps[swings][i])
    length = rises[i + swings] - rises[i]
    begin = int(rises[i] + np.argmin(course.theta[rises[i] : rises[i + swings]]))
    speed = 100.0 * (course.x[-1] - course.x[first]) / (course.t[-1] - course.t[first])
    return Cycle(course.cut(begin, begin + int(length)), swings, float(gaps[swings][i]), float(speed))


@dataclass(frozen=True)
class Phase:
    """What happens in one phase of the contact, over a cycle.

    Attributes:
        time: share of the cycle.
        travel: m, negative backwards.
        press: mean normal force over (M + m) g; NaN where there is no such phase.
        press_over_way: the same, as a mean over the way and not over the time; NaN where there is no way.
        impulse: of the friction, N s, positive forwards.
    """

    time: float
    travel: float
    press: float
    press_over_way: float
    impulse: float


@dataclass(frozen=True)
class Balance:
    """Where the speed of a cycle comes from.

    Attributes:
        period: s.
        speed: mean over the cycle, cm/s.
        swing: largest minus smallest theta, rad.
        saturated: share of the time at the torque limit.
        glide: smallest and largest speed of the centre of mass of platform and pendulum, cm/s.
        phases: by FORWARD, STICK and BACKWARD.
    """

    period: float
    speed: float
    swing: float
    saturated: float
    glide: tuple[float, float]
    phases: dict[int, Phase]


def contact(course: Course) -> np.ndarray:
    """The phase of the contact between one sample and the next, shape (n - 1,): FORWARD, STICK or BACKWARD."""
    return np.sign(np.diff(course.x)).astype(np.int64)


def balance(cycle: Cycle, plant: PlantSpec = NOMINAL_PLANT) -> Balance:
    """Adds a cycle up, phase by phase.

    The impulse of friction is the change of the horizontal momentum of platform and pendulum, on which nothing else
    acts: over a cycle that closes the impulses of the phases cancel.

    Args:
        cycle: with the paper's pendulum.
        plant: the platform's mass and friction.
    """
    course, m, l = cycle.course, NOMINAL.m, NOMINAL.l
    momentum = (plant.M + m) * course.x_dot - m * l * np.cos(course.theta) * course.theta_dot
    gained, moved, phase = np.diff(momentum), np.diff(course.x), contact(course)
    weight = (plant.M + m) * NOMINAL.g
    phases = {}
    for each in (FORWARD, STICK, BACKWARD):
        own = phase == each
        load, way = course.normal_force[1:][own] / weight, np.abs(moved[own])
        phases[each] = Phase(
            time=float(own.mean()),
            travel=float(moved[own].sum()),
            press=float(load.mean()) if own.any() else float("nan"),
            press_over_way=float((load * way).sum() / way.sum()) if way.sum() > 0.0 else float("nan"),
            impulse=float(gained[own].sum()),
        )
    return Balance(
        period=float(course.t[-1]),
        speed=100.0 * float(course.x[-1] / course.t[-1]),
        swing=float(np.ptp(course.theta)),
        saturated=float((np.abs(course.torque[1:]) >= course.torque_limit).mean()),
        glide=(100.0 * float(momentum.min()) / (plant.M + m), 100.0 * float(momentum.max()) / (plant.M + m)),
        phases=phases,
    )


def stretches(phase: np.ndarray) -> list[tuple[int, int, int]]:
    """Runs of the same phase: the phase, its first sample and its last."""
    found, n = [], 0
    for each, group in itertools.groupby(phase.tolist()):
        count = len(list(group))
        found.append((each, n, n + count))
        n += count
    return found
