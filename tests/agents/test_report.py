import html
import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from agents.comparison import compare
from agents.report import __main__ as report
from agents.report import data, page
from agents.report.figures import broken
from agents.report.page import embed, own_controllers, render, write
from tests.agents.fakes import make_policy, write_run
from tests.agents.training.small import small

ROOT = Path(__file__).resolve().parents[2]


class Page(HTMLParser):
    """What a page consists of."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.loads, self.tags, self.rows = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.tags.append(tag)
        if "id" in given:
            self.ids.append(given["id"])
        self.loads += [given[name] for name in ("src", "srcset") if name in given]
        if tag in ("a", "link", "use", "image"):
            self.loads += [value for name, value in attrs if name.endswith("href") and not value.startswith("#")]
        if tag == "tr":
            self.rows.append([])
        if "data-value" in given:
            self.rows[-1].append(float(given["data-value"]))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run's folder with what a report reads of it."""
    folder = tmp_path_factory.mktemp("runs") / "mine"
    write_run(folder, 3)
    (folder / "evaluations.csv").write_text("steps,mean_speed_cm_s,failed\n100,1.0,0\n200,2.0,0\n")
    content = {"algo": "ppo", "seed": 3, "hyperparameters": {"gamma": 0.123, "note": "<b>"}}
    (folder / "config.json").write_text(json.dumps(content))
    return folder


@pytest.fixture(scope="module")
def both(run):
    """A row of the leaderboard, the run after short episodes, and the paper's controller."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(data, "HORIZON", 0.6)
        return data.collect(["direct-ppo", str(run)])


@pytest.fixture(scope="module")
def mine(both):
    """The same without the row of the leaderboard."""
    rows = tuple(row for row in both.results.rows if row.name != "direct-ppo")
    return replace(both, results=replace(both.results, rows=rows))


@pytest.fixture
def without_figures(mine, monkeypatch):
    """Reports of the run that need no evaluation and draw nothing."""
    monkeypatch.setattr(page, "collect", lambda *names, **options: mine)
    monkeypatch.setattr(page.figures, "to_svg", lambda *arguments: "<svg></svg>")


def test_a_report_shows_the_numbers_of_the_leaderboard(both):
    text = render(both, "A <title>", live=Path("nowhere"))
    page = Page(text)
    # A colour bar is an image, inside of the page.
    assert all(address.startswith("data:") for address in page.loads) and "iframe" not in page.tags
    assert len(page.ids) == len(set(page.ids))
    assert page.tags.count("svg") == 4
    assert "<title>A &lt;title&gt;</title>" in text and "<h1>A &lt;title&gt;</h1>" in text
    for word in ("Learning curve", "Settings of mine", "0.123", "&lt;b&gt;", ">adaptive</th>", ">mine</th>"):
        assert word in text
    assert len(text) < 3_000_000
    board = json.loads((ROOT / "leaderboard.json").read_text())
    results = {row["policy"]: row["results"] for row in board["rows"]}
    names = [row.name for row in both.results.rows]
    lines = dict(zip([(name, each) for name in names for each in board["sets"]], page.rows[1:], strict=True))
    published = [(name, each) for name in ("direct-ppo", "adaptive") for each in board["sets"]]
    expected = [results[name][each]["mean_speed"]["iqm"] for name, each in published]
    assert [lines[key][0] for key in published] == pytest.approx(expected, abs=1e-12)
    # The share of the optimum is missing on two sets of five: NaN in JavaScript.
    assert {sum(value != value for value in lines[key]) for key in published} == {0, 1}
    # Glyphs are drawn in 1/64 of a point: rounded to 0.02 they would be larger than their distances.
    assert set(re.findall(r' transform="scale\((0\.0\d*)\)', text)) == {"0.015625"}
    assert "make web" in text


@pytest.fixture
def live(tmp_path):
    """A page in the live page's place."""
    live = tmp_path / "index.html"
    live.write_text('<!doctype html><html><head><meta charset="utf-8"></head><body>"a" & b</body></html>')
    return live


def test_the_live_page_is_embedded_at_the_policy_where_it_is_built(both, without_figures, live):
    text = render(both, "t", live=live)
    (source,) = re.findall(r'srcdoc="([^"]*)"', text)
    scene = "driver=direct-ppo&rival=adaptive&set=paper&plant=0"
    begin = f'<head><script>location.hash = "{scene}"</script>'
    assert html.unescape(source) == live.read_text().replace("<head>", begin)
    assert 'title="x &lt;y&gt;"' in embed(live.read_text(), scene, "x <y>")


