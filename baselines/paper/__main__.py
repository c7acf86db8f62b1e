"""The paper's numbers compared with ours: `python -m baselines.paper [--figures DIR] [--json FILE]`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from capsule_gym.command_line import check_output, parse
from capsule_gym.files import to_json, write_atomically

PROG = "python -m baselines.paper"


@dataclass(frozen=True)
class Args:
    """Prints the paper's numbers and claims next to the computed ones; draws its figures. About a minute.

    Examples:
      python -m baselines.paper                           all tables
      python -m baselines.paper --figures docs/figures    and all figures, as SVG and PNG
      python -m baselines.paper --json paper.json         and all numbers, for programs
    """

    figures: Path | None = None
    """Also draw the figures into this folder, which is created if necessary (needs matplotlib)."""
    json: Path | None = None
    """Also write all numbers to this file."""
    overwrite: bool = False
    """Let --json replace an existing file."""

    def check(self) -> None:
        """Raises an error for paths that cannot be written, before the computation."""
        check_output("--json", self.json, overwrite=self.overwrite)
        if self.figures is not None:
            if not next(path for path in (self.figures, *self.figures.absolute().parents) if path.exists()).is_dir():
                raise ValueError(f"--figures must name a folder, got {str(self.figures)!r}")
            if find_spec("matplotlib") is None:
                raise ValueError("--figures needs matplotlib: pip install 'capsule-gym[paper]'")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after parsing, since `--help` does not need these modules.
    from baselines.paper.report import compute, plain, text

    results = compute()
    # Written before anything is printed, so that a closed pipe does not cost the result.
    if args.json is not None:
        write_atomically(args.json, to_json(plain(results)))
    if args.figures is not None:
        from baselines.paper.figures import draw_all

        drawn = len(draw_all(args.figures))
    print(text(results))
    if args.json is not None:
        print(f"\nWritten to {args.json}")
    if args.figures is not None:
        print(f"\n{drawn} files drawn to {args.figures}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
