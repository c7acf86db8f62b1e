"""The reference of the control laws: a pendulum's profile and the nominal platform's motion.

The profiles are the paper's, with seven phases (9), and EPC's, with six. A profile is a sequence of
segments theta_d' = A sin(phase + rate s) + offset + slope s, with s from the start of the segment.
Angle and acceleration are computed in closed form.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from capsule_gym.checks import check_number
from capsule_gym.control.controller import LAW_DT
from capsule_gym.core import _core, native
from capsule_gym.core.elementary import arccos, sincos
from capsule_gym.parameters import Plant
from capsule_gym.tasks.task import START_THETA

# Results of `python -m baselines.paper.optimal_profiles`.
OPTIMA = Path(__file__).parents[2] / "data" / "laws" / "optimal_profiles.json"
# Length of a step of the nominal platform, s; the error is then below 1e-8 m.
FINE_DT = 2e-5

COLUMNS = ("theta_d", "theta_d_dot", "theta_d_ddot", "x_d", "x_d_dot", "x_d_ddot", "cycle_start")


@dataclass(frozen=True)
class Segment:
    """One phase: theta_d'(s) = amplitude sin(phase + rate s) + offset + slope s.

    The time s goes from 0 to `duration`; SI units.
    """

    duration: float
    amplitude: float = 0.0
    phase: float = 0.0
    rate: float = 1.0
    offset: float = 0.0
    slope: float = 0.0

    def velocity(self, s: np.ndarray) -> np.ndarray:
        """theta_d' in rad/s."""
        sines, _ = sincos(self.phase + self.rate * s)
        return self.amplitude * sines + self.offset + self.slope * s

    def acceleration(self, s: np.ndarray) -> np.ndarray:
        """theta_d'' in rad/s^2."""
        _, cosines = sincos(self.phase + self.rate * s)
        return self.amplitude * self.rate * cosines + self.slope

    def turned(self, s: np.ndarray) -> np.ndarray:
        """Angle since the start of the segment, rad."""
        _, first_cosine = sincos(self.phase)
        _, cosines = sincos(self.phase + self.rate * s)
        sine = self.amplitude / self.rate * (first_cosine - cosines)
        return sine + (self.offset + 0.5 * self.slope * s) * s


def _ramp(duration: float, start: float, end: float) -> Segment:
    """A segment whose velocity changes linearly from start to end."""
    return Segment(duration, offset=start, slope=(end - start) / duration)


def _rise(duration: float, end: float) -> Segment:
    """A quarter of a sine from rest to the velocity end."""
    return Segment(duration, amplitude=end, rate=math.pi / (2.0 * duration))


