"""Runs the pages and the notebooks with the installed package, each in its order in one folder.

Of a page these are the Python blocks, and the commands that need neither a clone nor a window.
Trainings are cut to one update; .github/workflows/ci.yml runs the notebooks whole.
"""

import json
import os
import re
import runpy
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib
from stable_baselines3 import PPO

import capsule_gym

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("*.md", "docs/**/*.md", "agents/**/*.md", "capsule_gym/**/*.md", "capsule_gym/**/*.py")
FENCE = re.compile(r"^( *)```(python|bash)\n(.*?)^\1```", re.DOTALL | re.MULTILINE)
COMMAND = re.compile(r"(python -m capsule_gym\.(export|identification|demo .* -o) |gcc ).*")
learn = PPO.learn


def learn_once(model: PPO, _: int, **options: Any) -> PPO:
    """`PPO.learn` with one update."""
    return learn(model, 1, **options)


def find(*patterns: str) -> list[Path]:
    """The files with these paths from the project's folder."""
    return sorted(path for pattern in patterns for path in ROOT.glob(pattern))


def run_page(path: Path) -> None:
    """Runs the blocks of a page in the present folder."""
    text = path.read_text(encoding="utf-8")
    for match in FENCE.finditer(text):
        indent, language, code = match.groups()
        code = re.sub(f"^{indent}", "", code, flags=re.MULTILINE)
        line = text.count("\n", 0, match.start(3))
        if language == "python":
            # A real file; padding gives it the line numbers of the page.
            Path("block.py").write_text("\n" * line + code, encoding="utf-8")
            print(f"{path.name}:{line}", flush=True)
            runpy.run_path("block.py", run_name="__main__")
        else:
            run_commands(code)


def run_commands(code: str) -> None:
    """Runs the lines of a shell that are commands of the package, or compile what they wrote."""
    for line in code.splitlines():
        if COMMAND.fullmatch(line):
            print(line, flush=True)
            subprocess.run(["bash", "-c", line], check=True)


def run_notebook(path: Path) -> None:
    """Runs the cells of a notebook in its folder, as a kernel does."""
    os.chdir(path.parent)
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        if cell["cell_type"] == "code":
            code = compile("".join(cell["source"]), f"{path.name}:cell {number}", "exec")
            exec(code, names)


assert not Path(capsule_gym.__file__).is_relative_to(ROOT), capsule_gym.__file__
matplotlib.use("agg")
PPO.learn = learn_once
# The commands of the pages call this Python.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
for path in find(*PAGES):
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        run_page(path)
        os.chdir(ROOT)
for path in find("notebooks/*.ipynb"):
    print(path.name, flush=True)
    run_notebook(path)