def test_the_users_policy_is_added_to_the_live_page(mine, without_figures, live):
    assert mine.policies["mine"].training_seed == 3
    (source,) = re.findall(r'srcdoc="([^"]*)"', render(mine, "t", live=live))
    page = html.unescape(source)
    assert 'location.hash = "driver=mine&rival=adaptive&' in page
    (found,) = re.findall(r'<script type="application/json" id="own-drivers">(.*?)</script>', page)
    (driver,) = json.loads(found)
    assert (driver["name"], driver["task"], driver["seed"]) == ("mine", "direct", 3)
    assert driver["network"] == make_policy(3)._network.tolist()


def test_what_the_live_page_cannot_run_is_left_out():
    def acting(inputs, **env_kwargs):
        layer = np.zeros((1, inputs), np.float32), np.zeros(1, np.float32)
        return make_policy(layers=(layer,), mean=np.zeros(inputs), variance=np.ones(inputs), env_kwargs=env_kwargs)

    policies = {
        "fine": make_policy(),
        "epc": make_policy(),
        "law": acting(10, controller="tests.agents.fakes:quiet"),
        "observes": acting(7, observe_parameters=True),
    }
    found = own_controllers(policies)
    # A name that the page has is not taken twice.
    assert {name: driver["name"] for name, driver in found.items()} == {
        "fine": "fine",
        "epc": "own-epc",
        "observes": "observes",
    }


def test_names_of_panels_are_broken_behind_hyphens():
    assert broken("optimum-distilled-wide") == "optimum-distilled-wide"
    assert broken("residual-ppo-seed0-20261122-160427") == "residual-ppo-seed0-\n20261122-160427"
    assert broken("x" * 60).replace("\n", "") == "x" * 60


def test_no_name_ends_the_script_that_holds_it():
    text = html.unescape(embed("<head></head>", "s", "t", [{"name": "</script><b>"}]))
    assert text.count("</script>") == 2
    assert json.loads(re.findall('own-drivers">(.*?)</script>', text)[0]) == [{"name": "</script><b>"}]


def test_the_live_page_is_built_where_there_is_none(without_figures, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "LIVE", tmp_path / "live.html")
    asked = []

    def build(command, **kwargs):
        asked.append(command[1:])
        if len(asked) > 1:
            page.LIVE.write_text("<head></head>")

    monkeypatch.setattr(page.subprocess, "run", build)
    # The first attempt fails, the third is not needed.
    for n, tags in enumerate([0, 1, 1]):
        write(tmp_path / f"{n}.html", ["mine"])
        assert Page((tmp_path / f"{n}.html").read_text()).tags.count("iframe") == tags
    assert asked == [["-m", "web.build", "--output", str(tmp_path)]] * 2
    assert "After <code>make web</code>" in (tmp_path / "0.html").read_text()


def test_a_finished_run_is_compared_and_drawn(run, without_figures, tmp_path, capsys, monkeypatch):
    folder, set_file = tmp_path / "mine", tmp_path / "two.json"
    shutil.copytree(run, folder)
    content = {"task": "direct", "algo": "ppo", "hyperparameters": small("direct", "ppo").to_dict()}
    (folder / "config.json").write_text(json.dumps(content))
    set_file.write_text(json.dumps({"name": "two", "plants": [{"M": 0.5, "mu": 0.01, "seed": n} for n in range(2)]}))
    monkeypatch.setattr(page, "LIVE", set_file)
    monkeypatch.setattr("agents.comparison.ANIMATION_SECONDS", 0.08)
    monkeypatch.setattr("agents.comparison.ANIMATION_START", 0.04)
    compare(folder, str(set_file))
    out = capsys.readouterr().out
    for word in ("mean speed", "cost of transport", "peak torque", "failures", "difference", "adaptive"):
        assert word in out
    for name in ("comparison.png", "animation.gif", "comparison.json", "report.html"):
        assert (folder / name).stat().st_size > 1000
    assert not list(folder.glob("*.tmp*"))


def test_two_policies_of_one_name_are_refused(run, tmp_path, monkeypatch):
    monkeypatch.setattr(data, "HORIZON", 0.2)
    write_run(tmp_path / "other" / "mine", 4)
    with pytest.raises(ValueError, match="different names, got mine more than once"):
        data.collect([str(run), str(tmp_path / "other" / "mine")])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nobody"], "got 'nobody'"),
        (["adaptive", "-o", "/nowhere/x.html"], "--output must name a file in a folder that exists"),
        (["adaptive", "-o", "there.html"], "--output must name a new file unless --overwrite is given"),
    ],
)
def test_wrong_options_are_named(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.html").write_text("mine")
    with pytest.raises(SystemExit) as stop:
        report.main(words)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert (tmp_path / "there.html").read_text() == "mine"
