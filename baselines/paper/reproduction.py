"""What the paper's Section 5 computes, computed anew: both profiles under (35), friction, contact and steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from baselines.laws.feedback_linearisation import feedback_linearising
from baselines.laws.profiles import EPC, PROPOSED, Profile
from baselines.paper import published, variations
from baselines.paper.traces import CYCLES, trace
from baselines.paper.variations import ContactEffect, StepStudy
from capsule_gym import Capsule
from capsule_gym.parameters import LAW_DT, NormalForce

Progress = Callable[[str], None]

CONTACTS: tuple[NormalForce, ...] = ("newton", "paper")
FRICTIONS = 241


@dataclass(frozen=True)
class Tracking:
    """Five cycles of a profile under feedback linearisation (35) with the true plant's constants, 1 kHz.

    Attributes:
        profile: its name.
        contact: the option for the normal force.
        peak_velocity: largest theta', rad/s.
        largest_angle_deg: degrees.
        mean_speed: cm/s.
        peak_torque: N m.
        energy: mechanical energy per cycle, J.
        cost_of_transport: energy / ((M + m) g distance).
        backward: travel backwards per cycle, cm.
        backward_ratio: travel backwards over forwards.
        error: rms of theta - theta_d, rad.
    """

    profile: str
    contact: str
    peak_velocity: float
    largest_angle_deg: float
    mean_speed: float
    peak_torque: float
    energy: float
    cost_of_transport: float
    backward: float
    backward_ratio: float
    error: float


def track(profile: Profile, contact: NormalForce = "newton", physics_dt: float = LAW_DT) -> Tracking:
    """Runs a profile under (35).

    Args:
        profile: what the pendulum follows.
        contact: the option for the normal force, of the plant and of the law.
        physics_dt: s.
    """
    capsule = Capsule(normal_force=contact)
    run = trace(feedback_linearising(profile, nominal=capsule), capsule=capsule, physics_dt=physics_dt)
    metrics = run.metrics
    ratio = metrics["backward_ratio"]
    backward = 100.0 * metrics["distance"] * ratio / (1.0 - ratio) / CYCLES
    return Tracking(
        profile.name,
        contact,
        metrics["largest_theta_dot"],
        math.degrees(metrics["largest_theta"]),
        metrics["mean_speed"],
        metrics["peak_torque"],
        metrics["energy"] / CYCLES,
        metrics["cost_of_transport"],
        backward,
        ratio,
        run.error_rms,
    )


@dataclass(frozen=True)
class FrictionFit:
    """Which friction would give a published speed, under exact tracking on the nominal mass.

    Attributes:
        profile: its name.
        speed: the published one, cm/s.
        mu: every coefficient in [0.003, 1] that gives it.
        ratio: range of speed over EPC's, over the coefficients at which EPC moves.
    """

    profile: str
    speed: float
    mu: tuple[float, ...]
    ratio: tuple[float, float]


def fit_friction() -> tuple[FrictionFit, ...]:
    """The friction that gives the published speed, for each profile."""
    frictions = np.geomspace(*variations.MU_RANGE, FRICTIONS)
    maps = [variations.speed_map(profile, [Capsule().M], frictions) for profile in (PROPOSED, EPC)]
    # Where EPC rests there is nothing to compare.
    moving = maps[1].speed[0] > variations.ALL_BUT_AT_REST
    fits = []
    for speeds, numbers in zip(maps, (published.PROPOSED, published.EPC), strict=True):
        target = numbers["mean_speed"].value
        row, logs = speeds.speed[0], np.log(frictions)
        fitting = []
        for n in np.flatnonzero((row[:-1] - target) * (row[1:] - target) < 0.0):
            share = (row[n] - target) / (row[n] - row[n + 1])
            fitting.append(float(np.exp(logs[n] + share * (logs[n + 1] - logs[n]))))
        ratio = row[moving] / maps[1].speed[0][moving]
        fits.append(FrictionFit(speeds.profile, target, tuple(fitting), (float(ratio.min()), float(ratio.max()))))
    return tuple(fits)


@dataclass(frozen=True)
class Reproduction:
    """What is computed for the comparison under (35).

    Attributes:
        tracking: both profiles with both options for the normal force.
        refined: the same with Newton's normal force and ten times smaller physics steps.
        frictions: which friction would give the published speeds.
        contacts: speeds with either normal force over mu.
        steps: law and physics at one step.
        physics_steps: physics at a step, the law at 10 ms.
    """

    tracking: tuple[Tracking, ...]
    refined: tuple[Tracking, ...]
    frictions: tuple[FrictionFit, ...]
    contacts: tuple[ContactEffect, ...]
    steps: tuple[StepStudy, ...]
    physics_steps: tuple[StepStudy, ...]

    def run(self, profile: str, contact: str = "newton") -> Tracking:
        """The run of a profile with an option for the normal force."""
        return next(run for run in self.tracking if (run.profile, run.contact) == (profile, contact))


def reproduce(progress: Progress | None = None) -> Reproduction:
    """Runs everything; a few seconds.

    Args:
        progress: is told what begins.
    """
    tell = progress or (lambda name: None)
    profiles = (PROPOSED, EPC)
    tell("both profiles under feedback linearisation")
    tracking = tuple(track(profile, contact) for profile in profiles for contact in CONTACTS)
    refined = tuple(track(profile, physics_dt=1e-4) for profile in profiles)
    tell("friction and contact")
    frictions = fit_friction()
    contacts = tuple(variations.contact_effect(profile, (0.003, 0.01, 0.03, 0.1, 0.3)) for profile in profiles)
    tell("integration steps")
    return Reproduction(
        tracking,
        refined,
        frictions,
        contacts,
        steps=tuple(variations.step_study(profile) for profile in profiles),
        physics_steps=tuple(variations.step_study(profile, law_step=variations.STEPS[-1]) for profile in profiles),
    )
