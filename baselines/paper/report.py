"""Everything that `python -m baselines.paper` shows, as text and as plain data."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any

import numpy as np

from baselines.paper import proofs
from baselines.paper.adaptive_study import AdaptiveStudy, study_adaptive
from baselines.paper.adaptive_verdicts import compare_adaptive, judge_adaptive
from baselines.paper.proofs import Envelope, PeakTorque
from baselines.paper.reproduction import Progress, Reproduction, reproduce
from baselines.paper.text import adaptation, sections
from baselines.paper.verdicts import Judgement, Row, compare_constants, compare_numbers, judge_claims


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
    """

    numbers: list[Row]
    claims: list[Judgement]
    runs: Reproduction
    adaptive: AdaptiveStudy
    proof_1: list[PeakTorque]
    proof_2: list[Envelope]

    def text(self) -> str:
        """For the terminal."""
        lines = [
            *sections.numbers_section(self.numbers),
            *sections.claims_section(self.claims),
            *sections.tracking_section(self.runs),
            *sections.proofs_section(self.proof_1, self.proof_2),
            *sections.selection_section(),
            *sections.optimal_section(),
            *adaptation.adaptive_section(self.adaptive),
            *adaptation.choices_section(self.adaptive),
            *adaptation.long_runs_section(self.adaptive),
            *adaptation.estimates_section(self.adaptive),
            *adaptation.lyapunov_section(self.adaptive),
            *sections.sensitivity_section(self.runs),
        ]
        return "\n".join(lines).lstrip("\n")

    def to_dict(self) -> dict[str, Any]:
        """For JSON: plain types, None for what is not finite."""
        from baselines.paper.optimal_profiles import DATA, load
        from baselines.paper.selection import what_follows

        numbers = [{**asdict(row), "difference": row.difference, "reproduced": row.reproduced} for row in self.numbers]
        content = {
            "numbers": numbers,
            "claims": self.claims,
            "runs": self.runs,
            "adaptive": self.adaptive,
            "proof_1": [{**asdict(proof), "holds": proof.holds} for proof in self.proof_1],
            "proof_2": [{**asdict(proof), "holds": proof.holds} for proof in self.proof_2],
            "table_1": [{**asdict(row), "follows": row.follows} for row in what_follows()],
            "optimal_profiles": load() if DATA.exists() else None,
        }
        plain: dict[str, Any] = _plain(content)
        return plain


def _plain(value: Any) -> Any:
    """The value as what JSON knows."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def make_report(progress: Progress | None = None) -> Report:
    """Computes everything.

    Args:
        progress: is told what begins.
    """
    if progress:
        progress("proofs")
    peaks, envelopes = proofs.peak_torques(), proofs.envelopes()
    runs = reproduce(progress)
    adaptive = study_adaptive(progress)
    numbers = [*compare_numbers(runs, peaks, envelopes), compare_adaptive(adaptive), *compare_constants()]
    claims = [*judge_claims(runs), *judge_adaptive(adaptive)]
    return Report(numbers, claims, runs, adaptive, peaks, envelopes)
