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

import numpy as np

from baselines import drawing
from capsule_gym.command_line import command, refuse
from capsule_gym.files import write_atomically
from capsule_gym.rendering import renderer
from web.data import pack_data

PROG = "python -m web.build"
SOURCES = Path(__file__).parent
CORE = SOURCES.parent / "capsule_gym" / "core"
COMPILER = (
    *(sys.executable, "-m", "ziglang", "c++", "-std=c++20", "-O3", "-g0", "-I", str(CORE)),
    # Features that every engine supports since 2021.
    *(
        "-target",
        "wasm32-freestanding",
        "-mcpu=generic+bulk_memory+mutable_globals+nontrapping_fptoint+sign_ext",
    ),
    *(
        "-ffp-contract=off",
        "-DCAPSULE_FP_CONTRACT_OFF",
        "-fno-math-errno",
        "-fno-exceptions",
        "-fno-rtti",
    ),
    *("-nostdlib++", "-Wl,--no-entry", "-Wl,--strip-all", "-Wl,-z,stack-size=1048576"),
)


def compile_wasm(source: Path = CORE / "bindings" / "web.cpp") -> bytes:
    """The WebAssembly module of a C++ file, the same bytes with the same version of `ziglang`, or a
    RuntimeError.
    """
    with tempfile.TemporaryDirectory() as folder:
        module = Path(folder, "core.wasm")
        done = subprocess.run(
            [*COMPILER, "-o", str(module), str(source)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RuntimeError(f"python -m ziglang c++ failed:\n{done.stderr}")
        return module.read_bytes()


def build_module(archive: str) -> str:
    """The text of capsule.mjs with the archive inserted."""
    return (
        (SOURCES / "capsule.mjs")
        .read_text("utf-8")
        .replace('ARCHIVE = ""', f'ARCHIVE = "{archive}"')
    )


def build_page(module: str) -> str:
    """The text of the page, one HTML file; an import map contains the text of every JavaScript
    module by its name.
    """
    names = {name: value for name, value in vars(renderer).items() if name.isupper()}
    lengths = {name: value for name, value in names.items() if isinstance(value, float)}
    sources = {
        "capsule.mjs": module,
        "figure.js": f"export const figure = {json.dumps(lengths)};\n",
    }
    folder = SOURCES / "page"
    sources |= {path.name: path.read_text("utf-8") for path in sorted(folder.glob("*.js"))}
    imports = {
        name: "data:text/javascript," + quote(text, safe="/+= ;:,()[]{}*!?&|")
        for name, text in sources.items()
    }
    # The colours of the robot and the figures as CSS properties, for example --ink for INK.
    robot = {
        name: "#" + bytes(value).hex() for name, value in names.items() if np.shape(value) == (3,)
    }
    colours = robot | {
        "RIVAL": drawing.PURPLE,
        "ACCENT": drawing.BLUE,
        "WARNING": drawing.VERMILION,
    }
    lines = (f"  --{name.lower().replace('_', '-')}: {value};\n" for name, value in colours.items())
    style = ":root {\n" + "".join(lines) + "}\n" + (folder / "page.css").read_text("utf-8")
    parts = {"style": style, "import map": json.dumps({"imports": imports})}
    template = (folder / "index.html").read_text("utf-8")
    page = re.sub(r"/\* (style|import map) \*/", lambda match: parts[match[1]], template)
    # The address of the preview image must be absolute. SITE_URL is set when the site is deployed,
    # as in mkdocs.yml.
    return page.replace("../media/", (os.environ.get("SITE_URL") or "../") + "media/")


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
        refuse(
            PROG, f"--output must be a folder that can be written to, got {str(output)!r}: {error}"
        )
    page = build_page(module)
    if not (output.parent / "index.html").is_file():
        # Hides the link to the documentation, which does not exist in the folder above.
        page = page.replace('<a id="documentation"', '<a id="documentation" hidden')
    types = (SOURCES / "capsule.d.mts").read_text(encoding="utf-8")
    for name, text in (("index.html", page), ("capsule.mjs", module), ("capsule.d.mts", types)):
        write_atomically(output / name, text)
        print(f"{output / name}: {len(text.encode()) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
