import csv

import numpy as np
import pytest

from agents.evaluation import policies
from agents.evaluation.statistics import Estimate
from agents.evidence import __main__ as evidence_main
from agents.evidence import material
from agents.evidence.figures import _spread, draw_all
from agents.evidence.material import BASE, fronts, gather, improvements, read_learning
from agents.evidence.page import render
from agents.leaderboard.rows import COLUMNS, RESULTS, Row, save_row
from tests.agents.leaderboard.world import make_set

SETS = (
    make_set("nominal", *[(0.5, 0.01)] * 4),
    make_set("paper", *[(0.5, 0.01)] * 4),
    make_set("wide", *[(0.5, 0.01)] * 4),
)


def make_row(name, seeds=(), speed=1.0, base=None, failed=0):
    """A row whose speeds are known: each seed half a centimetre per second faster than the one before."""
    count = max(1, len(seeds))
    scores = {}
    for each in SETS:
        values = np.ones((len(COLUMNS), count, 4))
        values[COLUMNS.index("mean_speed")] = speed + 0.5 * np.arange(count)[:, None]
        values[COLUMNS.index("failed")] = 0.0
        values[COLUMNS.index("failed"), -1, :failed] = 1.0
        scores[each.name] = values
    header = {
        "policy": name,
        "description": name,
        "training_seeds": list(seeds),
        "revision": None,
        "files": {},
        "base": base,
        "metrics": list(COLUMNS),
        "sets": {each.name: each.hash for each in SETS},
        "versions": {},
        "disturbed": {"low": 0.0, "high": 0.0},
    }
    return Row(header, scores)


def write_evaluations(folder, seed, speeds):
    path = folder / f"seed-{seed}" / "evaluations.csv"
    path.parent.mkdir(parents=True)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["steps", "mean_speed_cm_s", "failed"])
        writer.writeheader()
        writer.writerows({"steps": 100 * (n + 1), "mean_speed_cm_s": v, "failed": 0.0} for n, v in enumerate(speeds))


ROWS = [
    make_row("adaptive", speed=1.0),
    make_row("direct-ppo", (0, 1, 2), speed=17.0, failed=2),
    make_row("residual", (0, 1), speed=9.0, base="adaptive"),
    make_row("still", speed=0.0),
]
ROWS[-1].scores["nominal"][COLUMNS.index("cost_of_transport")] = np.inf


@pytest.fixture
def evidence(tmp_path):
    for seed, end in ((0, 9.0), (1, 10.0)):
        write_evaluations(tmp_path / "residual", seed, [1.0, end - 1.0, end])
    return gather(ROWS, SETS, tmp_path)


def cells(text, section):
    part = text.split(f"[start:{section}] -->")[1].split("<!-- --8<-- [end")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in part.splitlines() if line[:1] == "|"]


def test_rows_stand_in_the_order_of_their_speed(evidence):
    assert [row.name for row in evidence.rows] == ["direct-ppo", "residual", "adaptive", "still"]
    assert [row.name for row in evidence.trained] == ["direct-ppo", "residual"]


def test_references_are_found_by_name_or_as_the_base(evidence):
    direct, residual = evidence.trained
    assert evidence.reference(residual, "adaptive").name == "adaptive"
    assert evidence.reference(residual, BASE).name == "adaptive"
    assert evidence.reference(residual, "direct-ppo").name == "direct-ppo"
    assert evidence.reference(direct, BASE) is None
    assert evidence.reference(direct, "direct-ppo") is None


def test_tables(evidence):
    text = render(evidence)
    failures = cells(text, "failures")
    assert failures[0][2:] == ["nominal", "paper", "wide"]
    assert failures[2] == ["direct-ppo", "3", *["2/12 (16.7 %, worst seed 2)"] * 3]
    assert failures[4] == ["adaptive", "-", *["0/4"] * 3]
    differences = {(row[0], row[1]): row[2:] for row in cells(text, "differences")}
    assert differences["direct-ppo", "paper"] == ["+16.50 [+16.00, +17.00]", "-", "-", "-"]
    against, direct, base, name = differences["residual", "wide"]
    assert against == base == "+8.25 [+8.00, +8.50]"
    assert direct.startswith("-8.25 [") and name == "adaptive"
    assert cells(text, "improvement")[2] == ["direct-ppo", "residual", *["1.00 [1.00, 1.00]"] * 2]
    learning = cells(text, "learning")
    assert learning[2] == ["residual", "2", "300", "9.50 [9.00, 10.00]", "300"]
    assert "Without committed evaluations: direct-ppo." in text


