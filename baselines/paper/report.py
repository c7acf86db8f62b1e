"""Everything that `python -m baselines.paper` shows, as text and as plain data."""

from __future__ import annotations

from dataclasses import asdict, dataclass, is_dataclass
from typing import Any

import numpy as np

from baselines.paper import demand_study, printed_profile, proofs, selection
from baselines.paper.adaptive_study import AdaptiveStudy, study_adaptive
from baselines.paper.adaptive_verdicts import compare_adaptive, judge_adaptive
from baselines.paper.demand_study import Implication, Keeping
from baselines.paper.linearity import Linearity, check_linearity
from baselines.paper.printed_profile import PrintedPhase
from baselines.paper.profile_records import load
from baselines.paper.profile_settings import DATA
from baselines.paper.proofs import LargestRate, PeakTorque
from baselines.paper.reproduction import Progress, Reproduction, reproduce
from baselines.paper.selection import BoundaryCondition, Consequence
from baselines.paper.shapes import ShapeSpeed, shape_speeds
from baselines.paper.text import adaptation, derivation, optimum, principles, section_5, sensitivity
from baselines.paper.text import proofs as proofs_text
from baselines.paper.verdicts import Judgement, Row, compare_constants, compare_numbers, judge_claims


@dataclass(frozen=True)
class Derivation:
    """What is found of the paper's Sections 2 and 3.

    Attributes:
        linearity: Property 3.
        profile: (9) as printed.
        table_1: what each equation of Sect. 3.2 gives.
        boundary_condition: what theta(t3) = +theta_0 would take.
        keepings: how the profiles keep Principles and Lemmas.
        implications: what the Lemmas imply.
        shapes: speeds under other shapes of the profiles.
    """

    linearity: Linearity
    profile: tuple[PrintedPhase, ...]
    table_1: tuple[Consequence, ...]
    boundary_condition: BoundaryCondition
    keepings: tuple[Keeping, ...]
    implications: tuple[Implication, ...]
    shapes: tuple[ShapeSpeed, ...]


@dataclass(frozen=True)
class Report:
    """Everything that the command shows.

    Attributes:
        numbers: published and found.
        claims: published claims and what was found.
        runs: what was run under (35).
        adaptive: what was run under (39).
        proof_1: the torque at the peak.
        proof_2: the upper envelope.
        derivation: Sections 2 and 3.
    """

    numbers: list[Row]
    claims: list[Judgement]
    runs: Reproduction
    adaptive: AdaptiveStudy
    proof_1: list[PeakTorque]
    proof_2: list[LargestRate]
    derivation: Derivation

    def text(self) -> str:
        """For the terminal."""
        derived = self.derivation
        lines = [
            *section_5.numbers_section(self.numbers),
            *section_5.claims_section(self.claims),
            *section_5.tracking_section(self.runs),
            *proofs_text.proofs_section(self.proof_1, self.proof_2),
            *sensitivity.shapes_section(derived.shapes),
            *sensitivity.sensitivity_section(self.runs),
            *derivation.linearity_section(derived.linearity),
            *derivation.profile_section(derived.profile),
            *derivation.table_1_section(derived.table_1, derived.boundary_condition),
            *principles.principles_section(derived.keepings, derived.implications),
            *optimum.optimal_section(),
            *adaptation.adaptive_section(self.adaptive),
            *adaptation.choices_section(self.adaptive),
            *adaptation.long_runs_section(self.adaptive),
            *adaptation.estimates_section(self.adaptive),
            *adaptation.lyapunov_section(self.adaptive),
        ]
        return "\n".join(lines).lstrip("\n")

    def to_dict(self) -> dict[str, Any]:
        """Everything that was computed as plain types, for JSON."""
        numbers = [{**asdict(row), "difference": row.difference, "reproduced": row.reproduced} for row in self.numbers]
        derived = self.derivation
        content = {
            "numbers": numbers,
            "claims": self.claims,
            "runs": self.runs,
            "adaptive": self.adaptive,
            "proof_1": [{**asdict(proof), "holds": proof.holds} for proof in self.proof_1],
            "proof_2": [{**asdict(proof), "holds": proof.holds} for proof in self.proof_2],
            "property_3": derived.linearity,
            "profile_as_printed": [{**asdict(phase), "deviates": phase.deviates} for phase in derived.profile],
            "table_1": [{**asdict(row), "follows": row.follows} for row in derived.table_1],
            "boundary_condition": derived.boundary_condition,
            "demands": [{**asdict(row), "kept": row.kept} for row in derived.keepings],
            "lemmas": derived.implications,
            "shapes": derived.shapes,
            "optimal_profiles": load() if DATA.exists() else None,
        }
        plain: dict[str, Any] = _plain(content)
        return plain


def _plain(value: Any) -> Any:
    """The value as nested dicts, lists and numbers."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value


def make_report(progress: Progress | None = None) -> Report:
    """Computes everything.

    Args:
        progress: is told what begins.
    """
    tell = progress or (lambda name: None)
    tell("proofs")
    peaks, rates = proofs.peak_torques(), proofs.largest_rates()
    tell("principles, lemmas and shapes")
    derived = Derivation(
        check_linearity(),
        printed_profile.printed_phases(),
        selection.what_follows(),
        selection.boundary_condition(),
        demand_study.keepings(),
        demand_study.implications(),
        shape_speeds(),
    )
    runs = reproduce(progress)
    adaptive = study_adaptive(progress)
    numbers = [*compare_numbers(runs, peaks, rates), compare_adaptive(adaptive), *compare_constants()]
    claims = [*judge_claims(runs), *judge_adaptive(adaptive)]
    return Report(numbers, claims, runs, adaptive, peaks, rates, derived)
