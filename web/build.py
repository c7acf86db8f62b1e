"""Writes the live page and its module: `python -m web.build`, which `make web` runs.

Into the folder of the site go the page `index.html`, out of the page's template, style and modules, and the module
`capsule.mjs`, neither of which needs another file or a server; and the module's types `capsule.d.mts`.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from baselines import drawing
from capsule_gym import rendering
from capsule_gym.command_line import parse, refuse
from capsule_gym.files import write_atomically

PROG = "python -m web.build"
FOLDER = Path("site/live")
SOURCES = Path(__file__).parent
# The line of web/capsule.mjs that the archive takes the place of.
PLACE = 'const ARCHIVE = "";'
LINK = '<a id="documentation"'
PAGE = SOURCES / "page"
ENTRY = "page.js"
MODULE = "capsule.mjs"
# What the page draws as `capsule_gym.rendering` does: names of its lengths, and of its colours.
LENGTHS = (
    *("ROD", "BALL", "PIVOT", "SHELL_HEIGHT", "SHELL_HALF", "PLATFORM_HALF", "PLATFORM_HEIGHT", "GAUGE"),
    *("SPRING_INNER", "SPRING_OUTER", "SPRING_TURNS", "SPEED_ARROW", "SPEED_ARROW_LIMIT", "TRAIL_SECONDS"),
)
COLOURS = (
    *("PAPER", "WHITE", "FLOOR_FILL", "GRID", "HAIRLINE", "TICK", "GREY", "INK", "SLATE", "SHELL", "INSIDE"),
    *("BALL_COLOUR", "TORQUE", "STICK", "SLIP"),
)

_IMPORT = re.compile(r'^import \{([^}]*)\} from "\./([^"]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:(?:async )?function|class|const|let) (\w+))", re.MULTILINE)


def build_module(archive: str) -> str:
    """The text of capsule.mjs with the archive in it."""
    source = (SOURCES / "capsule.mjs").read_text(encoding="utf-8")
    before, after = source.split(PLACE)
    return f'{before}const ARCHIVE = "{archive}";{after}'


def build_page(module: str) -> str:
    """The text of the page, one HTML file.

    Every JavaScript module becomes a function that returns what it exports, so that no name of one meets another's.
    They may say `import {a, b as c} from "./NAME";` and put `export` before a declaration, nothing else of the kind.

    Args:
        module: the text of capsule.mjs.

    Raises:
        ValueError: if a module cannot stand in HTML.
    """
    lengths = {name: getattr(rendering, name) for name in LENGTHS}
    sources = {MODULE: module, "figure.js": f"export const figure = {json.dumps(lengths)};\n"}
    order: list[str] = []
    _visit(ENTRY, sources, order)
    script = "const modules = {};\n" + "\n".join(_wrapped(name, sources[name]) for name in order)
    if "</script" in script.lower() or "<!--" in script:
        raise ValueError("the modules must not contain '</script' or '<!--', which would end or hide them in HTML")
    parts = {"style": palette() + (PAGE / "page.css").read_text("utf-8"), "script": script}
    template = (PAGE / "index.html").read_text("utf-8")
    return re.sub(r"/\* (style|script) \*/", lambda match: parts[match[1]], template)


def palette() -> str:
    """The colours of the robot and of the figures as properties of CSS, --ink for INK."""
    robot = {name: "#" + "".join(f"{part:02x}" for part in getattr(rendering, name)) for name in COLOURS}
    colours = {**robot, "RIVAL": drawing.PURPLE, "ACCENT": drawing.BLUE, "WARNING": drawing.VERMILION}
    lines = (f"  --{name.lower().replace('_', '-')}: {value};\n" for name, value in colours.items())
    return ":root {\n" + "".join(lines) + "}\n"


def _visit(name: str, sources: dict[str, str], order: list[str]) -> None:
    """Puts a module behind all those that it imports."""
    if name in order:
        return
    if name not in sources:
        sources[name] = (PAGE / name).read_text("utf-8")
    for _, other in _IMPORT.findall(sources[name]):
        _visit(other, sources, order)
    order.append(name)


def _wrapped(name: str, source: str) -> str:
    """The module as the constant `modules[name]`, an object of what it exports."""

    def take(match: re.Match[str]) -> str:
        names = re.sub(r"(\w+) as (\w+)", r"\1: \2", match[1])
        return f'const {{{names}}} = modules["{match[2]}"];\n'

    exported = _EXPORT.findall(source)
    body = _EXPORT.sub("", _IMPORT.sub(take, source))
    return f'modules["{name}"] = await (async () => {{\n{body}\nreturn {{ {", ".join(exported)} }};\n}})();'


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
    page = build_page(module)
    if not (args.output.parent / "index.html").is_file():
        # There is no documentation in the folder above, which the page links to.
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
