import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from agents.analysis import __main__ as analysis
from agents.analysis import figures, limit_cycle, sensitivity
from agents.analysis.data import read_learning
from baselines.evaluation.policies import Candidate
from capsule_gym.parameters import REAL, Disturbances
from tests.agents.fakes import Sine


def cells(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line[:1] == "|"]


def test_the_last_of_two_evaluations_at_the_same_step_counts(tmp_path):
    path = tmp_path / "seed-3" / "evaluations.csv"
    path.parent.mkdir()
    path.write_text("steps,mean_speed_cm_s,failed\n100,1.0,0.0\n200,2.0,0.0\n200,5.0,0.0\n")
    steps, speeds = read_learning(tmp_path)[3]
    assert (steps.tolist(), speeds.tolist()) == ([100, 200], [1.0, 5.0])
    path.write_text("steps,mean_speed_cm_s\n")
    with pytest.raises(ValueError, match=r"evaluations\.csv must be the log of a training run"):
        read_learning(tmp_path)


def test_sensitivity_shows_speed_and_failures_under_disturbances_of_each_size(monkeypatch):
    monkeypatch.setattr(sensitivity, "EPISODES", 2)
    conditions = sensitivity.conditions()
    assert conditions['all of "real"', 1.0] == REAL
    doubled = conditions['all of "real"', 2.0]
    assert (doubled.latency, doubled.lag, doubled.drift_time) == ((0.01, 0.03), 0.01, REAL.drift_time)
    assert conditions["latency", 0.5] == Disturbances(latency=0.005)
    results = sensitivity.run([Candidate("wild", (Sine(1.5, period=10.0, name="wild"),), "")], horizon=1.0)
    head, _, wild, still = cells(sensitivity.table({**results, "still": dict.fromkeys(conditions, (0.0, 0))}))
    assert head == ["policy", "none", *sensitivity.DISTURBED, "no x_dot"]
    assert wild[1].endswith(" (2)") and still[1:] == ["0.00"] * (len(head) - 1)
    assert len(sensitivity.draw(results).axes) == len(head)


def test_a_limit_cycle_is_the_steady_one_from_its_smallest_angle_on():
    t = np.arange(0.0, 33.0, limit_cycle.DT)
    # A period of 0.8 s that begins at 27 s; before, the motion decays.
    size = 1.0 + np.exp(-t) + np.where(t < 27.0, 0.2 * np.sin(0.7 * t), 0.0)
    phase = 2.0 * np.pi * t / 0.8
    samples = np.stack([size * np.sin(phase), size * np.cos(phase), 0.1 * t, size * np.sin(phase), t, t], axis=1)
    cycle = limit_cycle.find_cycle(samples)
    assert len(cycle) == 401 and cycle[0, 4] > 26.0
    assert cycle[0, 0] == pytest.approx(-1.0) and cycle[-1, 2] - cycle[0, 2] == pytest.approx(0.08)


def test_stale_tables_are_found(tmp_path, capsys):
    assert analysis.main(["statistics", "--check", "--output", str(tmp_path)]) == 1
    assert re.search(r"statistics_tables\.md is not up to date: run `python -m", capsys.readouterr().out)


ROOT = Path(__file__).resolve().parents[2]
# Of the SVG files, which are those that were looked at: the same figure gives the same bytes.
FIGURES = {
    "learning": "7d3ba62d047e9eab",
    "transport": "ab08cab4fe354286",
    "limit_cycle": "6320fc8c0042d6b2",
}


@dataclass
class FakeRow:
    """A row whose speeds differ between five runs; a scripted one has one run, and at rest no cost."""

    name: str
    trained: bool
    speed: float

    def score(self, set_name, metric):
        runs = 1.0 + 0.02 * np.arange(5 if self.trained else 1)[:, None]
        speeds = self.speed * runs * (1.0 + 0.2 * np.linspace(-1.0, 1.0, 100) ** 3)
        return speeds if metric == figures.SPEED else np.where(speeds > 0.0, 1.0 + speeds / 10.0, np.inf)


ROWS = [
    *(FakeRow(f"direct-{n}", True, 15.0 - n) for n in range(4)),
    FakeRow("a-policy-with-a-long-name-of-several-words", True, 14.9),
    FakeRow("law", False, 3.0),
    FakeRow("rest", False, 0.0),
]


def test_the_figures_are_those_that_were_looked_at(tmp_path, monkeypatch):
    # Matplotlib's versions draw other outlines.
    if f"matplotlib=={matplotlib.__version__} " not in (ROOT / "constraints.txt").read_text(encoding="utf-8"):
        pytest.skip("needs the pinned matplotlib")
    monkeypatch.setattr(limit_cycle, "POLICIES", ("adaptive", "gait-guarded"))
    document, steps = limit_cycle.document(), np.arange(1.0, 9.0) * 1e5
    lines = document.sections["cycles"].splitlines()
    assert set(lines) <= set((ROOT / "docs" / "limit_cycle_tables.md").read_text(encoding="utf-8").splitlines())
    runs = {seed: (steps, 10.0 + seed - 1e6 / steps) for seed in range(3)}
    # Five panels, so that a place of the grid is empty.
    learning = {
        "three": runs,
        "again": runs,
        "more": runs,
        "one": {0: (steps, np.sqrt(steps) / 100.0)},
        "point": {0: (steps[:1], steps[:1] / 1e5)},
    }
    figures.write_with(figures.draw_learning, learning)(tmp_path / "learning")
    figures.write_with(figures.draw_transport, ROWS)(tmp_path / "transport")
    document.figures["limit_cycle"](tmp_path / "limit_cycle")
    drawn = {name: hashlib.sha256((tmp_path / f"{name}.svg").read_bytes()).hexdigest() for name in FIGURES}
    assert {name: digest[:16] for name, digest in drawn.items()} == FIGURES
