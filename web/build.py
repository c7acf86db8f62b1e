"""Writes the live page and its module: `python -m web.build`, which `make web` runs.

Into the folder of the site go the page `index.html` and the module `capsule.mjs`, neither of which needs another file,
and the module's types `capsule.d.mts`.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from capsule_gym.command_line import parse, refuse
from capsule_gym.files import write_atomically
from web.bundle import bundle

PROG = "python -m web.build"
FOLDER = Path("site/live")
SOURCES = Path(__file__).parent
# The line of web/capsule.mjs that the archive takes the place of.
PLACE = 'const ARCHIVE = "";'
LINK = '<a id="documentation"'


def build_module(archive: str) -> str:
    """The text of capsule.mjs with the archive in it."""
    source = (SOURCES / "capsule.mjs").read_text(encoding="utf-8")
    before, after = source.split(PLACE)
    return f'{before}const ARCHIVE = "{archive}";{after}'


def build_page(module: str, *, documented: bool) -> str:
    """The text of the page.

    Args:
        module: that of capsule.mjs.
        documented: whether the documentation lies where the page links to it, in the folder above.
    """
    page = bundle(module)
    return page if documented else page.replace(LINK, f"{LINK} hidden", 1)


@dataclass(frozen=True)
class Args:
    """Builds the environment for browsers and node, and the live page.

    Examples:
      python -m web.build
      python -m web.build --output elsewhere
    """

    output: Annotated[Path, arg(metavar="DIR", aliases=["-o"])] = FOLDER
    """Where the files go; it is made where it does not exist."""


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    args = parse(Args, PROG, arguments)
    # After the command line is known to be right: the help needs none of it.
    from web.data import pack_data

    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refuse(PROG, f"--output must be a folder that can be written to, got {str(args.output)!r}: {error}")
    try:
        archive = pack_data()
    except subprocess.CalledProcessError as error:
        refuse(PROG, f"the modules cannot be built: {error}")
    module = build_module(archive)
    for name, text in (
        ("index.html", build_page(module, documented=(args.output.parent / "index.html").is_file())),
        ("capsule.mjs", module),
        ("capsule.d.mts", (SOURCES / "capsule.d.mts").read_text(encoding="utf-8")),
    ):
        write_atomically(args.output / name, text)
        print(f"{args.output / name}: {len(text.encode()) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
