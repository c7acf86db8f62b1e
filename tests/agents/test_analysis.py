import re
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from agents.analysis import __main__ as analysis
from agents.analysis import curves, limit_cycle, sensitivity
from baselines.drawing import BLUE, GREEN, INK, MUTED, new_figure
from baselines.dynamic_programming.archive import optimal_front
from capsule_gym.evaluation.candidates import Candidate, find_candidate
from capsule_gym.evaluation.statistics import estimate
from capsule_gym.parameters import REAL, Disturbances
from tests.agents.fakes import Sine
from tests.agents.leaderboard.world import table
from tests.figures import assert_lines, texts


def test_the_last_of_two_evaluations_at_the_same_step_counts(tmp_path):
    path = tmp_path / "evaluations.csv"
    path.write_text("steps,mean_speed_cm_s,failed\n100,1.0,0.0\n200,2.0,0.0\n200,5.0,0.0\n")
    steps, speeds = curves.read_evaluations(path)
    assert (steps.tolist(), speeds.tolist()) == ([100, 200], [1.0, 5.0])


def test_sensitivity_shows_speed_and_failures_under_each_disturbance(monkeypatch):
    row = sensitivity.table(sensitivity.run([find_candidate("pd")])).splitlines()[-1]
    assert (
        row
        in (analysis.ROOT / "docs/sensitivity_tables.md").read_text(encoding="utf-8").splitlines()
    )
    monkeypatch.setattr(sensitivity, "EPISODES", 2)
    conditions = sensitivity.conditions()
    assert conditions['all of "real"'] == REAL and conditions["latency"] == Disturbances(
        latency=0.01
    )
    results = sensitivity.run(
        [Candidate("wild", (Sine(1.5, period=10.0, name="wild"),), "")], horizon=1.0
    )
    head, _, wild, still = table(
        sensitivity.table({**results, "still": dict.fromkeys(conditions, (0.0, 0))})
    )
    assert head == ["policy", "none", *sensitivity.DISTURBED, "no x_dot"]
    assert wild[1].endswith(" (2)") and still[1:] == ["0.00"] * (len(head) - 1)


def test_a_limit_cycle_is_the_steady_one_from_its_smallest_angle_on():
    t = np.arange(0.0, 33.0, limit_cycle.DT)
    # A period of 0.8 s that begins at 27 s; before, the motion decays.
    size = 1.0 + np.exp(-t) + np.where(t < 27.0, 0.2 * np.sin(0.7 * t), 0.0)
    phase = 2.0 * np.pi * t / 0.8
    samples = np.stack(
        [size * np.sin(phase), size * np.cos(phase), 0.1 * t, size * np.sin(phase), t, t], axis=1
    )
    cycle = limit_cycle.find_cycle(samples)
    assert len(cycle) == 401 and cycle[0, 4] > 26.0
    assert cycle[0, 0] == pytest.approx(-1.0) and cycle[-1, 2] - cycle[0, 2] == pytest.approx(0.08)


def test_a_cycle_is_drawn_in_its_units_above_the_phases_of_its_contact():
    phase = 2.0 * np.pi * np.arange(401.0) / 400.0
    x = 0.01 * np.array([*np.arange(101.0), *[100.0] * 200, *np.arange(99.0, -1.0, -1.0)])
    cycle = np.stack(
        [np.sin(phase), 3.0 * np.cos(phase), x, np.cos(phase), 3.0 + phase, np.sin(phase)], axis=1
    )
    figure = limit_cycle.draw({"one": cycle, "two": cycle[:201]})
    columns, grey = np.reshape(figure.axes, (5, 2)).T, [0.0, 1.0]
    units, weight = (
        ("θ (deg)", "x' (cm/s)", "N / ((M + m) g)", "u (N m)", "θ' (rad/s)"),
        0.638 * 9.81,
    )
    assert [axes.get_ylabel() for axes in columns[0]] == list(units)
    assert figure.get_supxlabel() and texts(figure.legends[0].texts) == [
        "slips forward",
        "sticks",
        "slips backward",
    ]
    colours = [to_hex(limit_cycle.PHASES[sign][1]) for sign in (1, 0, -1)]
    drawings = ("one", cycle, [0.0, 0.2, 0.6, 0.8]), ("two", cycle[:201], [0.0, 0.2, 0.4])
    for column, (name, drawn, ends) in zip(columns, drawings, strict=True):
        t, degrees = 0.002 * np.arange(len(drawn)), np.degrees(drawn[:, 0])
        for n, values in enumerate(
            (degrees, 100.0 * drawn[:, 3], drawn[:, 4] / weight, drawn[:, 5])
        ):
            assert_lines(column[n], (grey, [float(n == 2)] * 2, MUTED), (t, values, INK))
            spans = [(span.get_x(), span.get_x() + span.get_width()) for span in column[n].patches]
            np.testing.assert_allclose(spans, list(pairwise(ends)), atol=1e-12)
            assert [to_hex(span.get_facecolor()) for span in column[n].patches] == colours[
                : len(spans)
            ]
            assert column[n].get_xlim() == (0.0, t[-1])
        assert_lines(column[4], (degrees, drawn[:, 1], BLUE))
        assert [column[0].get_title(), *(each.get_xlabel() for each in column[3:])] == [
            name,
            "time (s)",
            "θ (deg)",
        ]


