import math

import pytest

from agents.evaluation.tables import MEASURES, SHARE, Measure
from capsule_gym.task import METRICS

SPEED = Measure("speed", "speed (cm/s)", 2)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.234, "1.23"),
        (-1.235, "-1.24"),
        (-0.001, "0.00"),
        (0.0, "0.00"),
        (None, "-"),
        (math.inf, "-"),
        (math.nan, "-"),
    ],
)
def test_numbers(value, text):
    assert SPEED.format(value) == text


def test_signs():
    assert SPEED.format(1.234, sign=True) == "+1.23"
    assert SPEED.format(-0.001, sign=True) == "0.00"


def test_intervals():
    assert SPEED.with_interval({"iqm": 1.0, "low": 0.5, "high": 1.5}) == "1.00 [0.50, 1.50]"
    assert SPEED.with_interval({"iqm": 1.0, "low": -0.5, "high": None}, sign=True) == "+1.00 [-0.50, -]"
    assert SPEED.with_interval({"iqm": 1.0, "low": None, "high": None}) == "1.00"


def test_every_measure_is_a_metric_of_an_episode():
    assert set(MEASURES) <= set(METRICS)
    assert [name for name, measure in MEASURES.items() if measure.metric != name] == []
    assert SHARE.metric not in METRICS
