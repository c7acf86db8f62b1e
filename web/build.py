"""Writes the live page and its module: `python -m web.build`, which `make web` runs.

The command writes three files to the folder of the site: the page `index.html`, from the page's template, style and
modules; the module `capsule.mjs`; and its types `capsule.d.mts`. Page and module need no other file and no server.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

from tyro.conf import arg

from baselines import drawing
from capsule_gym import rendering
from capsule_gym.command_line import parse, refuse
from capsule_gym.files import write_atomically

PROG = "python -m web.build"
FOLDER = Path("site/live")
SOURCES = Path(__file__).parent
# The line of web/capsule.mjs that is replaced by the archive.
PLACE = 'const ARCHIVE = "";'
LINK = '<a id="documentation"'
PAGE = SOURCES / "page"
MODULE = "capsule.mjs"
# Lengths and colours that the page shares with `capsule_gym.rendering`.
LENGTHS = (
    *("ROD", "BALL", "PIVOT", "SHELL_HEIGHT", "SHELL_HALF", "PLATFORM_HALF", "PLATFORM_HEIGHT", "GAUGE"),
    *("SPRING_INNER", "SPRING_OUTER", "SPRING_TURNS"),
)
COLOURS = (
    *("PAPER", "WHITE", "FLOOR_FILL", "GRID", "HAIRLINE", "TICK", "GREY", "INK", "SLATE", "SHELL", "INSIDE"),
    *("BALL_COLOUR", "TORQUE", "STICK", "SLIP"),
)


def build_module(archive: str) -> str:
    """The text of capsule.mjs with the archive inserted."""
    source = (SOURCES / "capsule.mjs").read_text(encoding="utf-8")
    before, after = source.split(PLACE)
    return f'{before}const ARCHIVE = "{archive}";{after}'


def build_page(module: str) -> str:
    """The text of the page, one HTML file; an import map contains the text of every JavaScript module by its name."""
    lengths = {name: getattr(rendering, name) for name in LENGTHS}
    sources = {MODULE: module, "figure.js": f"export const figure = {json.dumps(lengths)};\n"}
    sources |= {path.name: path.read_text("utf-8") for path in sorted(PAGE.glob("*.js"))}
    imports = {name: "data:text/javascript," + quote(text, safe="/+= ;:,()[]{}*!?&|") for name, text in sources.items()}
    parts = {
        "style": palette() + (PAGE / "page.css").read_text("utf-8"),
        "import map": json.dumps({"imports": imports}),
    }
    template = (PAGE / "index.html").read_text("utf-8")
    page = re.sub(r"/\* (style|import map) \*/", lambda match: parts[match[1]], template)
    # The address of the preview image must be absolute. SITE_URL is set when the site is deployed, as in mkdocs.yml.
    return page.replace("../media/", (os.environ.get("SITE_URL") or "../") + "media/", 1)


def palette() -> str:
    """The colours of the robot and the figures as CSS properties, for example --ink for INK."""
    robot = {name: "#" + "".join(f"{part:02x}" for part in getattr(rendering, name)) for name in COLOURS}
    colours = {**robot, "RIVAL": drawing.PURPLE, "ACCENT": drawing.BLUE, "WARNING": drawing.VERMILION}
    lines = (f"  --{name.lower().replace('_', '-')}: {value};\n" for name, value in colours.items())
    return ":root {\n" + "".join(lines) + "}\n"


@dataclass(frozen=True)
class Args:
    """Builds the environment for browsers and node, and the live page.

    Examples:
      python -m web.build
      python -m web.build --output elsewhere
    """

    output: Annotated[Path, arg(metavar="DIR", aliases=["-o"])] = FOLDER
    """Folder of the files; created if it does not exist."""


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    args = parse(Args, PROG, arguments)
    # Imported after the command line is checked: --help does not need it.
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
    page = build_page(module)
    if not (args.output.parent / "index.html").is_file():
        # Hides the link to the documentation, which does not exist in the folder above.
        page = page.replace(LINK, f"{LINK} hidden", 1)
    for name, text in (
        ("index.html", page),
        ("capsule.mjs", module),
        ("capsule.d.mts", (SOURCES / "capsule.d.mts").read_text(encoding="utf-8")),
    ):
        write_atomically(args.output / name, text)
        print(f"{args.output / name}: {len(text.encode()) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
