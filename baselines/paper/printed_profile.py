"""The velocity profile (9) exactly as printed, phase by phase beside the one that is built."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from baselines.laws.profiles import P2, PROPOSED, TABLE_1, V1

ROMAN = ("I", "II", "III", "IV", "V", "VI", "VII")
SAMPLES = 10_001


@dataclass(frozen=True)
class PrintedPhase:
    """One phase of (9).

    Attributes:
        name: Roman numeral.
        printed: the formula as printed.
        begins: its velocity at the start of the phase, rad/s.
        ends: at its end, rad/s.
        built_begins: the same of the profile that is built, rad/s.
        built_ends: likewise, rad/s.
        turns: angle that the printed formula turns in the phase, rad.
        built_turns: that the built one turns, rad.
    """

    name: str
    printed: str
    begins: float
    ends: float
    built_begins: float
    built_ends: float
    turns: float
    built_turns: float

    @property
    def deviates(self) -> bool:
        """Whether the two differ by more than a thousandth of the peak."""
        gaps = (self.begins - self.built_begins, self.ends - self.built_ends)
        return max(abs(gap) for gap in gaps) > 1e-3 * V1


def printed_phases() -> tuple[PrintedPhase, ...]:
    """Every phase of (9) as printed, with the times of Table 1 and the built profile's V1, P2 and P3.

    omega is pi / (2 t1), with which phase I ends at P1 omega. Phase VI is printed for "[0, t5, t6)"; t5 to t6 is taken.
    """
    t1, t2, t3, t4, t5, t6, _ = TABLE_1
    omega, P3 = math.pi / (2.0 * t1), PROPOSED.restoring_speed
    formulas: list[tuple[str, Callable[[np.ndarray], np.ndarray]]] = [
        ("P1 omega sin(omega t)", lambda t: V1 * np.sin(omega * t)),
        ("P1 omega", lambda t: np.full_like(t, V1)),
        ("P1 omega sin(omega t - t2)", lambda t: V1 * np.sin(omega * t - t2)),
        ("(t3 - t) / (t3 - t2) P2", lambda t: (t3 - t) / (t3 - t2) * P2),
        ("(t3 - t) / (t4 - t3) P3", lambda t: (t3 - t) / (t4 - t3) * P3),
        ("-P3", lambda t: np.full_like(t, -P3)),
        ("(t6 - t) / (t5 - t6) P3", lambda t: (t6 - t) / (t5 - t6) * P3),
    ]
    rows = []
    edges = (0.0, *TABLE_1)
    for name, (text, formula), segment, begin, end in zip(
        ROMAN, formulas, PROPOSED.segments, edges[:-1], edges[1:], strict=True
    ):
        t = np.linspace(begin, end, SAMPLES)
        velocity = formula(t)
        turns = float((velocity.sum() - 0.5 * (velocity[0] + velocity[-1])) * (t[1] - t[0]))
        built = segment.velocity(np.array([0.0, segment.duration]))
        rows.append(
            PrintedPhase(
                name,
                text,
                begins=float(velocity[0]),
                ends=float(velocity[-1]),
                built_begins=float(built[0]),
                built_ends=float(built[1]),
                turns=turns,
                built_turns=float(segment.turned(np.float64(segment.duration))),
            )
        )
    return tuple(rows)
