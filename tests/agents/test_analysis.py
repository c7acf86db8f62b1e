import re
from dataclasses import dataclass

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from agents.analysis import __main__ as analysis
from agents.analysis import limit_cycle, sensitivity, statistics
from baselines.drawing import BLUE, GREEN, INK, MUTED
from baselines.dynamic_programming.archive import optimal_front
from baselines.evaluation.policies import Candidate
from baselines.evaluation.statistics import estimate
from capsule_gym.parameters import REAL, Disturbances
from tests.agents.fakes import Sine


def cells(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line[:1] == "|"]


def test_the_last_of_two_evaluations_at_the_same_step_counts(tmp_path):
    path = tmp_path / "evaluations.csv"
    path.write_text("steps,mean_speed_cm_s,failed\n100,1.0,0.0\n200,2.0,0.0\n200,5.0,0.0\n")
    steps, speeds = statistics.read_evaluations(path)
    assert (steps.tolist(), speeds.tolist()) == ([100, 200], [1.0, 5.0])


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


def test_a_cycle_is_drawn_in_its_units_above_the_phases_of_its_contact():
    phase = 2.0 * np.pi * np.arange(401.0) / 400.0
    x = 0.01 * np.array([*np.arange(101.0), *[100.0] * 200, *np.arange(99.0, -1.0, -1.0)])
    cycle = np.stack([np.sin(phase), 3.0 * np.cos(phase), x, np.cos(phase), 3.0 + phase, np.sin(phase)], axis=1)
    figure = limit_cycle.draw({"one": cycle, "two": cycle[:201]})
    columns = np.reshape(figure.axes, (5, 2)).T
    assert [column[0].get_title() for column in columns] == ["one", "two"]
    units, weight = ("θ (deg)", "x' (cm/s)", "N / ((M + m) g)", "u (N m)", "θ' (rad/s)"), 0.638 * 9.81
    assert [axes.get_ylabel() for axes in columns[0]] == list(units)
    for column, drawn in zip(columns, (cycle, cycle[:201]), strict=True):
        t, degrees = 0.002 * np.arange(len(drawn)), np.degrees(drawn[:, 0])
        for axes, values, level in zip(
            column,
            (degrees, 100.0 * drawn[:, 3], drawn[:, 4] / weight, drawn[:, 5]),
            (0.0, 0.0, 1.0, 0.0),
            strict=False,
        ):
            rest, line = axes.lines
            assert rest.get_ydata() == [level] * 2 and axes.get_xlim() == (0.0, t[-1])
            np.testing.assert_allclose(line.get_xydata(), np.transpose([t, values]), rtol=1e-12)
            colours = [to_rgba(limit_cycle.PHASES[sign][1]) for sign in (1, 0, -1)]
            places = [(0.0, 0.2), (0.2, 0.6), (0.6, 0.8)] if len(drawn) == 401 else [(0.0, 0.2), (0.2, 0.4)]
            ends = [(span.get_x(), span.get_x() + span.get_width()) for span in axes.patches]
            np.testing.assert_allclose(ends, places, atol=1e-12)
            assert [span.get_facecolor() for span in axes.patches] == colours[: len(ends)]
        np.testing.assert_allclose(column[4].lines[0].get_xydata(), np.transpose([degrees, drawn[:, 1]]), rtol=1e-12)
        assert [column[3].get_xlabel(), column[4].get_xlabel()] == ["time (s)", "θ (deg)"]
    assert [text.get_text() for text in figure.legends[0].texts] == ["slips forward", "sticks", "slips backward"]


def test_current_and_stale_tables_are_found(tmp_path, capsys):
    assert analysis.main(["limit_cycle", "statistics", "--check"]) == 0
    assert analysis.main(["statistics", "--check", "--output", str(tmp_path)]) == 1
    assert re.search(r"statistics_tables\.md is not up to date: run `python -m", capsys.readouterr().out)


def test_the_curves_of_a_row_are_those_of_its_runs_and_its_table_their_end():
    steps = np.arange(1.0, 9.0) * 1e5
    runs = {seed: (steps, 10.0 + seed - 1e6 / steps) for seed in range(3)}
    figure = statistics.draw_learning({"three": runs, **dict.fromkeys("abcdef", runs)})
    drawn, empty = figure.axes[:8:7]
    assert drawn.get_title() == "three" and not empty.get_visible() and figure.get_supylabel().endswith("(cm/s)")
    assert drawn.get_xlim()[0] == drawn.get_ylim()[0] == 0.0
    for line, (x, y) in zip(drawn.lines, [*runs.values(), runs[1]], strict=True):  # the middle one is the mean
        np.testing.assert_allclose(line.get_xydata(), np.transpose([x / 1e6, y]), rtol=1e-12)
    assert [line.get_color() for line in drawn.lines] == [MUTED] * 3 + [BLUE]
    last = estimate(np.array([[8.75], [9.75], [10.75]]))
    band = drawn.collections[0].get_paths()[0].vertices
    np.testing.assert_allclose(
        [band[:, 1].min(), *band[band[:, 0] == 0.8][:, 1].max(keepdims=True)],
        [estimate(np.array([[0.0], [1.0], [2.0]])).low, last.high],
    )
    cells_of = cells(statistics.table({"three": runs, "none": {}}))
    assert cells_of[0][2:] == ["steps", "mean speed (cm/s) at the end", "steps to 90 % of that"]
    # 11 - 10 / n reaches 90 % of 9.75 at n = 5.
    assert cells_of[2] == ["three", "3", "800,000", f"9.75 [{last.low:.2f}, {last.high:.2f}]", "500,000"]


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
    figure = statistics.draw_transport([*rows, FakeRow("law", False, 3.0), FakeRow("rest", False, 0.0)])
    axes = figure.axes[0]
    marks = [tuple(line.get_xydata()[0]) for line in axes.lines if line.get_marker() in "os" and len(line.get_xydata())]
    np.testing.assert_allclose(marks, [(2.0, row.speed) for row in rows] + [(2.0, 3.0)], rtol=1e-12)
    heights = [text.xy[1] for text in axes.texts]
    assert [text.get_text() for text in axes.texts] == [row.name for row in rows] + ["law"]
    assert np.diff(heights).max() <= -statistics.LABEL_SPACING + 1e-12 and max(heights) <= 1.0 and min(heights) >= 0.0
    assert [axes.get_xlabel(), axes.get_xscale(), axes.get_ylabel()] == [
        "cost of transport",
        "log",
        "mean speed (cm/s)",
    ]
    assert "without a cost: rest." in " ".join(figure.get_supxlabel().split())
    names = [text.get_text().partition(",")[0] for text in figure.legends[0].texts]
    front, *others = figure.legends[0].legend_handles
    assert names == ["dynamic programming", "trained", "scripted"]
    assert [each.get_color() for each in (front, *others)] == [GREEN, BLUE, INK]
    np.testing.assert_allclose(axes.lines[0].get_xydata(), list(optimal_front()))
    # The intervals of trained rows; that of a cost without spread is a point.
    speed = estimate(rows[0].score("nominal", statistics.SPEED.name))
    for line, ends in zip(
        axes.lines[1:3], ([[2.0, speed.value]] * 2, [[2.0, speed.low], [2.0, speed.high]]), strict=True
    ):
        np.testing.assert_allclose(line.get_xydata(), ends, rtol=1e-12)
