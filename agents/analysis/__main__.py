"""Writes tables and figures of the documentation's results: `python -m agents.analysis --help`."""

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

from agents.analysis import curves, information, limit_cycle, sensitivity
from baselines.drawing import save, style
from capsule_gym.command_line import Positional, arg, command
from capsule_gym.files import write_atomically

COMMAND = "python -m agents.analysis"
ROOT = Path(__file__).resolve().parents[2]
Document = Literal["limit_cycle", "curves", "sensitivity", "information"]
# The function `document` of each returns Markdown by the name under which a page includes it, and
# functions that draw figures of matplotlib by the names of their files.
DOCUMENTS: dict[Document, Any] = {
    "limit_cycle": limit_cycle,
    "curves": curves,
    "sensitivity": sensitivity,
    "information": information,
}


@command(COMMAND, OSError)
def main(
    names: Positional[tuple[Document, ...]] = (),
    check: bool = False,
    output: Annotated[Path, arg(metavar="DIR", aliases=["-o"])] = ROOT / "docs",
) -> int:
    """Writes docs/NAME_tables.md and docs/figures/NAME*.png and .svg.

    Examples:
      python -m agents.analysis
      python -m agents.analysis curves --check
      python -m agents.analysis sensitivity --output elsewhere

    Args:
        names: Documents; all by default.
        check: Write nothing; fail if the tables in the folder are not up to date.
        output: Folder of the files, which are replaced.
    """
    stale = False
    for name in names or DOCUMENTS:
        sections, figures = DOCUMENTS[name].document()
        path = output / f"{name}_tables.md"
        parts = [f"<!-- Written by {COMMAND}: do not edit. -->"]
        for section, table in sections.items():
            begin, end = (f"<!-- --8<-- [{edge}:{section}] -->" for edge in ("start", "end"))
            parts.append(f"{begin}\n{table}\n{end}")
        text = "\n\n".join(parts) + "\n"
        if not check:
            (output / "figures").mkdir(parents=True, exist_ok=True)
            with style():
                for figure, draw in figures.items():
                    save(draw(), output / "figures" / figure)
            write_atomically(path, text)
            print(f"Written: {name}", flush=True)
        elif not path.is_file() or path.read_text(encoding="utf-8") != text:
            print(f"{path} is not up to date: run `{COMMAND} {name}` and commit what it writes.")
            stale = True
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
