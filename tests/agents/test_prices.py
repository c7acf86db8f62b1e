"""One policy at many prices of energy."""

import json
import math

import pytest

from agents import prices
from baselines.dynamic_programming.archive import optimal_front
from baselines.gaits.archive import pareto_front


@pytest.fixture
def short_set(tmp_path):
    content = {"name": "short", "plants": [{"M": 0.5, "mu": 0.01, "seed": seed, "changes": []} for seed in range(2)]}
    path = tmp_path / "short.json"
    path.write_text(json.dumps(content))
    return str(path)


def test_dear_energy_makes_it_slower_and_cheaper(short_set):
    free, dear = prices.measure("pareto/seed-0", short_set, (0.2, 12.0))
    assert free.speed.value > 2.0 * dear.speed.value > 0.0
    assert free.cost.value > 2.0 * dear.cost.value > 0.0
    assert (free.failures, free.episodes) == (0, 2)


def test_the_front_of_the_gaits_is_met_at_its_gaits_and_ends_there():
    gait = pareto_front()[3]
    assert prices.cost_of_gaits(gait.mean_speed) == gait.cost_of_transport
    assert math.isnan(prices.cost_of_gaits(100.0))


def test_no_gait_is_cheaper_than_the_optimum_at_its_speed():
    optima = optimal_front()
    for gait in pareto_front():
        cheapest = min((cost for cost, speed in optima if speed >= gait.mean_speed), default=math.inf)
        assert cheapest < gait.cost_of_transport or cheapest == math.inf


@pytest.mark.parametrize(("name", "message"), [("direct-ppo", "not observe the energy"), ("adaptive", "trained one")])
def test_a_policy_that_is_told_no_weight_is_refused(name, message, short_set):
    with pytest.raises(ValueError, match=message):
        prices.measure(name, short_set, (1.0,))


def test_the_command_writes_table_and_figure(tmp_path, short_set, monkeypatch, capsys):
    monkeypatch.setattr(prices, "WEIGHTS", (0.5, 5.0))
    monkeypatch.setattr(prices.measure, "__defaults__", ((0.5, 5.0),))
    table, figure = tmp_path / "table.md", tmp_path / "figure"
    arguments = ["pareto/seed-1", "--set", short_set, "--markdown", str(table), "--figure", str(figure)]
    assert prices.main(arguments) == 0
    assert table.read_text().count("\n|") == 4
    assert figure.with_suffix(".png").stat().st_size > 10_000
    assert "energy weight" in capsys.readouterr().out
