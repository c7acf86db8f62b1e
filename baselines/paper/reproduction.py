"""What the paper's Section 5 computes, computed anew: both profiles under (35), the adaptive law over its ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from baselines.laws.adaptive import adaptive, adaptive_as_published, eta_of
from baselines.laws.feedback_linearisation import feedback_linearising
from baselines.laws.profiles import EPC, PROPOSED, Profile
from baselines.paper import published, sensitivity
from baselines.paper.adaptation import Course, Descent, courses, descent, law_terms
from baselines.paper.sensitivity import ContactEffect, StepStudy
from baselines.paper.traces import CYCLES, UNLIMITED, Trace, trace, traces
from capsule_gym import Capsule
from capsule_gym.parameters import NormalForce
from capsule_gym.task import TORQUE_LIMIT

Progress = Callable[[str], None]

CONTACTS: tuple[NormalForce, ...] = ("newton", "paper")
GRID = 5
FRICTIONS = 241


@dataclass(frozen=True)
class Tracking:
    """Five cycles of a profile under feedback linearisation (35) with the true plant's constants, 1 kHz.

    Attributes:
        profile: its name.
        contact: the option for the normal force.
        peak_velocity: largest theta', rad/s.
        swing: largest angle, degrees.
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
    swing: float
    mean_speed: float
    peak_torque: float
    energy: float
    cost_of_transport: float
    backward: float
    backward_ratio: float
    error: float


def track(profile: Profile, contact: NormalForce = "newton", physics_dt: float = 1e-3) -> Tracking:
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
        _rms(run.theta - run.theta_d),
    )


@dataclass(frozen=True)
class AdaptiveRun:
    """Five cycles of the adaptive law (39) on one plant.

    Attributes:
        M: kg.
        mu: friction coefficient.
        until: how far it came, s.
        ending: what ended it early; empty where nothing did.
        error_rms: of theta - theta_d, rad.
        error_max: largest |theta - theta_d|, rad.
        peak_velocity: largest theta', rad/s.
        peak_torque: N m.
        mean_speed: over the time that it ran, cm/s.
        drift: largest |x - x_d|, m.
        auxiliary_torque: largest |T_n|, N m.
        eta: at its end.
        sliding_first: largest |delta_theta| in the first cycle, rad/s.
        sliding_last: in the last whole one, rad/s; None where the run did not last.
    """

    M: float
    mu: float
    until: float
    ending: str
    error_rms: float
    error_max: float
    peak_velocity: float
    peak_torque: float
    mean_speed: float
    drift: float
    auxiliary_torque: float
    eta: float
    sliding_first: float
    sliding_last: float | None


@dataclass(frozen=True)
class LawStudy:
    """One form of the adaptive law over the grid of the paper's ranges.

    Attributes:
        law: "regularised" or "as published".
        torque_limit: N m.
        runs: one per plant, M the slower index.
    """

    law: str
    torque_limit: float
    runs: tuple[AdaptiveRun, ...]

    @property
    def failures(self) -> int:
        """Number of runs that ended early."""
        return sum(bool(run.ending) for run in self.runs)

    def worst(self, quantity: str, *, smallest: bool = False) -> AdaptiveRun:
        """The run with the largest, or the smallest, value of one of its numbers."""
        return (min if smallest else max)(self.runs, key=lambda run: float(getattr(run, quantity)))


@dataclass(frozen=True)
class Adaptation:
    """The inside of the adaptive law on one plant.

    Attributes:
        law: "regularised" or "as published".
        M: kg.
        mu: friction coefficient.
        courses: of the estimates and of eta.
        descent: of the Lyapunov function.
    """

    law: str
    M: float
    mu: float
    courses: tuple[Course, ...]
    descent: Descent


def plant_grid() -> list[tuple[float, float]]:
    """The plants (M, mu) of the adaptive runs: 5 x 5 over the paper's ranges, corners and centre included."""
    masses, frictions = (np.linspace(*limits, GRID).tolist() for limits in (published.M_RANGE, published.MU_RANGE))
    return [(M, mu) for M in masses for mu in frictions]


