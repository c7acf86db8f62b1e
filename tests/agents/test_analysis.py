import re
from dataclasses import dataclass

import numpy as np
import pytest

from agents.analysis import __main__ as analysis
from agents.analysis import limit_cycle, sensitivity, statistics
from baselines.evaluation.policies import Candidate
from capsule_gym.parameters import REAL, Disturbances
from tests.agents.fakes import Sine


def cells(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line[:1] == "|"]


def test_the_last_of_two_evaluations_at_the_same_step_counts(tmp_path):
    path = tmp_path / "evaluations.csv"
    path.write_text("steps,mean_speed_cm_s,failed\n100,1.0,0.0\n200,2.0,0.0\n200,5.0,0.0\n")
    steps, speeds = statistics.read_evaluations(path)
    assert (steps.tolist(), speeds.tolist()) == ([100, 200], [1.0, 5.0])


def test_sensitivity_shows_speed_and_failures_under_each_disturbance(monkeypatch):
    monkeypatch.setattr(sensitivity, "EPISODES", 2)
    conditions = sensitivity.conditions()
    assert conditions['all of "real"'] == REAL and conditions["latency"] == Disturbances(latency=0.01)
    results = sensitivity.run([Candidate("wild", (Sine(1.5, period=10.0, name="wild"),), "")], horizon=1.0)
    head, _, wild, still = cells(sensitivity.table({**results, "still": dict.fromkeys(conditions, (0.0, 0))}))
    assert head == ["policy", "none", *sensitivity.DISTURBED, "no x_dot"]
    assert wild[1].endswith(" (2)") and still[1:] == ["0.00"] * (len(head) - 1)


def test_a_limit_cycle_is_the_steady_one_from_its_smallest_angle_on():
    t = np.arange(0.0, 33.0, limit_cycle.DT)
    # A period of 0.8 s that begins at 27 s; before, the motion decays.
    size = 1.0 + np.exp(-t) + np.where(t < 27.0, 0.2 * np.sin(0.7 * t), 0.0)
    phase = 2.0 * np.pi * t / 0.8
    samples = np.stack([size * np.sin(phase), size * np.cos(phase), 0.1 * t, size * np.sin(phase), t, t], axis=1)
    cycle = limit_cycle.find_cycle(samples)
    assert len(cycle) == 401 and cycle[0, 4] > 26.0
    assert cycle[0, 0] == pytest.approx(-1.0) and cycle[-1, 2] - cycle[0, 2] == pytest.approx(0.08)


def test_current_and_stale_tables_are_found(tmp_path, capsys):
    assert analysis.main(["limit_cycle", "statistics", "--check"]) == 0
    assert analysis.main(["statistics", "--check", "--output", str(tmp_path)]) == 1
    assert re.search(r"statistics_tables\.md is not up to date: run `python -m", capsys.readouterr().out)


def test_the_curves_of_a_row_are_those_of_its_runs():
    steps = np.arange(1.0, 9.0) * 1e5
    runs = {seed: (steps, 10.0 + seed - 1e6 / steps) for seed in range(3)}
    drawn, empty = statistics.draw_learning({"three": runs, **dict.fromkeys("abcdef", runs)}).axes[:8:7]
    assert drawn.get_title() == "three" and not empty.get_visible()
    for line, (x, y) in zip(drawn.lines, [*runs.values(), runs[1]], strict=True):  # the middle one is the mean
        np.testing.assert_allclose(line.get_xydata(), np.transpose([x / 1e6, y]), rtol=1e-12)


@dataclass
class FakeRow:
    """A row whose runs have the same speeds; at rest there is no cost."""

    name: str
    trained: bool
    speed: float

    def score(self, set_name, metric):
        speeds = self.speed * (1.0 + 0.2 * np.linspace(-1.0, 1.0, 101) ** 3) * np.ones((5, 1))
        return speeds if metric == statistics.SPEED.name else np.where(speeds > 0.0, 2.0, np.inf)


def test_policies_are_named_at_their_cost_and_speed_without_overlap():
    rows = [FakeRow(f"direct-{n}", True, 15.0 - 0.01 * n) for n in range(6)]
    axes = statistics.draw_transport([*rows, FakeRow("law", False, 3.0), FakeRow("rest", False, 0.0)]).axes[0]
    marks = [tuple(line.get_xydata()[0]) for line in axes.lines if line.get_marker() in "os" and len(line.get_xydata())]
    np.testing.assert_allclose(marks, [(2.0, row.speed) for row in rows] + [(2.0, 3.0)], rtol=1e-12)
    heights = [text.xy[1] for text in axes.texts]
    assert [text.get_text() for text in axes.texts] == [row.name for row in rows] + ["law"]
    np.testing.assert_allclose(heights, np.arange(13, 0, -2) / 14)
