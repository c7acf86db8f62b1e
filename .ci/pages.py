"""Runs the Python blocks of the pages that a beginner reads with the installed package."""

import os
import re
import runpy
import tempfile
from pathlib import Path

import capsule_gym

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/getting_started.md", "docs/faq.md")
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)

assert not Path(capsule_gym.__file__).is_relative_to(ROOT), capsule_gym.__file__
for name in PAGES:
    text = (ROOT / name).read_text(encoding="utf-8")
    for block in BLOCK.finditer(text):
        line = text.count("\n", 0, block.start()) + 1
        print(f"{name}:{line}", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            # A real file; padding gives it the line numbers of the page.
            padding = "\n" * line
            Path("block.py").write_text(padding + block[1], encoding="utf-8")
            runpy.run_path("block.py", run_name="__main__")
            os.chdir(ROOT)