def study_law(as_published: bool, torque_limit: float = UNLIMITED) -> tuple[LawStudy, tuple[Adaptation, ...]]:
    """Runs one form of the adaptive law over the grid, and looks inside it at the nominal plant and the corners.

    Args:
        as_published: which form.
        torque_limit: N m.
    """
    law = "as published" if as_published else "regularised"
    controller = adaptive_as_published() if as_published else adaptive()
    plants = plant_grid()
    looked_at = {(0.5, 0.01), *((M, mu) for M in published.M_RANGE for mu in published.MU_RANGE)}
    runs, inside = [], []
    # Row by row: a run with its memory takes 10 MB.
    for row in range(0, len(plants), GRID):
        batch = plants[row : row + GRID]
        for (M, mu), run in zip(batch, traces(controller, batch, torque_limit=torque_limit), strict=True):
            runs.append(_adaptive_run(run, M, mu, as_published))
            if any(math.isclose(M, M_1) and math.isclose(mu, mu_1) for M_1, mu_1 in looked_at):
                plant = Capsule().plant(M, mu)
                fall = descent(run, plant, as_published=as_published)
                inside.append(Adaptation(law, M, mu, tuple(courses(run, plant)), fall))
    return LawStudy(law, torque_limit, tuple(runs)), tuple(inside)


def _adaptive_run(run: Trace, M: float, mu: float, as_published: bool) -> AdaptiveRun:
    """The numbers of one run."""
    terms = law_terms(run, as_published=as_published)
    sliding = np.abs(terms.delta_theta)
    cycle = round((len(run.t) - 1) / CYCLES) if run.completed else len(run.t)
    ending = ""
    if not run.completed:
        ending = "pendulum at the platform" if abs(run.theta[-1]) >= 0.5 * math.pi else "contact lost"
    return AdaptiveRun(
        M,
        mu,
        until=float(run.t[-1]),
        ending=ending,
        error_rms=_rms(run.theta - run.theta_d),
        error_max=float(np.abs(run.theta - run.theta_d).max()),
        peak_velocity=float(run.theta_dot.max()),
        peak_torque=run.metrics["peak_torque"],
        mean_speed=100.0 * run.metrics["distance"] / run.metrics["duration"],
        drift=float(np.abs(terms.error_x).max()),
        auxiliary_torque=float(np.abs(terms.T_n).max()),
        eta=float(eta_of(run.memory[-1])),
        sliding_first=float(sliding[:cycle].max()),
        sliding_last=float(sliding[-cycle:].max()) if run.completed else None,
    )


def _rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


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
    frictions = np.geomspace(*sensitivity.MU_RANGE, FRICTIONS)
    maps = [sensitivity.speed_map(profile, [Capsule().M], frictions) for profile in (PROPOSED, EPC)]
    # Where EPC rests there is nothing to compare.
    moving = maps[1].speed[0] > sensitivity.ALL_BUT_AT_REST
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
    """Everything that is computed for the comparison, besides proofs and Table 1.

    Attributes:
        tracking: both profiles with both options for the normal force.
        refined: the same with Newton's normal force and ten times smaller physics steps.
        laws: the adaptive law over the grid: regularised, as published, as published with the motor's torque limited.
        inside: estimates, eta and Lyapunov function of the first two at the nominal plant and the corners.
        frictions: which friction would give the published speeds.
        contacts: speeds with either normal force over mu.
        steps: law and physics at one step.
        physics_steps: physics at a step, the law at 10 ms.
    """

    tracking: tuple[Tracking, ...]
    refined: tuple[Tracking, ...]
    laws: tuple[LawStudy, ...]
    inside: tuple[Adaptation, ...]
    frictions: tuple[FrictionFit, ...]
    contacts: tuple[ContactEffect, ...]
    steps: tuple[StepStudy, ...]
    physics_steps: tuple[StepStudy, ...]

    def run(self, profile: str, contact: str = "newton") -> Tracking:
        """The run of a profile with an option for the normal force."""
        return next(run for run in self.tracking if (run.profile, run.contact) == (profile, contact))

    def adaptation(self, law: str, M: float, mu: float) -> Adaptation:
        """What was looked at inside a law on one plant."""
        return next(a for a in self.inside if a.law == law and math.isclose(a.M, M) and math.isclose(a.mu, mu))


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
    tell("the regularised adaptive law")
    regularised, inside = study_law(as_published=False)
    tell("the adaptive law as published")
    as_published, inside_published = study_law(as_published=True)
    limited, _ = study_law(as_published=True, torque_limit=TORQUE_LIMIT)
    limited = replace(limited, law=f"as published, motor limited to {TORQUE_LIMIT:g} N m")
    tell("friction and contact")
    frictions = fit_friction()
    contacts = tuple(sensitivity.contact_effect(profile, (0.003, 0.01, 0.03, 0.1, 0.3)) for profile in profiles)
    tell("integration steps")
    return Reproduction(
        tracking,
        refined,
        (regularised, as_published, limited),
        inside + inside_published,
        frictions,
        contacts,
        steps=tuple(sensitivity.step_study(profile) for profile in profiles),
        physics_steps=tuple(sensitivity.step_study(profile, law_step=sensitivity.STEPS[-1]) for profile in profiles),
    )
