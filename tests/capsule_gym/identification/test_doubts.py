"""Warnings name what a log contradicts: ranges, and sensors that are later than others."""

import re
import warnings

import numpy as np
import pytest

from capsule_gym import Randomization, identify
from capsule_gym.identification.doubts import drawn_beyond
from tests.capsule_gym.identification.rig import CONSTANTS, EXACT, MOTOR, WHITE, make_log
from tests.capsule_gym.identification.test_shooting import make_small_problem

READINGS = ("theta", "theta_dot", "x_dot")


@pytest.fixture(scope="module")
def short_log():
    return make_log(WHITE, 8.0)


def messages_of(log, **arguments):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fit = identify(log, **arguments)
    return fit, [str(warning.message) for warning in caught]


def later(log, names, rows):
    """A log in which the readings of some sensors are those of earlier rows."""
    changed = {name: column[20:-20] for name, column in log.items()}
    count = len(log["t"])
    for name in names:
        changed[name] = log[name][20 - rows : count - 20 - rows]
    return changed


@pytest.mark.parametrize(("names", "rows"), [(["x_dot"], 3), (["theta", "theta_dot"], 2)])
def test_sensors_that_are_later_are_named(short_log, names, rows):
    _, messages = messages_of(later(short_log, names, rows))
    pattern = r"column '(\w+)' is about (\d+) ms later .*: give ranges={'\1_latency': \("
    late = [re.search(pattern, text) for text in messages]
    found = {match[1]: int(match[2]) for match in late if match}
    assert set(found) == set(names)
    for milliseconds in found.values():
        assert milliseconds == pytest.approx(10 * rows, rel=0.5)


def test_the_latency_of_a_late_sensor_is_estimated(short_log):
    log = later(short_log, ["x_dot"], 3)
    fit, messages = messages_of(log, ranges={"x_dot_latency": (0.0, 0.06)})
    assert not any("later" in text for text in messages)
    low, high = fit.intervals(0.999)["x_dot_latency"]
    assert low < 0.03 < high
    assert high - low < 0.02


def test_a_log_shifted_by_a_row_has_another_latency(short_log):
    fit, _ = messages_of(later(short_log, READINGS, 1))
    low, high = fit.intervals(0.999)["latency"]
    assert low < MOTOR["latency"] + 0.01 < high
    _, messages = messages_of(later(short_log, READINGS, -2))
    assert any(re.search(r"draws .*latency.* shifted by a row", text) for text in messages)


def test_all_quantities_outside_of_their_ranges_are_named():
    log = make_log(EXACT, 4.0)
    prior = Randomization(M=(0.3, 0.5), mu=(0.1, 0.2))
    known = {**CONSTANTS, "lag": MOTOR["lag"]}
    del known["M"], known["mu"]
    ranges = {"latency": (0.0, 0.004)}
    _, messages = messages_of(log, known=known, prior=prior, ranges=ranges)
    (text,) = [text for text in messages if "lies at the end of its range" in text]
    assert text.startswith("M, mu, latency lies")
    assert "ranges={'M': (low, high)}" in text
    wider = {"M": (0.3, 0.8), "mu": (0.01, 0.2), "latency": (0.0, 0.02)}
    fit, messages = messages_of(log, known=known, prior=prior, ranges=wider)
    assert not messages
    assert fit.estimates["M"] == pytest.approx(CONSTANTS["M"], abs=1e-4)
    assert fit.estimates["latency"] == pytest.approx(MOTOR["latency"], abs=1e-6)


def test_ends_without_a_pull_are_not_named(short_log):
    """The ends of ranges are the truth itself."""
    known = {**CONSTANTS, "lag": MOTOR["lag"]}
    del known["M"]
    _, messages = messages_of(short_log, known=known, ranges={"M": (0.6, 0.9)})
    assert not messages


@pytest.mark.parametrize(("end", "outwards"), [(0.0, 1.0), (1.0, -1.0)])
@pytest.mark.parametrize(("reduction", "beyond"), [(8.5, []), (9.5, [0])])
def test_an_end_is_drawn_beyond_where_the_sum_of_squares_falls_by_nine(
    end, outwards, reduction, beyond
):
    problem = make_small_problem()
    jacobian = np.random.default_rng(0).normal(size=(7, 5))
    # The residual that no other unknown can reduce.
    others, _ = np.linalg.qr(jacobian[:, 1:])
    own = jacobian[:, 0] - others @ (others.T @ jacobian[:, 0])
    r = outwards * np.sqrt(reduction) * own / np.linalg.norm(own)
    problem.residuals = lambda unknowns: (r, jacobian)
    assert drawn_beyond(problem, np.array([end, 0.5, 0.5, 3.0, -1.0])) == beyond
