"""The site: broken links are found, pages load nothing from elsewhere, the leaderboard leads to the live page."""

from __future__ import annotations

import importlib.util
import re
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
def site(tmp_path: Path) -> Path:
    """Two pages and a picture, all of whose links are good."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "a b.png").write_bytes(b"")
    (tmp_path / "index.html").write_text(
        '<a href="sub/">sub</a><a href="https://example.org/x">away</a><a href="#here">here</a>'
        '<a href="live/index.html#driver=epc">live</a><img src="data:image/png;base64,AA==">'
    )
    (tmp_path / "sub" / "index.html").write_text(
        '<img src="../a%20b.png"><a href="/base/">home</a><a href="/base/sub/index.html?x#y">self</a>'
        '<a href="mailto:a@example.org">mail</a><link rel="canonical" href="https://example.org/sub/">'
    )
    return tmp_path


def test_good_links_pass(hooks: ModuleType, site: Path) -> None:
    assert list(hooks.broken_links(site, "/base/")) == []


@pytest.mark.parametrize(
    ("tag", "message"),
    [
        ('<img src="gone.png">', "sub/index.html links to gone.png, which does not exist"),
        ('<a href="../gone/">x</a>', "sub/index.html links to ../gone/, which does not exist"),
        ('<a href="/base/gone.html">x</a>', "sub/index.html links to /base/gone.html, which does not exist"),
        ('<script src="https://cdn.example.org/x.js"></script>', "loads https://cdn.example.org/x.js from elsewhere"),
        ('<link rel="stylesheet" href="//example.org/x.css">', "loads //example.org/x.css from elsewhere"),
    ],
)
def test_broken_links_are_named(hooks: ModuleType, site: Path, tag: str, message: str) -> None:
    page = site / "sub" / "index.html"
    page.write_text(page.read_text() + tag)
    (found,) = hooks.broken_links(site, "/base/")
    assert message in found
    with pytest.raises(Exception, match=re.escape(message)):
        hooks.on_post_build({"site_dir": str(site), "site_url": "https://example.org/base/"})


def test_rows_of_the_ranking_lead_to_the_live_page(hooks: ModuleType) -> None:
    row = "<tr>\n<td>1</td>\n<td>direct-ppo</td>\n<td>18.24</td>\n</tr>"
    page = SimpleNamespace(file=SimpleNamespace(src_uri="leaderboard.md"))
    found = hooks.on_page_content(row, page)
    assert 'href="../live/index.html#driver=direct-ppo&amp;rival=adaptive&amp;set=paper&amp;plant=0"' in found
    assert "<td>direct-ppo</td>" in found
    page.file.src_uri = "evidence.md"
    assert hooks.on_page_content(row, page) == row
