"""Every Python block of the README and of the page on control laws runs as it is printed."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```python\b[^\n]*\n(.*?)^```\s*$", re.DOTALL | re.MULTILINE)


def blocks(name: str) -> list[tuple[str, int, str]]:
    """(file, line before the code, code) of each fenced Python block."""
    path = ROOT / name
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return [(name, text.count("\n", 0, match.start(1)), match[1]) for match in BLOCK.finditer(text)]


BLOCKS = [block for name in ("README.md", "docs/controllers.md") for block in blocks(name)]


def test_readme_has_an_example() -> None:
    assert blocks("README.md")


@pytest.mark.parametrize(("name", "line", "code"), BLOCKS, ids=[f"{name}:{line + 1}" for name, line, _ in BLOCKS])
def test_block_runs(name: str, line: int, code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("MPLBACKEND", "agg")
    # A real file, because compiled control laws read their own source; padded, so that line numbers are the page's.
    script = tmp_path / f"{Path(name).stem}.py"
    script.write_text("\n" * line + code, encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")
