"""The score of a policy."""

import pytest

from agents.criteria import CRITERIA

SMALL_IS_GOOD = ("failed", "goal_time", "unsettled", "velocity_error")


@pytest.mark.parametrize("task", CRITERIA)
def test_the_score_rises_with_what_is_good_and_falls_with_what_is_not(task):
    criteria = CRITERIA[task]
    for name in criteria.weights:
        means = dict.fromkeys(criteria.weights, 0.0)
        means[name] = 1.0
        assert (criteria.score(means) < 0.0) == (name in SMALL_IS_GOOD)


@pytest.mark.parametrize("task", CRITERIA)
def test_the_score_has_the_unit_of_the_metric(task):
    criteria = CRITERIA[task]
    assert abs(criteria.weights[criteria.metric.name]) == 1.0
