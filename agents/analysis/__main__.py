"""Writes the tables and figures of the documentation's result pages: `python -m agents.analysis --help`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from agents.analysis import algorithms, goal, limit_cycle, pareto, recording, residual_limit, sensitivity, statistics
from agents.analysis.data import Document
from capsule_gym.command_line import Positional, parse, refuse
from capsule_gym.files import write_atomically

COMMAND = "python -m agents.analysis"
ROOT = Path(__file__).resolve().parents[2]


# Each module has a function `document`.
DOCUMENTS = {
    "statistics": statistics,
    "limit_cycle": limit_cycle,
    "pareto": pareto,
    "residual_limit": residual_limit,
    "goal": goal,
    "sensitivity": sensitivity,
    "algorithms": algorithms,
    "animations": recording,
}


@dataclass(frozen=True)
class Args:
    """Writes docs/NAME_tables.md, docs/figures/NAME*.png and .svg, and the animations in docs/media.

    Examples:
      python -m agents.analysis
      python -m agents.analysis statistics --check
      python -m agents.analysis limit_cycle animations --output elsewhere
    """

    names: Annotated[
        Positional[tuple[str, ...]], arg(metavar="NAME", help=f"Any of {', '.join(DOCUMENTS)}; all by default.")
    ] = ()
    check: bool = False
    """Write nothing; fail if the tables in the folder are not up to date."""
    output: Annotated[Path, arg(metavar="DIR", aliases=["-o"])] = ROOT / "docs"
    """Folder of the files, which are replaced."""


def render(document: Document) -> str:
    """Renders a document's tables as Markdown, in sections that a page can include."""
    parts = [f"<!-- Written by {COMMAND}: do not edit. -->"]
    for name, text in document.sections.items():
        parts.append(f"<!-- --8<-- [start:{name}] -->\n{text}\n<!-- --8<-- [end:{name}] -->")
    return "\n\n".join(parts) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    unknown = [name for name in args.names if name not in DOCUMENTS]
    if unknown:
        refuse(COMMAND, f"NAME must be one of {', '.join(DOCUMENTS)}, got {unknown[0]!r}")
    stale = False
    for name in args.names or DOCUMENTS:
        document, path = DOCUMENTS[name].document(), args.output / f"{name}_tables.md"
        if args.check:
            if document.sections and (not path.is_file() or path.read_text(encoding="utf-8") != render(document)):
                print(f"{path} is not up to date: run `{COMMAND} {name}` and commit what it writes.")
                stale = True
            continue
        for place, write in document.figures.items():
            (args.output / place).parent.mkdir(parents=True, exist_ok=True)
            write(args.output / place)
        if document.sections:
            write_atomically(path, render(document))
        print(f"Written: {name}", flush=True)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
