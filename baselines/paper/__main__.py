"""The paper's numbers compared with ours: `python -m baselines.paper [--figures DIR]`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from capsule_gym.command_line import parse

PROG = "python -m baselines.paper"


@dataclass(frozen=True)
class Args:
    """Prints the paper's numbers and claims next to the computed ones; draws its figures. About a minute.

    Examples:
      python -m baselines.paper                           all tables
      python -m baselines.paper --figures docs/figures    and all figures, as SVG and PNG
    """

    figures: Path | None = None
    """Also draw the figures into this folder, which is created if necessary (needs matplotlib)."""

    def check(self) -> None:
        """Raises an error for a folder that cannot be written, before the computation."""
        if self.figures is not None:
            if not next(path for path in (self.figures, *self.figures.absolute().parents) if path.exists()).is_dir():
                raise ValueError(f"--figures must name a folder, got {str(self.figures)!r}")
            if find_spec("matplotlib") is None:
                raise ValueError("--figures needs matplotlib: pip install 'capsule-gym[paper]'")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    # Imported after parsing, since `--help` does not need these modules.
    from baselines.paper.report import compute, text

    print(text(compute()))
    if args.figures is not None:
        from baselines.paper.figures import draw_all

        print(f"\n{len(draw_all(args.figures))} files drawn to {args.figures}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
