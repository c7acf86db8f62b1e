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


def test_sensitivity_of_a_law_is_that_of_the_documentation():
    results = sensitivity.run([find_candidate("pd")])
    *_, row = sensitivity.table(results).splitlines()
    page = (analysis.ROOT / "docs/sensitivity_tables.md").read_text(encoding="utf-8")
    assert row in page.splitlines()


def test_the_documentation_has_the_sizes_of_the_disturbances(monkeypatch):
    monkeypatch.setattr(sensitivity, "all_candidates", list)
    sections, figures = sensitivity.document()
    page = (analysis.ROOT / "docs/sensitivity_tables.md").read_text(encoding="utf-8")
    assert f"[start:sizes] -->\n{sections['sizes']}\n<!--" in page
    assert sections["speeds"].startswith("|policy|none|")
    assert figures == {}


def test_disturbances_have_the_sizes_of_real():
    conditions = sensitivity.conditions()
    assert conditions['all of "real"'] == REAL
    assert conditions["latency"] == Disturbances(latency=0.01)


def test_sensitivity_shows_speed_and_failures_under_each_disturbance(monkeypatch):
    monkeypatch.setattr(sensitivity, "EPISODES", 2)
    falling = Candidate("wild", (Sine(1.5, period=10.0, name="wild"),), "")
    before_the_fall = sensitivity.run([falling], horizon=0.1)["wild"]
    assert not any(failed for _, failed in before_the_fall.values())
    results = sensitivity.run([falling], horizon=1.0)
    results["still"] = dict.fromkeys(sensitivity.conditions(), (0.0, 0))
    head, _, wild, still = table(sensitivity.table(results))
    assert head == ["policy", "none", *sensitivity.DISTURBED, "no x_dot"]
    assert wild[1].endswith(" (2)")
    assert still[1:] == ["0.00"] * (len(head) - 1)


def test_a_limit_cycle_is_the_steady_one_from_its_smallest_angle_on():
    t = np.arange(0.0, 33.0, limit_cycle.DT)
    # A period of 0.8 s. The small velocity of the platform is steady from 27 s on, where that of
    # the pendulum grows a little.
    phase = 2.0 * np.pi * t / 0.8
    theta = (1.0 + np.exp(-t)) * np.sin(phase)
    theta_dot = (1.0 + np.exp(-t) + 0.001 * np.maximum(t - 27.0, 0.0)) * np.cos(phase)
    x_dot = 0.001 * (1.0 + 0.1 * np.maximum(27.0 - t, 0.0)) * np.cos(phase)
    samples = np.stack([theta, theta_dot, 0.1 * t, x_dot, t, t], axis=1)
    angles, _, x, _, times, _ = limit_cycle.find_cycle(samples).T
    assert len(times) == 401
    assert times[0] > 26.0
    assert angles[0] == pytest.approx(-1.0)
    assert x[-1] - x[0] == pytest.approx(0.08)


@pytest.fixture
def cycle():
    """A cycle of 0.8 s that moves forward, rests for half of it, and moves back."""
    turns = np.arange(401.0) / 400.0
    phase = 2.0 * np.pi * turns
    x = np.interp(turns, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, 1.0, 0.0])
    sine, cosine = np.sin(phase), np.cos(phase)
    return np.stack([sine, 3.0 * cosine, x, cosine, 3.0 + phase, sine], axis=1)


def test_the_rows_of_a_figure_of_cycles_are_named(cycle):
    figure = limit_cycle.draw({"one": cycle, "two": cycle[:201]})
    names = ["θ (deg)", "x' (cm/s)", "N / ((M + m) g)", "u (N m)", "θ' (rad/s)"]
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == names
    assert texts(figure.legends[0].texts) == ["slips forward", "sticks", "slips backward"]
    assert figure.get_supxlabel()
    # Above the phase portrait, whose angles have labels as well.
    labelled = [axes.xaxis.get_tick_params()["labelbottom"] for axes in figure.axes[::2]]
    assert labelled == [False, False, False, True, True]


@pytest.mark.parametrize("name", ["limit_cycle", "curves", "information"])
def test_the_documentation_has_the_tables_and_figures_of_the_results(monkeypatch, name):
    document = analysis.DOCUMENTS[name].document()
    monkeypatch.setattr(analysis.DOCUMENTS[name], "document", lambda: document)
    assert analysis.main([name, "--check"]) == 0
    _, figures = document
    committed = (analysis.ROOT / "docs/figures").glob(f"{name}*.png")
    assert figures.keys() == {path.stem for path in committed}


