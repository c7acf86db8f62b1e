"""Sensors that repeat readings are found, and those that only have a resolution are not."""

import numpy as np
import pytest

from capsule_gym import identify
from capsule_gym.identification.sampling import drop_repeats
from tests.capsule_gym.identification.rig import EXACT, make_log

EVERY_THIRD = np.arange(2000) % 3 == 0


def hold(readings, fresh):
    """Readings of which only the fresh ones are new."""
    return readings[fresh][np.cumsum(fresh) - 1]


def rounded(step):
    return lambda readings: step * np.round(readings / step)


@pytest.mark.parametrize("name", ["theta", "theta_dot", "x_dot"])
@pytest.mark.parametrize(
    "fresh",
    [EVERY_THIRD, np.random.default_rng(0).uniform(size=2000) > 0.05, np.arange(2000) < 1900],
    ids=["every third", "95 %", "until the sensor fails"],
)
def test_readings_of_a_sensor_that_repeats_are_lost(log, name, fresh):
    fresh[0] = True
    columns = {**log, name: hold(log[name], fresh)}
    assert drop_repeats(columns) == {name: np.sum(~fresh)}
    assert np.array_equal(columns[name], np.where(fresh, log[name], np.nan), equal_nan=True)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.6, 2.0, 5.0])
def test_a_resolution_repeats_readings(log, share):
    """Steps in units of the noise."""
    columns = {
        **log,
        "theta": rounded(0.01 * share)(log["theta"]),
        "theta_dot": rounded(0.1 * share)(log["theta_dot"]),
        "x_dot": rounded(0.01 * share)(log["x_dot"]),
    }
    assert not drop_repeats(columns)


def test_a_log_without_noise_repeats_nothing():
    log = make_log(EXACT, 5.0)
    log["x_dot"] = log["x_dot"] - 0.01
    log["torque"][:50] = 0.0
    log["theta"][:51] = 0.0
    assert np.sum(np.diff(log["x_dot"]) == 0.0) > 50
    assert not drop_repeats(log)


def test_a_sensor_that_repeats_is_named(log):
    short = {name: column[:300] for name, column in log.items()}
    short["x_dot"] = np.repeat(short["x_dot"][::2], 2)
    with pytest.warns(UserWarning) as caught:
        identify(short)
    messages = [str(warning.message) for warning in caught]
    assert "'x_dot' repeats 150 readings" in messages[0]
    assert "empty" in messages[0]
