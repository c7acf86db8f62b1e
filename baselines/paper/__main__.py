"""The paper's numbers beside ours: `python -m baselines.paper [--figures DIR] [--json FILE]`.

Every published number with what is found, whether it was calibrated or predicted, and for each that differs the reason,
proved where it can be.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter

from capsule_gym.command_line import check_output, parse
from capsule_gym.files import to_json, write_atomically

PROG = "python -m baselines.paper"


@dataclass(frozen=True)
class Options:
    """Prints the paper's numbers beside ours, with the reason where they differ; draws its figures.

    Half a minute: Section 5, two proofs on the published torques, what Table 1 follows from, Principles and Lemmas, the
    optimum of the paper's profiles, the adaptive law over its ranges, and what the speeds depend on.

    Examples:
      python -m baselines.paper                           all tables
      python -m baselines.paper --figures docs/figures    and all figures, as SVG and PNG
      python -m baselines.paper --json paper.json         and all numbers, for programs
    """

    figures: Path | None = None
    """Also draw the figures into this folder, made if it does not exist (needs matplotlib)."""
    json: Path | None = None
    """Also write all numbers to this file."""
    overwrite: bool = False
    """Let --json replace an existing file."""

    def check(self) -> None:
        """Refuses what could not be written, before the work and not after it."""
        check_output("--json", self.json, overwrite=self.overwrite)
        if self.figures is not None:
            if self.figures.exists() and not self.figures.is_dir():
                raise ValueError(f"--figures must name a folder, got {str(self.figures)!r}")
            if find_spec("matplotlib") is None:
                raise ValueError("--figures needs matplotlib: pip install 'capsule-gym[paper]'")


def _tell(name: str) -> None:
    """Shows on a terminal what begins."""
    if sys.stderr.isatty():
        print(f"\r\033[K{name} ..." if name else "\r\033[K", end="", file=sys.stderr, flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    # After the command line is known to be right: the help needs none of it.
    from baselines.paper.report import make_report

    begin = perf_counter()
    report = make_report(_tell)
    # Written before anything is printed: a closed pipe must not cost the result.
    if options.json is not None:
        write_atomically(options.json, to_json(report.to_dict()))
    figures = []
    if options.figures is not None:
        from baselines.paper.figures.gallery import draw_all

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