@pytest.mark.parametrize(
    ("column", "count", "ends"), [(0, 401, [0.0, 0.2, 0.6, 0.8]), (1, 201, [0.0, 0.2, 0.4])]
)
def test_a_cycle_is_drawn_in_its_units_above_the_phases_of_its_contact(cycle, column, count, ends):
    figure = limit_cycle.draw({"one": cycle, "two": cycle[:201]})
    *over_time, portrait = figure.axes[column::2]
    t = 0.002 * np.arange(count)
    theta, theta_dot, _, x_dot, force, torque = cycle[:count].T
    weight = 0.638 * 9.81
    series = np.degrees(theta), 100.0 * x_dot, force / weight, torque
    shades = [to_hex(shade) for _, shade in limit_cycle.PHASES.values()]
    for axes, values, level in zip(over_time, series, (0.0, 0.0, 1.0, 0.0), strict=True):
        assert_lines(axes, ([0.0, 1.0], [level, level], MUTED), (t, values, INK))
        spans = [(span.get_x(), span.get_x() + span.get_width()) for span in axes.patches]
        np.testing.assert_allclose(spans, list(pairwise(ends)), atol=1e-12)
        colours = [to_hex(span.get_facecolor()) for span in axes.patches]
        assert colours == shades[: len(spans)]
        assert axes.get_xlim() == (0.0, t[-1])
    assert over_time[0].get_title() == ("one", "two")[column]
    assert over_time[-1].get_xlabel() == "time (s)"
    assert_lines(portrait, (np.degrees(theta), theta_dot, BLUE))
    assert portrait.get_xlabel() == "θ (deg)"


def test_a_stale_table_is_found(tmp_path, capsys):
    assert analysis.main(["curves", "--check", "--output", str(tmp_path)]) == 1
    message = r"curves_tables\.md is not up to date: run `python -m"
    assert re.search(message, capsys.readouterr().out)


def test_the_output_must_be_a_folder(refused):
    refused(analysis.main, ["curves", "--output", __file__])


# Speeds that rise from run to run and with the steps.
STEPS = np.arange(1.0, 9.0) * 1e5
RUNS = {seed: (STEPS, 10.0 + seed - 1e6 / STEPS) for seed in range(3)}
FIRST = estimate(np.array([[0.0], [1.0], [2.0]]))
LAST = estimate(np.array([[8.75], [9.75], [10.75]]))


def test_the_curves_of_a_row_are_those_of_its_runs():
    figure = curves.draw_learning({"three": RUNS})
    (axes,) = figure.axes
    assert axes.get_title() == "three"
    assert axes.get_xlim()[0] == axes.get_ylim()[0] == 0.0
    assert figure.get_supylabel().endswith("(cm/s)")
    seeds = [(steps / 1e6, speeds) for steps, speeds in RUNS.values()]
    # The middle one is the mean.
    assert_lines(axes, *((*each, MUTED) for each in seeds), (*seeds[1], BLUE))
    x, y = axes.collections[0].get_paths()[0].vertices.T
    assert y.min() == pytest.approx(FIRST.low)
    assert y[x == 0.8].max() == pytest.approx(LAST.high)


def test_a_run_with_a_single_evaluation_is_a_point():
    figure = curves.draw_learning({"three": RUNS, "one": {0: (STEPS[:1], STEPS[:1])}})
    curve, point = (axes.lines[0] for axes in figure.axes[:2])
    assert (curve.get_linestyle(), curve.get_marker()) == ("-", "None")
    assert (point.get_linestyle(), point.get_marker()) == ("None", ".")


def test_places_without_a_row_are_empty():
    figure = curves.draw_learning(dict.fromkeys("abcdefg", RUNS))
    _, _, _, above, _, _, _, empty = figure.axes
    assert not empty.get_visible()
    assert above.xaxis.get_tick_params()["labelbottom"]


def test_curves_of_another_metric_are_logarithmic():
    figure = curves.draw_learning({"goal": RUNS}, "time to the goal (s)")
    (axes,) = figure.axes
    assert axes.get_yscale() == "log"
    assert axes.yaxis.get_major_formatter()(20.0) == "20"
    ticks = axes.yaxis.get_major_locator().tick_values(1.0, 9.0)
    assert [tick for tick in ticks if 1.0 <= tick < 10.0] == pytest.approx([1.0, 2.0, 3.0, 5.0])
    assert figure.get_supylabel() == "time to the goal (s)"


def test_the_table_of_a_row_is_the_end_of_its_runs():
    text = curves.table({"none": {}, "three": RUNS})
    head, _, row = table(text)
    assert head[2:] == ["steps", "mean speed (cm/s) at the end", "steps to 90 % of that"]
    speed = f"9.75 [{LAST.low:.2f},\N{NO-BREAK SPACE}{LAST.high:.2f}]"
    # 11 - 10 / n reaches 90 % of 9.75 at n = 5.
    assert row == ["three", "3", "800,000", speed, "500,000"]
    assert text.endswith("\n\nWithout committed evaluations: none.")
    assert "Without" not in curves.table({"three": RUNS})


