"""The site: broken links are found, pages load nothing from elsewhere, rankings and scenes lead to the live page."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from agents.controllers import controller_names
from agents.evaluation.policies import BASELINE
from capsule_gym.evaluation_sets import SET_NAMES

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


@pytest.fixture
def page() -> SimpleNamespace:
    return SimpleNamespace(file=SimpleNamespace(src_uri="leaderboard.md"), url="leaderboard/")


def table(*rows: Sequence[str]) -> str:
    """A table as mkdocs writes it, whose first row is its head."""
    kinds = ["th"] + ["td"] * (len(rows) - 1)
    lines = ("".join(f"<{kind}>{cell}</{kind}>\n" for cell in row) for kind, row in zip(kinds, rows, strict=True))
    return "<table>\n" + "".join(f"<tr>\n{line}</tr>\n" for line in lines) + "</table>"


def test_the_live_page_has_the_drivers_that_are_linked(hooks: ModuleType) -> None:
    assert hooks.drivers() == set(controller_names())
    assert hooks.BASELINE == BASELINE
    assert set(hooks.set_names()) == set(SET_NAMES)


def test_rows_of_the_ranking_lead_to_the_live_page(hooks: ModuleType, page: SimpleNamespace) -> None:
    rows = table(["", "policy", "x adaptive"], ["1", "direct-ppo", "2"], ["2", "adaptive", "1"])
    found = hooks.on_page_content(rows, page)
    scenes = re.findall(r'href="([^"]*)"', found)
    assert scenes == [
        "../live/index.html#driver=direct-ppo&amp;rival=adaptive&amp;set=paper&amp;plant=0",
        "../live/index.html#driver=adaptive&amp;set=paper&amp;plant=0",
    ]
    assert re.findall(r"<td>(\d) <a class=\"watch\"", found) == ["1", "2"]
    with pytest.raises(Exception, match="lacks: nobody"):
        hooks.on_page_content(table(["", "policy", "x adaptive"], ["1", "nobody", "2"]), page)
    page.file.src_uri = "evidence.md"
    assert hooks.on_page_content(rows, page) == rows


def test_numbers_by_set_lead_to_their_plants(hooks: ModuleType, page: SimpleNamespace) -> None:
    names = hooks.set_names()
    rows = table(["policy", *names], ["robust", *(f"{n}.5" for n in range(len(names)))])
    found = hooks.on_page_content(rows, page)
    assert re.findall(r"set=(\w+)&amp;plant=0\">([\d.]+)</a>", found) == [
        (name, f"{n}.5") for n, name in enumerate(names)
    ]
    assert "<td>robust</td>" in found
    other = table(["policy", "seeds"], ["robust", "10"])
    assert hooks.on_page_content(other, page) == other


def test_numbers_of_tables_do_not_break_and_figures_open(hooks: ModuleType, page: SimpleNamespace) -> None:
    page.file.src_uri = "physics.md"
    found = hooks.on_page_content('<a title="5 %">5 %</a>' + table(["mu"], ["2.1e-12 (1e-9)"], ["3.5 %, x 2.0"]), page)
    assert re.findall('<span class="number">(.*?)</span>', found) == ["2.1e-12", "1e-9", "3.5 %", "x 2.0"]
    found = hooks.on_page_content('<img alt="a" src="../figures/a.png" /><img src="../media/b.gif" />', page)
    assert found == (
        '<a href="../figures/a.png" title="By itself"><img alt="a" src="../figures/a.png" /></a>'
        '<img src="../media/b.gif" />'
    )


def test_a_link_to_a_scene_leads_to_the_live_page(hooks: ModuleType, page: SimpleNamespace) -> None:
    found = hooks.on_page_markdown("See [it](live.md#driver=epc&M=0.5&t=2), [live](live.md).", page)
    assert found == 'See <a href="../live/index.html#driver=epc&amp;M=0.5&amp;t=2">it</a>, [live](live.md).'
    page.url = ""
    assert '"live/index.html#driver=epc"' in hooks.on_page_markdown("[it](live.md#driver=epc)", page)
    with pytest.raises(Exception, match="lacks: nobody"):
        hooks.on_page_markdown("[it](live.md#driver=epc&rival=nobody)", page)


def test_no_page_lies_where_the_live_page_comes_to_lie(hooks: ModuleType) -> None:
    from mkdocs.structure.files import File, Files

    files = Files([File(name, "docs", "site", True) for name in ("index.md", "live.md")])
    page = hooks.on_files(files, None).get_file_from_path("live.md")
    assert page.dest_uri == f"{page.url}index.html"
    assert not page.dest_uri.startswith(hooks.LIVE)
    files.append(File("live/more.md", "docs", "site", True))
    with pytest.raises(Exception, match=re.escape("the same folder live/ as live/more.md")):
        hooks.on_files(files, None)
