"""The paper's Section 5 beside ours: python -m baselines.paper [--figures DIR] [--json FILE].

Every published number with what is found, whether it was calibrated or predicted, and for each that differs the reason,
proved where it can be.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, is_dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from baselines import adaptation_text, paper_text, proofs
from baselines.comparison import Judgement, Row, compare_numbers, judge_claims
from baselines.files import write_atomically
from baselines.proofs import Envelope, PeakTorque
from baselines.reproduction import Progress, Reproduction, reproduce


@dataclass(frozen=True)
class Report:
    """Everything that the command shows.

    Attributes:
        numbers: published and found.
        claims: published claims and what was found.
        runs: what was run.
        proof_1: the torque at the peak.
        proof_2: the upper envelope.
    """

    numbers: list[Row]
    claims: list[Judgement]
    runs: Reproduction
    proof_1: list[PeakTorque]
    proof_2: list[Envelope]

    def text(self) -> str:
        """For the terminal."""
        lines = [
            *paper_text.numbers_section(self.numbers),
            *paper_text.claims_section(self.claims),
            *paper_text.tracking_section(self.runs),
            *paper_text.proofs_section(self.proof_1, self.proof_2),
            *paper_text.selection_section(),
            *paper_text.optimal_section(),
            *adaptation_text.adaptive_section(self.runs),
            *adaptation_text.estimates_section(self.runs),
            *adaptation_text.lyapunov_section(self.runs),
            *paper_text.sensitivity_section(self.runs),
        ]
        return "\n".join(lines).lstrip("\n")

    def to_dict(self) -> dict[str, Any]:
        """For JSON: plain types, None for what is not finite."""
        from baselines.optimal_profiles import DATA, load
        from baselines.selection import what_follows

        numbers = [{**asdict(row), "difference": row.difference, "reproduced": row.reproduced} for row in self.numbers]
        content = {
            "numbers": numbers,
            "claims": self.claims,
            "runs": self.runs,
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
    return Report(compare_numbers(runs, peaks, envelopes), judge_claims(runs), runs, peaks, envelopes)


def _tell(name: str) -> None:
    """Shows on a terminal what begins."""
    if sys.stderr.isatty():
        print(f"\r\033[K{name} ..." if name else "\r\033[K", end="", file=sys.stderr, flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m baselines.paper",
        description="The paper's numbers beside ours, with the reason where they differ, and its figures.",
    )
    parser.add_argument("--figures", type=Path, metavar="DIR", help="also draw the figures (needs matplotlib)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all numbers to this file")
    parser.add_argument("--overwrite", action="store_true", help="let --json replace an existing file")
    options = parser.parse_args(arguments)
    # Before the work, so that nothing is computed in vain.
    if options.json is not None:
        if options.json.exists() and not options.overwrite:
            parser.error(f"--json must name a new file unless --overwrite is given, got {str(options.json)!r}")
        if options.json.is_dir() or not options.json.parent.is_dir():
            parser.error(f"--json must name a file in a folder that exists, got {str(options.json)!r}")
    if options.figures is not None:
        if options.figures.exists() and not options.figures.is_dir():
            parser.error(f"--figures must name a folder, got {str(options.figures)!r}")
        if find_spec("matplotlib") is None:
            parser.error("--figures needs matplotlib: pip install 'capsule-gym[paper]'")

    begin = perf_counter()
    report = make_report(_tell)
    # Written before anything is printed: a closed pipe must not cost the result.
    if options.json is not None:
        write_atomically(options.json, json.dumps(report.to_dict(), indent=1, allow_nan=False) + "\n")
    figures = []
    if options.figures is not None:
        from baselines.paper_figures import draw_all

        figures = draw_all(options.figures, _tell)
    _tell("")
    print(report.text())
    print(f"\nComputed in {perf_counter() - begin:.0f} s.")
    if options.json is not None:
        print(f"Written to {options.json}")
    if figures:
        print(f"{len(figures)} files drawn to {options.figures}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
