import re

import gymnasium as gym
import numpy as np
import pytest

from baselines.drawing import BLUE, MUTED
from benchmarks import measurement, throughput
from capsule_gym.core.layout import Row
from tests.figures import assert_bars, texts
from tests.project.test_pages import ROOT


def test_rates_are_bars_of_their_colours(tmp_path, saved_figures):
    measured = {
        "capsule": 2e5,
        "CartPole-v1": 1e5,
        "capsule, plain C, 1024": 9e6,
        "capsule, 1024": 8e6,
    }
    throughput.draw(measured, tmp_path / "speed")
    (axes,) = saved_figures[0].axes
    # From top to bottom.
    assert texts(axes.get_yticklabels()) == [*measured][::-1]
    bars = (0, 8e6, BLUE), (1, 9e6, MUTED), (2, 1e5, MUTED), (3, 2e5, BLUE)
    assert_bars(axes, *bars)
    assert texts(axes.texts) == ["8,000,000", "9,000,000", "100,000", "200,000"]
    assert axes.get_xscale() == "log"
    assert axes.get_xlim()[0] < 1e5 < 9e6 < axes.get_xlim()[1]
    assert {path.name for path in tmp_path.iterdir()} == {"speed.svg", "speed.png"}


def test_the_residual_of_a_law_is_limited_as_torques_are():
    # A fifth of 1.5 N m.
    assert throughput.LAW["residual_limit"] == pytest.approx(0.3)


def test_every_contender_steps_or_resets(monkeypatch):
    monkeypatch.setattr(throughput, "TURN_SECONDS", 1e-3)
    for make in throughput.contenders().values():
        assert throughput.seconds_per_step(make(), 1) > 0.0


@pytest.mark.parametrize("pair", throughput.FLOORS, ids=": ".join)
def test_the_documentation_compares_contenders(pair):
    page = (ROOT / "docs/speed_tables.md").read_text(encoding="utf-8")
    first, other = pair
    assert set(pair) <= {*throughput.contenders(), "capsule, plain C, 1024"}
    assert re.search(rf"\|{first}\|.*\|{other}\|{throughput.FLOORS[pair]:g}\|", page)


@pytest.mark.parametrize(("reset", "steps"), [(False, 50), (True, 0)])
def test_a_contender_begins_anew_after_an_episode(reset, steps, monkeypatch):
    env = gym.make("Pendulum-v1")
    monkeypatch.setattr(throughput.gym, "make", lambda _: env)
    step = throughput.environment("Pendulum-v1", reset=reset)
    # An episode has 200 steps.
    for _ in range(450):
        step()
    assert env.get_wrapper_attr("_elapsed_steps") == steps


def test_contenders_take_turns_and_the_tenth_percentile_counts():
    turns = []

    def contender(name):
        def turn():
            turns.append(name)
            return float(len(turns))

        return turn

    found = measurement.rates({"a": contender("a"), "b": contender("b")}, 11)
    assert found == pytest.approx({"a": 1.0 / 3.0, "b": 1.0 / 4.0})
    assert turns == ["a", "b"] * 11


@pytest.mark.parametrize(("floor", "status"), [(1.9, 0), (2.1, 1)])
def test_a_ratio_below_its_floor_fails(floor, status, tmp_path, monkeypatch):
    rates = {"fast": 2.0, "slow": 1.0, "other": 1.0}
    floors = {("fast", "slow"): floor, ("fast", "not installed"): 100.0}
    monkeypatch.setattr(throughput, "contenders", lambda: dict.fromkeys(rates, list))
    monkeypatch.setattr(throughput, "rates", lambda turns, _: {name: rates[name] for name in turns})
    monkeypatch.setattr(throughput, "FLOORS", floors)
    path = tmp_path / "page.md"
    assert throughput.main(["--markdown", str(path)]) == status
    page = path.read_text(encoding="utf-8")
    assert f"|fast|2|2.00|slow|{floor:g}|" in page
    assert "|other|1||||" in page


# Without the end of episodes, and with it.
@pytest.mark.parametrize("scale", [throughput.ACTION_SCALE, 1.0])
def test_plain_c_does_the_work_of_the_core(scale, monkeypatch):
    compiler = throughput.COMPILER or pytest.skip("no C compiler")
    monkeypatch.setattr(throughput, "ACTION_SCALE", scale)
    core, world = throughput.from_the_start()
    plain, found = throughput.from_the_start(compiler)
    # The options of plain C hold for it alone: the process keeps subnormal numbers.
    assert np.float64(5e-324) * 1.0 > 0.0
    for _ in range(throughput.EPISODE):
        core()
        plain()
        expected = world[:, : Row.clock]
        whole = np.isfinite(expected)
        assert np.abs(found[whole] - expected[whole]).max() < 1e-6
    assert (found[:, Row.stuck] > 0.0).any()
    assert (found[:, Row.backward] > 0.0).any()
    assert (found[:, Row.termination] != 0.0).any() == (scale == 1.0)
