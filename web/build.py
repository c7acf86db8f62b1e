"""Writes the live page and its module: `python -m web.build`, which `make web` runs.

The command compiles the core to WebAssembly and writes three files to the folder of the site: the
page `index.html`, the module `capsule.mjs`, and its types `capsule.d.mts`. Page and module need no
other file and no server.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from urllib.parse import quote

from baselines import drawing
from capsule_gym.command_line import command, refuse
from capsule_gym.files import write_atomically
from capsule_gym.rendering import renderer
from web.data import pack_data

PROG = "python -m web.build"
SOURCES = Path(__file__).parent
PAGE = SOURCES / "page"
MODULE = SOURCES / "module"
# The files that capsule.mjs consists of, each after those that it imports from.
PARTS = (
    "archive",
    "checks",
    "network",
    "core",
    "options",
    "drivers",
    "reset",
    "capsule",
    "scripted",
    "episode",
    "replay",
)
IMPORT = re.compile(r'^import \{[^}]*\} from "\./\w+\.mjs";\n', re.MULTILINE)
EXPORT = re.compile(r"^export ", re.MULTILINE)
FROM = re.compile(r' from "\./\w+\.mjs"')
CORE = SOURCES.parent / "capsule_gym" / "core"
# Features that every engine supports since 2021.
FEATURES = "-mcpu=generic+bulk_memory+mutable_globals+nontrapping_fptoint+sign_ext"
FLAGS = """
    -std=c++20 -O3 -g0 -target wasm32-freestanding
    -ffp-contract=off -DCAPSULE_FP_CONTRACT_OFF -fno-math-errno -fno-exceptions -fno-rtti
    -nostdlib++ -Wl,--no-entry -Wl,--strip-all -Wl,-z,stack-size=1048576
""".split()
# Colours of the figures that the page uses, as the renderer names its own.
FIGURE_COLOURS = {
    "RIVAL": drawing.PURPLE,
    "ACCENT": drawing.BLUE,
    "WARNING": drawing.VERMILION,
}


def compile_wasm(source: Path = CORE / "bindings" / "web.cpp") -> bytes:
    """The WebAssembly module of a C++ file.

    The same version of `ziglang` gives the same bytes.

    Raises:
        RuntimeError: if the file does not compile.
    """
    compiler = [sys.executable, "-m", "ziglang", "c++", *FLAGS, FEATURES, "-I", str(CORE)]
    with tempfile.TemporaryDirectory() as folder:
        module = Path(folder, "core.wasm")
        compilation = [*compiler, "-o", str(module), str(source)]
        done = subprocess.run(compilation, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"python -m ziglang c++ failed:\n{done.stderr}")
        return module.read_bytes()


def build_module(archive: str) -> str:
    """The text of capsule.mjs, its parts in one file, with the archive inserted."""
    exports = (MODULE / "exports.mjs").read_text("utf-8")
    # Only what this file exports is public, and the parts need no imports in one file.
    texts = [FROM.sub("", exports)]
    for part in PARTS:
        text = (MODULE / f"{part}.mjs").read_text("utf-8")
        text = IMPORT.sub("", text)
        texts.append(EXPORT.sub("", text))
    return "\n".join(texts).replace('ARCHIVE = ""', f'ARCHIVE = "{archive}"')


def build_page(module: str) -> str:
    """The text of the page, one HTML file that contains every JavaScript module."""
    parts = {"style": build_style(), "import map": build_import_map(module)}
    template = (PAGE / "index.html").read_text("utf-8")
    page = re.sub(r"/\* (style|import map) \*/", lambda match: parts[match[1]], template)
    # The address of the preview image must be absolute. SITE_URL is set when the site is deployed,
    # as in mkdocs.yml.
    site = os.environ.get("SITE_URL") or "../"
    return page.replace("../media/", site + "media/")


def build_style() -> str:
    """The style sheet; colours are properties, for example --ink for the renderer's INK."""
    colours = dict(FIGURE_COLOURS)
    for name, value in vars(renderer).items():
        if name.isupper() and isinstance(value, str) and value.startswith("#"):
            colours[name] = value
    style = ":root {\n"
    for name, colour in colours.items():
        css_name = name.lower().replace("_", "-")
        style += f"  --{css_name}: {colour};\n"
    return style + "}\n" + (PAGE / "page.css").read_text("utf-8")


def build_import_map(module: str) -> str:
    """The text of every JavaScript module by its name, as JSON of an import map."""
    lengths = {}
    for name, value in vars(renderer).items():
        if name.isupper() and isinstance(value, float):
            lengths[name] = value
    sources = {
        "capsule.mjs": module,
        "figure.js": f"export const figure = {json.dumps(lengths)};\n",
    }
    for path in sorted(PAGE.glob("*.js")):
        sources[path.name] = path.read_text("utf-8")
    imports = {}
    for name, source in sources.items():
        imports[name] = "data:text/javascript," + quote(source, safe="/+= ;:,()[]{}*!?&|")
    return json.dumps({"imports": imports})


@command(PROG, RuntimeError)
def main(output: Path = Path("site/live")) -> None:
    """Builds the environment for browsers and node, and the live page.

    Examples:
      python -m web.build --output site/live

    Args:
        output: Folder of the files; created if it does not exist.
    """
    try:
        output.mkdir(parents=True, exist_ok=True)
        module = build_module(pack_data(compile_wasm()))
    except OSError as error:
        accepted = "--output must be a folder that can be written to"
        refuse(PROG, f"{accepted}, got {str(output)!r}: {error}")
    page = build_page(module)
    if not (output.parent / "index.html").is_file():
        # Hides the link to the documentation, which does not exist in the folder above.
        page = page.replace('<a id="documentation"', '<a id="documentation" hidden')
    types = (SOURCES / "capsule.d.mts").read_text("utf-8")
    for name, text in (("index.html", page), ("capsule.mjs", module), ("capsule.d.mts", types)):
        path = output / name
        write_atomically(path, text)
        kilobytes = len(text.encode()) / 1000
        print(f"{path}: {kilobytes:.0f} kB")


if __name__ == "__main__":
    main()
