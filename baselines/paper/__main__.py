"""The paper's Section 5 beside ours: python -m baselines.paper [--figures DIR] [--json FILE].

Every published number with what is found, whether it was calibrated or predicted, and for each that differs the reason,
proved where it can be.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter

from baselines.paper.report import make_report
from capsule_gym.files import write_atomically


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
        from baselines.paper.figures.profiles import draw_all

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