def test_without_learning_curves_the_page_says_so(tmp_path):
    text = render(gather(ROWS, SETS, tmp_path))
    assert "No committed run has its evaluations with it yet." in text
    assert "evidence_learning" not in text


def test_every_pair_of_rows_is_compared_both_ways(evidence, monkeypatch):
    calls = []

    def improvement(row, other, set_name):
        calls.append((row.name, other.name))
        return Estimate(0.75, 0.5, 0.8, "seeds")

    monkeypatch.setattr(material, "improvement", improvement)
    found = improvements(evidence.rows[:3], "paper")
    assert len(calls) == 3 and len(found) == 6
    back = found["residual", "direct-ppo"]
    assert (back.value, back.low, back.high) == pytest.approx((0.25, 0.2, 0.5))


def test_figures(evidence, tmp_path):
    written = draw_all(evidence, tmp_path)
    names = {path.name for path in written}
    assert names == {
        f"evidence_{name}.{suffix}"
        for name in ("transport", "profiles", "differences", "improvement", "learning")
        for suffix in ("png", "svg")
    }
    assert all(path.stat().st_size > 5000 for path in written)


def test_figures_that_lack_material_are_left_out(tmp_path):
    scripted = gather([row for row in ROWS if not row.trained], SETS, tmp_path)
    assert {path.stem for path in draw_all(scripted, tmp_path)} == {"evidence_transport"}


def test_labels_keep_their_order_and_their_distance():
    heights = np.random.default_rng(0).random(20)
    places = _spread(heights, 0.05)
    np.testing.assert_array_equal(np.argsort(places), np.argsort(heights))
    assert np.diff(np.sort(places)).min() >= 0.05 - 1e-12
    assert places.min() >= -1e-12 and places.max() <= 1.0 + 1e-12
    np.testing.assert_allclose(_spread([0.1, 0.9], 0.05), [0.1, 0.9])


def test_fronts_rise_with_their_cost():
    for points in fronts().values():
        costs, speeds = np.array(points).T
        assert (np.diff(costs) >= 0.0).all() and (np.diff(speeds) >= 0.0).all()


def test_the_last_of_two_evaluations_at_the_same_step_counts(tmp_path):
    write_evaluations(tmp_path, 3, [1.0, 2.0])
    with (tmp_path / "seed-3" / "evaluations.csv").open("a") as file:
        file.write("200,5.0,0.0\n")
    steps, speeds = read_learning(tmp_path).seeds[3]
    assert (steps.tolist(), speeds.tolist()) == ([100, 200], [1.0, 5.0])


def test_broken_evaluations_are_named(tmp_path):
    write_evaluations(tmp_path / "learnt", 0, [])
    with pytest.raises(ValueError, match=r"evaluations\.csv must be what a training run writes"):
        read_learning(tmp_path / "learnt")
    (tmp_path / "learnt" / "seed-0" / "evaluations.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match="got KeyError"):
        read_learning(tmp_path / "learnt")


def test_another_set_is_refused(tmp_path):
    with pytest.raises(ValueError, match="the hash of the set paper"):
        gather(ROWS, [*SETS[:1], make_set("paper", (0.5, 0.02))], tmp_path)


def test_command_line(tmp_path, monkeypatch, capsys):
    class Named:
        def __init__(self, name):
            self.name = name

    monkeypatch.setattr(evidence_main, "all_candidates", lambda: [Named(row.name) for row in ROWS])
    monkeypatch.setattr(evidence_main, "SET_NAMES", ("nominal", "paper", "wide"))
    monkeypatch.setattr(evidence_main, "load_set", lambda name: next(s for s in SETS if s.name == name))
    monkeypatch.setattr(policies, "CHECKPOINTS", tmp_path / "checkpoints")
    with pytest.raises(SystemExit) as stop:
        evidence_main.main([], root=tmp_path)
    assert stop.value.code == 2 and "adaptive: has no results" in capsys.readouterr().err
    for row in ROWS:
        save_row(tmp_path / RESULTS, row)
    (tmp_path / "docs" / "figures").mkdir(parents=True)
    assert evidence_main.main(["--check"], root=tmp_path) == 1
    assert evidence_main.main([], root=tmp_path) == 0
    assert evidence_main.main(["--check"], root=tmp_path) == 0
    assert (tmp_path / "docs" / "figures" / "evidence_transport.png").is_file()
    assert "docs/evidence_tables.md is what the results give." in capsys.readouterr().out
