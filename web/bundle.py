"""One HTML file out of the page's template, style and modules, which needs no server and no network."""

from __future__ import annotations

import json
import re
from pathlib import Path

from baselines import drawing
from capsule_gym import rendering
from capsule_gym.rendering import Colour

PAGE = Path(__file__).parent / "page"
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
# What the two forms above leave: an import or an export that would end up inside of a function.
_OTHER = re.compile(r"^(?:import [^(]|export ).*", re.MULTILINE)


def bundle(module: str) -> str:
    """The page as one HTML file.

    Every JavaScript module becomes a function that returns what it exports, so that no name of one meets another's.
    They may say `import {a, b as c} from "./NAME";` and put `export` before a declaration, nothing else of the kind.

    Args:
        module: the text of the stand-alone module capsule.mjs, with its data.

    Raises:
        ValueError: if a module imports or exports in another form, imports itself in the end, or cannot stand in HTML.
        FileNotFoundError: if a module imports one that is not there.
    """
    sources = {MODULE: module, "figure.js": figure()}
    order: list[str] = []
    _visit(ENTRY, sources, order, ())
    script = "const modules = {};\n" + "\n".join(_wrapped(name, sources[name]) for name in order)
    if "</script" in script.lower() or "<!--" in script:
        raise ValueError("the modules must not contain '</script' or '<!--', which would end or hide them in HTML")
    parts = {"style": palette() + (PAGE / "page.css").read_text("utf-8"), "script": script}
    template = (PAGE / "index.html").read_text("utf-8")
    return re.sub(r"/\* (style|script) \*/", lambda match: parts[match[1]], template)


def figure() -> str:
    """The module figure.js: the lengths of the drawn robot, from `capsule_gym.rendering`."""
    lengths = {name: getattr(rendering, name) for name in LENGTHS}
    return f"export const figure = {json.dumps(lengths)};\n"


def palette() -> str:
    """The colours of the robot and of the figures as properties of CSS, --ink for INK."""
    colours = {name: _hexadecimal(getattr(rendering, name)) for name in COLOURS}
    colours |= {"RIVAL": drawing.PURPLE, "ACCENT": drawing.BLUE, "WARNING": drawing.VERMILION}
    lines = (f"  --{name.lower().replace('_', '-')}: {value};\n" for name, value in colours.items())
    return ":root {\n" + "".join(lines) + "}\n"


def _hexadecimal(colour: Colour) -> str:
    return "#" + "".join(f"{part:02x}" for part in colour)


def _visit(name: str, sources: dict[str, str], order: list[str], above: tuple[str, ...]) -> None:
    """Puts a module behind all those that it imports."""
    if name in above:
        raise ValueError(f"modules must not import one another in a circle, got {' -> '.join((*above, name))}")
    if name in order:
        return
    if name not in sources:
        sources[name] = (PAGE / name).read_text("utf-8")
    for _, other in _IMPORT.findall(sources[name]):
        _visit(other, sources, order, (*above, name))
    order.append(name)


def _wrapped(name: str, source: str) -> str:
    """The module as the constant `modules[name]`, an object of what it exports."""
    exported = _EXPORT.findall(source)
    body = _EXPORT.sub("", _IMPORT.sub(_taken, source))
    if other := _OTHER.search(body):
        raise ValueError(
            f'{name} must import as in import {{a}} from "./b.js"; and export declarations, got {other[0]!r}'
        )
    return f'modules["{name}"] = await (async () => {{\n{body}\nreturn {{ {", ".join(exported)} }};\n}})();'


def _taken(match: re.Match[str]) -> str:
    """An import as the constants that it brings."""
    names = re.sub(r"(\w+) as (\w+)", r"\1: \2", match[1])
    return f'const {{{names}}} = modules["{match[2]}"];\n'
