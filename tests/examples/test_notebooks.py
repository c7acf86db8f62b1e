"""The notebooks are committed with what they show, none of it an error, and small."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "notebooks").glob("*.ipynb"))


def outputs(path: Path) -> list[dict[str, Any]]:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [output for cell in cells for output in cell.get("outputs", [])]


def test_there_are_five() -> None:
    assert len(NOTEBOOKS) == 5


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_shows_what_it_printed(path: Path) -> None:
    shown = outputs(path)
    assert shown
    assert all(output["output_type"] != "error" for output in shown)
    figures = [output["data"]["image/png"] for output in shown if "image/png" in output.get("data", {})]
    assert figures
    assert max(len(base64.b64decode(figure)) for figure in figures) < 200_000