def test_current_and_stale_tables_are_found(tmp_path, capsys, refused):
    assert analysis.main(["limit_cycle", "curves", "--check"]) == 0
    assert analysis.main(["curves", "--check", "--output", str(tmp_path)]) == 1
    assert re.search(
        r"curves_tables\.md is not up to date: run `python -m", capsys.readouterr().out
    )
    refused(analysis.main, ["curves", "--output", __file__])


def test_the_curves_of_a_row_are_those_of_its_runs_and_its_table_their_end():
    steps = np.arange(1.0, 9.0) * 1e5
    runs = {seed: (steps, 10.0 + seed - 1e6 / steps) for seed in range(3)}
    figure = curves.draw_learning({"three": runs, **dict.fromkeys("abcdef", runs)})
    drawn, _, _, above, _, _, _, empty = figure.axes
    assert (
        drawn.get_title() == "three"
        and not empty.get_visible()
        and figure.get_supylabel().endswith("(cm/s)")
    )
    assert drawn.get_xlim()[0] == drawn.get_ylim()[0] == 0.0
    seeds = [(x / 1e6, y) for x, y in runs.values()]
    assert_lines(
        drawn, *((*each, MUTED) for each in seeds), (*seeds[1], BLUE)
    )  # the middle one is the mean
    first, last = (estimate(np.array([[0.0], [1.0], [2.0]]) + start) for start in (0.0, 8.75))
    band = drawn.collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[band[:, 0] == 0.8][:, 1].max()) == pytest.approx(
        (first.low, last.high)
    )
    other = curves.draw_learning({"goal": runs}, "time to the goal (s)")
    assert other.axes[0].get_yscale() == "log" and other.get_supylabel() == "time to the goal (s)"
    assert (
        other.axes[0].yaxis.get_major_formatter()(20.0) == "20"
        and above.xaxis.get_tick_params()["labelbottom"]
    )
    cells = table(curves.table({"three": runs, "none": {}}))
    assert cells[0][2:] == ["steps", "mean speed (cm/s) at the end", "steps to 90 % of that"]
    # 11 - 10 / n reaches 90 % of 9.75 at n = 5.
    assert cells[2] == [
        "three",
        "3",
        "800,000",
        f"9.75 [{last.low:.2f},\N{NO-BREAK SPACE}{last.high:.2f}]",
        "500,000",
    ]


@dataclass
class FakeRow:
    """A row whose runs have the same speeds; at rest there is no cost."""

    name: str
    trained: bool
    speed: float

    def score(self, set_name, metric):
        speeds = self.speed * (1.0 + 0.2 * np.linspace(-1.0, 1.0, 101) ** 3) * np.ones((5, 1))
        return speeds if metric == curves.SPEED.name else np.where(speeds > 0.0, 2.0, np.inf)


def test_policies_are_named_at_their_cost_and_speed_without_overlap():
    rows = [FakeRow(f"direct-{n}", True, 15.0 - 0.01 * n) for n in range(6)]
    figure = curves.draw_transport([*rows, FakeRow("law", False, 3.0), FakeRow("rest", False, 0.0)])
    axes = figure.axes[0]
    marks = [
        tuple(line.get_xydata()[0])
        for line in axes.lines
        if line.get_marker() in "os" and len(line.get_xydata())
    ]
    np.testing.assert_allclose(marks, [(2.0, row.speed) for row in rows] + [(2.0, 3.0)], rtol=1e-12)
    assert texts(axes.texts) == [row.name for row in rows] + ["law"]
    # A line leads from each name to its mark.
    np.testing.assert_allclose([text.xy for text in axes.texts], marks)
    np.testing.assert_allclose([text.xyann[1] for text in axes.texts], np.arange(13, 0, -2) / 14)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("cost of transport", "mean speed (cm/s)")
    assert "without a cost: rest." in " ".join(figure.get_supxlabel().split())
    labels, handles = texts(figure.legends[0].texts), figure.legends[0].legend_handles
    assert [label.partition(",")[0] for label in labels] == [
        "dynamic programming",
        "trained",
        "scripted",
    ]
    assert [each.get_color() for each in handles] == [GREEN, BLUE, INK]
    # The intervals of trained rows; that of a cost without spread is a point.
    speed, (front, across, along) = (
        estimate(rows[0].score("nominal", curves.SPEED.name)),
        axes.lines[:3],
    )
    np.testing.assert_allclose(front.get_xydata(), list(optimal_front()))
    np.testing.assert_allclose(across.get_xydata(), [[2.0, speed.value]] * 2)
    np.testing.assert_allclose(along.get_xydata(), [[2.0, speed.low], [2.0, speed.high]])


def test_tables_and_figures_are_written_and_up_to_date(tmp_path, monkeypatch, capsys):
    made = SimpleNamespace(document=lambda: ({"speeds": "|a|"}, {"one": lambda: new_figure(1.0)}))
    monkeypatch.setattr(analysis, "DOCUMENTS", {"curves": made})
    assert analysis.main(["--output", str(tmp_path / "new")]) == 0
    assert capsys.readouterr().out == "Written: curves\n"
    found = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")}
    assert found == {"new/curves_tables.md", "new/figures/one.png", "new/figures/one.svg"}
    assert "[start:speeds] -->\n|a|\n" in (tmp_path / "new/curves_tables.md").read_text(
        encoding="utf-8"
    )
    assert analysis.main(["--check", "--output", str(tmp_path / "new")]) == 0
