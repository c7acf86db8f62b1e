import importlib.util
import re
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    pytest.importorskip("mkdocs")
    spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def page() -> SimpleNamespace:
    return SimpleNamespace(file=SimpleNamespace(src_uri="leaderboard.md"), url="leaderboard/")


def table(*rows: Sequence[str]) -> str:
    """A table as mkdocs writes it; the first row is its head."""
    kinds = ["th"] + ["td"] * (len(rows) - 1)
    lines = ("".join(f"<{kind}>{cell}</{kind}>\n" for cell in row) for kind, row in zip(kinds, rows, strict=True))
    return "<table>\n" + "".join(f"<tr>\n{line}</tr>\n" for line in lines) + "</table>"


def test_rankings_link_to_the_live_page(hooks, page) -> None:
    rows = table(["policy", "senses"], ["<strong>Learned</strong>", ""], ["direct-ppo", "stick"], ["adaptive", "x"])
    assert re.findall(r'href="([^"]*)"', hooks.on_page_content(rows, page)) == [
        "../live/index.html#driver=direct-ppo&amp;rival=adaptive&amp;set=paper&amp;plant=0",
        "../live/index.html#driver=adaptive&amp;set=paper&amp;plant=0",
    ]
    absent = table(["policy", "senses"], ["nobody", "x"])
    assert hooks.on_page_content(absent, page) == absent
    page.file.src_uri = "evidence.md"
    assert hooks.on_page_content(rows, page) == rows


def test_a_link_to_a_scene_leads_to_the_live_page(hooks, page) -> None:
    found = hooks.on_page_markdown("See [it](live.md#driver=epc&M=0.5&t=2), [live](live.md).", page)
    assert found == 'See <a href="../live/index.html#driver=epc&amp;M=0.5&amp;t=2">it</a>, [live](live.md).'
    with pytest.raises(Exception, match="lacks: nobody"):
        hooks.on_page_markdown("[it](live.md#driver=epc&rival=nobody)", page)
