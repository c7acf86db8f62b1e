"""Uneven times, lost rows, and sensors that repeat readings or only have a resolution."""

import numpy as np
import pytest

from capsule_gym import identify
from capsule_gym.identification.log import read_log
from capsule_gym.identification.sampling import drop_repeats, on_grid
from tests.capsule_gym.identification.rig import EXACT, make_log

EVERY_THIRD = np.arange(2000) % 3 == 0
T = 0.01 * np.arange(2000)


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
    log["torque"][:50] = 0.0
    log["theta"][:51] = 0.0
    assert np.sum(np.diff(log["x_dot"]) == 0.0) > 50
    assert not drop_repeats(log)


def test_a_platform_that_rests_only_at_first_repeats_nothing(log):
    noise = np.random.default_rng(0).normal(size=1900)
    x_dot = np.concatenate([np.zeros(100), noise])
    assert not drop_repeats({"t": log["t"], "torque": log["torque"], "x_dot": x_dot})


@pytest.mark.parametrize(("count", "found"), [(10, {}), (11, {"theta": 11})])
def test_ten_repeats_are_no_fault_of_a_sensor(log, count, found):
    fresh = np.arange(2000) % 150 != 1
    fresh[150 * count :] = True
    columns = {**log, "theta": hold(log["theta"], fresh)}
    assert drop_repeats(columns) == found


def test_a_sensor_that_repeats_is_named(log):
    short = {name: column[:300] for name, column in log.items()}
    short["x_dot"] = np.repeat(short["x_dot"][::2], 2)
    with pytest.warns(UserWarning) as caught:
        identify(short)
    messages = [str(warning.message) for warning in caught]
    assert "'x_dot' repeats 150 readings" in messages[0]
    assert "empty" in messages[0]


def test_rows_with_uneven_times_are_put_on_a_grid(log):
    rng = np.random.default_rng(3)
    kept = rng.uniform(size=2000) > 0.1
    kept[[0, -1]] = True
    # A clock that is 0.1 % fast.
    t = 5.0 + 1.001 * log["t"] + rng.uniform(-0.002, 0.002, 2000)
    uneven = {name: column[kept] for name, column in {**log, "t": t}.items()}
    with pytest.raises(ValueError, match=r"'t' must be in equal steps .*on_grid"):
        read_log(uneven)
    found = on_grid(uneven, 0.01)
    np.testing.assert_allclose(found["t"], 5.0 + 1.001 * log["t"], rtol=0.0, atol=3e-4)
    assert np.ptp(np.diff(found["t"])) < 1e-9
    assert np.array_equal(found["theta"], np.where(kept, log["theta"], np.nan), equal_nan=True)
    assert np.array_equal(found["torque"][kept], log["torque"][kept])
    assert np.abs(found["torque"] - log["torque"]).max() < 0.4
    read_log(found)


@pytest.mark.parametrize(
    ("change", "period", "message"),
    [
        ({}, 0.03, "'t' must be rising by about 0.03 s or more in each row"),
        ({"t": np.zeros(2000)}, 0.01, "'t' must be rising"),
        ({"t": T - 0.008 * (T == 7.0)}, 0.01, "'t' must be rising"),
        ({"t": 100.0 * np.arange(2000)}, 0.01, "'t' must be of at most 100000 periods"),
        ({}, 1.0, "period must be a number of s from 0.0001 to 0.05"),
    ],
)
def test_times_that_fit_no_grid_raise_an_error(log, change, period, message):
    with pytest.raises(ValueError, match=message):
        on_grid({**log, **change}, period)


def test_two_rows_make_a_grid():
    found = on_grid({"t": [1.0, 1.02], "torque": [0.1, 0.3], "theta": [0.0, 0.5]}, 0.01)
    assert found["torque"] == pytest.approx([0.1, 0.2, 0.3])
    assert np.array_equal(found["theta"], [0.0, np.nan, 0.5], equal_nan=True)


@pytest.mark.parametrize(
    ("log", "message"),
    [
        ({"t": [1.0], "torque": [0.1], "theta": [0.0]}, "column 't' must be rising"),
        ({"t": [1.0, 1.02], "theta": [0.0, 0.5]}, "log must be of 't', 'torque' and others"),
    ],
    ids=["a row", "no torque"],
)
def test_a_log_without_a_grid_raises_an_error(log, message):
    with pytest.raises(ValueError, match=message):
        on_grid(log, 0.01)