@dataclass(frozen=True)
class Profile:
    """A closed cycle of the pendulum.

    Attributes:
        name: name in tables and figures.
        segments: the phases, in order.
        start: angle at the start of the cycle, rad.
    """

    name: str
    segments: tuple[Segment, ...]
    start: float = START_THETA

    @property
    def times(self) -> np.ndarray:
        """The ends of the phases t1, t2, .. in s."""
        return np.cumsum([segment.duration for segment in self.segments])

    @property
    def period(self) -> float:
        """Length of the cycle, s."""
        return float(self.times[-1])

    def evaluate(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """theta_d (rad), theta_d' (rad/s) and theta_d'' (rad/s^2) at times t (s) of any cycle.

        At the edge of a phase the acceleration is that of the phase that begins.
        """
        ends = self.times
        starts = np.append(0.0, ends)
        local = np.mod(np.asarray(t, np.float64), self.period)
        phase = np.searchsorted(ends, local, side="right")
        phase = np.minimum(phase, len(ends) - 1)
        return self.evaluate_phases(phase, local - starts[phase])

    def evaluate_phases(
        self, phase: np.ndarray, s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`evaluate` at times s (s) from the starts of phases, which are numbered from 0."""
        numbers = np.array([astuple(segment) for segment in self.segments]).T
        durations = numbers[0]
        # Segments of arrays: of all phases, then of the phase of every time.
        turned = Segment(*numbers).turned(durations)
        segment = Segment(*numbers[:, phase])
        reached = np.cumsum([self.start, *turned])[phase]
        return reached + segment.turned(s), segment.velocity(s), segment.acceleration(s)


def _durations(times: Sequence[float], count: int, V1: float, P2: float) -> list[float]:
    """The durations of the phases between the times, after a check of times and velocities."""
    if not 0.0 < P2 < V1:
        raise ValueError(f"P2 must be between 0 and V1, got P2={P2!r}, V1={V1!r}")
    if len(times) != count:
        raise ValueError(f"times must be t1 to t{count}, got {len(times)} values")
    ends = [check_number("times", t, "finite numbers > 0 (s)", 0.0, open_low=True) for t in times]
    durations = np.diff([0.0, *ends])
    if (durations <= 0.0).any():
        raise ValueError(f"times must increase, got {tuple(times)}")
    return durations.tolist()


def _closed(name: str, progressive: Sequence[Segment], durations: Sequence[float]) -> Profile:
    """A profile that ends with the slow return: down to -P3, hold, and back to zero.

    P3 closes the cycle.
    """
    down, hold, back = durations
    swept = math.fsum(segment.turned(np.float64(segment.duration)) for segment in progressive)
    P3 = swept / (0.5 * down + hold + 0.5 * back)
    returning = (_ramp(down, 0.0, -P3), Segment(hold, offset=-P3), _ramp(back, -P3, 0.0))
    return Profile(name, (*progressive, *returning))


def seven_phases(times: Sequence[float], V1: float, P2: float, name: str = "proposed") -> Profile:
    """The paper's profile (9).

    Args:
        times: t1 to t7, s.
        V1: peak velocity P1 omega, rad/s.
        P2: velocity at t3, rad/s.
        name: name in tables and figures.

    Raises:
        ValueError: if the times do not increase, or P2 is not between 0 and V1.
    """
    rise, hold, fall, brake, *returning = _durations(times, 7, V1, P2)
    progressive = [
        _rise(rise, V1),
        Segment(hold, offset=V1),
        Segment(fall, amplitude=V1, phase=math.pi / 2.0, rate=arccos(P2 / V1) / fall),
        _ramp(brake, P2, 0.0),
    ]
    return _closed(name, progressive, returning)


def optimal(torque_limit: float, dropped: int = 0) -> Profile:
    """The fastest known profile (9) on the nominal plant under exact tracking.

    Args:
        torque_limit: torque limit of the search, N m: 0.54, 1 or 1.5.
        dropped: number of the principle that the search ignored, 2, 3 or 4; 0 for none.
    """
    problem = {"torque_limit": torque_limit, "plants": "nominal", "dropped": dropped}
    solutions = json.loads(OPTIMA.read_text(encoding="utf-8"))["solutions"]
    found = next(each for each in solutions if each["problem"] == problem)
    return seven_phases(found["times"], found["V1"], found["P2"], "optimal")


def six_phases(times: Sequence[float], V1: float, P2: float) -> Profile:
    """The profile of the EPC system, with which the paper compares.

    The arguments are those of `seven_phases`, with t1 to t6 and P2 at t2.
    """
    rise, fall, brake, *returning = _durations(times, 6, V1, P2)
    progressive = [_rise(rise, V1), _ramp(fall, V1, P2), _ramp(brake, P2, 0.0)]
    return _closed("EPC", progressive, returning)


# Table 1: t1 to t7, and t1 to t6 of EPC, s.
TABLE_1 = (0.133, 0.195, 0.27, 0.9, 1.7, 5.8, 6.6)
TABLE_1_EPC = (0.1, 0.33, 0.9, 1.4, 5.8, 6.6)
# Published peak velocities, rad/s.
V1 = 7.8
V1_EPC = 11.0
# P2 is not published: calibrated to the published largest angle, rad/s.
P2 = 2.122
P2_EPC = 1.451

PROPOSED = seven_phases(TABLE_1, V1, P2)
EPC = six_phases(TABLE_1_EPC, V1_EPC, P2_EPC)


def platform_motion(
    angle: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray, h: float, p: Plant
) -> np.ndarray:
    """x, x' and x'' of the platform along a motion of the pendulum: the second row of Eq. (1).

    The pendulum's angle (rad), velocity and acceleration are given at every h seconds, shape (n,).
    The environment's step is not used, only its functions for the forces, which are constant over
    h. Viscous friction and the Stribeck curve are left out.

    Returns:
        Shape (3, n), from rest at x = 0: m, m/s, m/s^2.
    """
    pendulum = [np.ascontiguousarray(each, np.float64) for each in (angle, velocity, acceleration)]
    plant = native.ordered(_core.PLANT, p._asdict())
    motion = np.zeros((3, len(angle)))
    native.call("platform_motion", *pendulum, len(angle), float(h), plant, motion)
    return motion


@lru_cache(maxsize=16)
def reference_table(profile: Profile, nominal: Plant, dt: float = LAW_DT) -> np.ndarray:
    """One cycle of a profile, sampled every dt (s); x_d is the nominal platform's.

    Returns:
        Shape (steps, 7), float64, columns COLUMNS; read-only.

    Raises:
        TypeError: if dt is not a number.
        ValueError: if dt is not positive, or the profile's period is not a multiple of it.
    """
    dt = check_number("dt", dt, "a finite number > 0 (s)", 0.0, open_low=True)
    steps = round(profile.period / dt)
    if abs(steps * dt - profile.period) > 1e-9:
        raise ValueError(
            f"the profile's period must be a multiple of dt = {dt!r} s, got {profile.period!r} s"
        )
    fine = max(1, round(dt / FINE_DT))
    h = dt / fine
    # The middles of the fine steps: theta_d'' jumps at the edges of the phases.
    middles = (np.arange(steps * fine) + 0.5) * h
    platform = platform_motion(*profile.evaluate(middles), h, nominal)
    pendulum = profile.evaluate(np.arange(steps) * dt)
    table = np.zeros((steps, len(COLUMNS)))
    table[:, :3] = np.transpose(pendulum)
    table[:, 3:6] = platform[:, ::fine].T
    table[0, 6] = 1.0
    table.setflags(write=False)
    return table