@dataclass
class FakeRow:
    """A row whose runs have the same speeds; at rest there is no cost."""

    name: str
    trained: bool
    speed: float
    runs: int = 5

    def score(self, set_name, metric):
        episodes = 1.0 + 0.2 * np.linspace(-1.0, 1.0, 101) ** 3
        speeds = self.speed * episodes * np.ones((self.runs, 1))
        if metric == curves.SPEED.name:
            return speeds
        return np.where(speeds > 0.0, 2.0, np.inf)


TRAINED = [FakeRow(f"direct-{n}", True, 15.0 - 0.01 * n) for n in range(6)]
LAW = FakeRow("law", False, 3.0)


def test_rows_are_ordered_by_their_mean_speed(monkeypatch):
    rows = [FakeRow("slow", True, 5.0, runs=10), FakeRow("fast", True, 6.0)]
    monkeypatch.setattr(curves, "load_rows", lambda folder, names: rows)
    tables, _ = curves.document()
    assert tables["learning"].endswith("evaluations: fast, slow.")


@pytest.fixture(scope="module")
def transport():
    return curves.draw_transport([LAW, *TRAINED, FakeRow("rest", False, 0.0)])


def test_policies_are_named_at_their_cost_and_speed_without_overlap(transport):
    (axes,) = transport.axes
    lines = [line for line in axes.lines if line.get_marker() in "os" and len(line.get_xydata())]
    marks = [line.get_xydata()[0] for line in lines]
    expected = [(2.0, row.speed) for row in (LAW, *TRAINED)]
    np.testing.assert_allclose(marks, expected, rtol=1e-12)
    assert [line.get_marker() for line in lines] == ["s", *["o"] * 6]
    # The highest is named first.
    assert texts(axes.texts) == [row.name for row in (*TRAINED, LAW)]
    assert [text.get_color() for text in axes.texts] == [*[BLUE] * 6, INK]
    # A line leads from each name to its mark.
    np.testing.assert_allclose([text.xy for text in axes.texts], [*marks[1:], marks[0]])
    assert all(text.arrow_patch for text in axes.texts)
    heights = [text.xyann[1] for text in axes.texts]
    np.testing.assert_allclose(heights, np.arange(13, 0, -2) / 14)


def test_axes_and_kinds_of_policies_are_named(transport):
    (axes,) = transport.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("cost of transport", "mean speed (cm/s)")
    assert "without a cost: rest." in " ".join(transport.get_supxlabel().split())
    (legend,) = transport.legends
    kinds = [label.partition(",")[0] for label in texts(legend.texts)]
    assert kinds == ["dynamic programming", "trained", "scripted"]
    assert [handle.get_color() for handle in legend.legend_handles] == [GREEN, BLUE, INK]


def test_intervals_are_those_of_trained_policies(transport):
    front, _, across, along, *others = transport.axes[0].lines
    assert sum(line.get_marker() == "None" for line in others) == 2 * len(TRAINED[1:])
    speed = estimate(TRAINED[0].score("nominal", curves.SPEED.name))
    np.testing.assert_allclose(front.get_xydata(), list(optimal_front()))
    # That of a cost without spread is a point.
    np.testing.assert_allclose(across.get_xydata(), [[2.0, speed.value]] * 2)
    np.testing.assert_allclose(along.get_xydata(), [[2.0, speed.low], [2.0, speed.high]])


def test_tables_and_figures_are_written_and_up_to_date(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "new"
    made = SimpleNamespace(document=lambda: ({"speeds": "|a|"}, {"one": lambda: new_figure(1.0)}))
    monkeypatch.setattr(analysis, "DOCUMENTS", {"curves": made})
    assert analysis.main(["--output", str(folder)]) == 0
    assert capsys.readouterr().out == "Written: curves\n"
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*.*")}
    assert found == {"curves_tables.md", "figures/one.png", "figures/one.svg"}
    page = (folder / "curves_tables.md").read_text(encoding="utf-8")
    assert "[start:speeds] -->\n|a|\n" in page
    assert analysis.main(["--check", "--output", str(folder)]) == 0
    made.document = lambda: ({"speeds": "|b|"}, {})
    assert analysis.main(["--check", "--output", str(folder)]) == 1
    assert analysis.main(["--output", str(folder)]) == 0
    assert analysis.main(["--check", "--output", str(folder)]) == 0
