"""Profiles of other shapes with the same published times, peak and swing.

The paper gives of EPC the times alone, so that its shape is assumed; the form of the proposed profile's phase III is
mended. Each alternative here keeps what is published and changes what is not, P2 following from the swing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from baselines.laws.profiles import EPC, PROPOSED, Profile, Segment
from baselines.paper.variations import speed_map
from capsule_gym.parameters import NOMINAL

# From 0 to the first velocity, and from the first to the second, rad/s, in the given time, s.
Rise = Callable[[float, float], Segment]
Fall = Callable[[float, float, float], Segment]


def linear(duration: float, start: float, end: float) -> Segment:
    """At a constant acceleration."""
    return Segment(duration, offset=start, slope=(end - start) / duration)


def half_cosine(duration: float, start: float, end: float) -> Segment:
    """Without a jump of the acceleration at either end."""
    half = 0.5 * (start - end)
    return Segment(duration, amplitude=half, phase=0.5 * math.pi, rate=math.pi / duration, offset=start - half)


def levelling(duration: float, start: float, end: float) -> Segment:
    """Steep at first and level at its end, as an exponential decay."""
    rate = 0.5 * math.pi / duration
    return Segment(duration, amplitude=end - start, rate=rate, offset=start)


def cosine_to(duration: float, start: float, end: float) -> Segment:
    """Level at first: phase III of (9)."""
    rate = math.acos(end / start) / duration
    return Segment(duration, amplitude=start, phase=0.5 * math.pi, rate=rate)


def quarter_sine(duration: float, peak: float) -> Segment:
    """Phase I of (9)."""
    return Segment(duration, amplitude=peak, rate=0.5 * math.pi / duration)


@dataclass(frozen=True)
class ShapeSpeed:
    """What one shape makes of a profile under exact tracking on the nominal plant.

    Attributes:
        profile: "proposed" or "EPC".
        shape: in words.
        assumed: whether it is the one used everywhere else.
        P2: that gives the published swing, rad/s.
        mean_speed: over five cycles from rest, cm/s.
    """

    profile: str
    shape: str
    assumed: bool
    P2: float
    mean_speed: float


def epc_alternative(rise: Rise, fall: Fall) -> Profile:
    """EPC with other phases I and II.

    Args:
        rise: of phase I, from rest to the published peak.
        fall: of phase II.
    """
    V1, (first, second, third, *_) = _peak(EPC), _durations(EPC)
    return _calibrated(EPC, 3, lambda P2: [rise(first, V1), fall(second, V1, P2), linear(third, P2, 0.0)])


def proposed_alternative(fall: Fall) -> Profile:
    """The proposed profile with another phase III.

    Args:
        fall: of phase III.
    """
    V1, (_, _, third, fourth, *_) = _peak(PROPOSED), _durations(PROPOSED)
    head = PROPOSED.segments[:2]
    return _calibrated(PROPOSED, 4, lambda P2: [*head, fall(third, V1, P2), linear(fourth, P2, 0.0)])


ALTERNATIVES: tuple[tuple[str, Callable[[], Profile]], ...] = (
    ("as assumed: quarter sine, then linear", lambda: EPC),
    ("linear rise, linear fall", lambda: epc_alternative(lambda d, V1: linear(d, 0.0, V1), linear)),
    ("half-cosine rise, half-cosine fall", lambda: epc_alternative(lambda d, V1: half_cosine(d, 0.0, V1), half_cosine)),
    ("quarter sine, fall as phase III of (9)", lambda: epc_alternative(quarter_sine, cosine_to)),
    ("quarter sine, fall that levels off", lambda: epc_alternative(quarter_sine, levelling)),
    ("as mended: (9) with a phase in III", lambda: PROPOSED),
    ("III linear", lambda: proposed_alternative(linear)),
    ("III half a cosine", lambda: proposed_alternative(half_cosine)),
    ("III levels off", lambda: proposed_alternative(levelling)),
)


def shape_speeds() -> tuple[ShapeSpeed, ...]:
    """The mean speeds of every shape, exact tracking, nominal plant."""
    rows = []
    for shape, make in ALTERNATIVES:
        profile = make()
        speed = float(speed_map(profile, [NOMINAL.M], [NOMINAL.mu]).speed[0, 0])
        P2 = _end(profile.segments[2] if profile.name == PROPOSED.name else profile.segments[1])
        rows.append(ShapeSpeed(profile.name, shape, profile in (EPC, PROPOSED), P2, speed))
    return tuple(rows)


def _peak(profile: Profile) -> float:
    """V1, rad/s: the end of phase I."""
    return _end(profile.segments[0])


def _end(segment: Segment) -> float:
    """The velocity at a segment's end, rad/s."""
    return float(segment.velocity(np.float64(segment.duration)))


def _durations(profile: Profile) -> list[float]:
    """Of the phases, s."""
    return [segment.duration for segment in profile.segments]


def _swept(segments: Sequence[Segment]) -> float:
    """Angle that segments turn, rad."""
    return float(sum(segment.turned(np.float64(segment.duration)) for segment in segments))


def _calibrated(profile: Profile, count: int, progressive: Callable[[float], list[Segment]]) -> Profile:
    """A profile with other first phases, whose P2 gives the same swing: the return is then the same.

    Args:
        profile: whose return and start it takes.
        count: number of phases before the pendulum turns back.
        progressive: these phases for a P2 in rad/s.
    """
    asked = _swept(profile.segments[:count])
    low, high = 0.0, _peak(profile)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _swept(progressive(middle)) < asked else (low, middle)
    return replace(profile, segments=(*progressive(high), *profile.segments[count:]))
