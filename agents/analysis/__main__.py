"""Writes the tables and figures of the documentation's result pages: `python -m agents.analysis --help`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from agents.analysis import limit_cycle, sensitivity, statistics
from capsule_gym.command_line import Positional, arg, parse, refuse
from capsule_gym.files import write_atomically

COMMAND = "python -m agents.analysis"
ROOT = Path(__file__).resolve().parents[2]
# Each module has a function `document`.
DOCUMENTS = {"limit_cycle": limit_cycle, "statistics": statistics, "sensitivity": sensitivity}


@dataclass(frozen=True)
class Args:
    """Writes docs/NAME_tables.md and docs/figures/NAME*.png and .svg.

    Examples:
      python -m agents.analysis
      python -m agents.analysis statistics --check
      python -m agents.analysis sensitivity --output elsewhere
    """

    names: Annotated[
        Positional[tuple[str, ...]], arg(metavar="NAME", help=f"Any of {', '.join(DOCUMENTS)}; all by default.")
    ] = ()
    check: bool = False
    """Write nothing; fail if the tables in the folder are not up to date."""
    output: Annotated[Path, arg(metavar="DIR", aliases=["-o"])] = ROOT / "docs"
    """Folder of the files, which are replaced."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    if unknown := [name for name in args.names if name not in DOCUMENTS]:
        refuse(COMMAND, f"NAME must be one of {', '.join(DOCUMENTS)}, got {unknown[0]!r}")
    stale = False
    for name in args.names or DOCUMENTS:
        document, path = DOCUMENTS[name].document(), args.output / f"{name}_tables.md"
        parts = [f"<!-- Written by {COMMAND}: do not edit. -->"]
        for section, table in document.sections.items():
            parts.append(f"<!-- --8<-- [start:{section}] -->\n{table}\n<!-- --8<-- [end:{section}] -->")
        text = "\n\n".join(parts) + "\n"
        if args.check:
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                print(f"{path} is not up to date: run `{COMMAND} {name}` and commit what it writes.")
                stale = True
            continue
        (args.output / "figures").mkdir(parents=True, exist_ok=True)
        for figure, write in document.figures.items():
            write(args.output / "figures" / figure)
        write_atomically(path, text)
        print(f"Written: {name}", flush=True)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
