"""Invalid logs raise errors that name the column."""

import math
from contextlib import nullcontext

import numpy as np
import pytest

from capsule_gym import identify
from capsule_gym.identification.log import check_size, check_stop, check_times, read_log


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "\nt, torque,theta\n0,0,0\n0,01,0,1,0,2\n",
            r"a row of log must be of one number for each of \['t', 'torque', 'theta'\], got",
        ),
        ("t,t\n0,0\n", "columns with different names, got"),
        ("\xb5", "CSV file in UTF-8"),
    ],
    ids=["commas", "names", "encoding"],
)
def test_an_invalid_file_raises_an_error(text, message, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ValueError, match=message):
        read_log(path)


def changed(**columns):
    return lambda log: {**log, **{name: change(log[name]) for name, change in columns.items()}}


def rows(column):
    return np.arange(len(column))


def every(change):
    """Changes all columns alike."""
    return lambda log: {name: change(column) for name, column in log.items()}


def ninth(readings, kept):
    """A ninth of readings, of which all but those kept are lost."""
    return np.where(kept, readings / 9.0, np.nan)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (changed(t=lambda t: t**1.1), "column 't' must be in equal steps"),
        (
            changed(t=lambda t: t + 6e-4 * (rows(t) > 699)),
            r"'t' must be in equal steps .* row 699 is \[0\.0106\d*\]",
        ),
        (changed(torque=np.zeros_like), "'torque' must be varied"),
        (changed(torque=lambda u: 5.0 + 1e-6 * u), r"'torque' must be varied \(N m\), got .*5"),
        (
            changed(torque=lambda u: np.where(u > 0.5, np.nan, u)),
            "column 'torque' must be finite numbers",
        ),
        (changed(theta=np.degrees), "column 'theta' must be in rad"),
        (
            changed(theta=lambda a: np.where(rows(a) == 500, -math.pi / 2.0, a)),
            "stop at 90 deg.* row 500",
        ),
        (changed(theta=lambda a: np.where(rows(a) > 699, 1.55, a)), "stop at 90 deg.* row 700"),
        (changed(theta=lambda a: np.where(rows(a) < 300, -1.52, a)), "stop at 90 deg.* row 0"),
        (changed(torque=lambda u: np.ma.masked_greater(u, 0.5)), "'torque' must be finite numbers"),
        (changed(x_dot=np.zeros_like), "column 'x_dot' must be of a sensor that works"),
        (changed(theta=lambda a: 0.0 * a + 0.3), "'theta' must be of .*: leave the cells empty"),
        (
            changed(theta_dot=lambda w: 0.4 * w),
            "column 'theta_dot' must be the derivative of column 'theta'.* 2.[45]",
        ),
        (
            changed(
                theta=lambda a: np.where(rows(a) % 7 == 0, np.nan, a),
                theta_dot=lambda w: 0.4 * w,
            ),
            "column 'theta_dot' must be the derivative",
        ),
        (
            changed(theta_dot=lambda w: ninth(w, np.arange(len(w)) % 50 > 0)),
            "column 'theta_dot' must be",
        ),
        (
            changed(theta_dot=lambda w: ninth(w, np.arange(len(w)) % 5 == 0)),
            "column 'theta_dot' must be",
        ),
        (changed(x_dot=lambda v: v[:-1]), "column 'x_dot' must be one number for each row"),
        (every(lambda column: np.resize(column, 100_001)), "'t' must be .* at most 100 s"),
        (every(lambda column: column[::10]), "column 't' must be in equal steps"),
        (every(lambda column: column[:0]), "column 't' must be in equal steps"),
        (every(lambda column: column[150:200]), "column 't' must be .*, over at least 2 s"),
        (lambda log: {**log, "speed": log["x_dot"]}, "log must have columns out of"),
        (
            lambda log: {name: log[name] for name in ("t", "theta")},
            "log must be of the columns 't', 'torque'",
        ),
    ],
)
def test_invalid_logs_name_the_column(log, change, text):
    with pytest.raises(ValueError, match=text):
        identify(change(log))


@pytest.mark.parametrize(
    ("name", "largest"),
    [
        ("torque", 20.0),
        ("theta", 1.2 * math.pi / 2.0),
        ("theta_dot", 30.0),
        ("x", 1000.0),
        ("x_dot", 4.0),
    ],
)
def test_numbers_are_plausible_up_to_a_largest_size(name, largest):
    check_size(name, np.array([0.0, -largest]))
    with pytest.raises(ValueError, match=f"column '{name}' must be in .*, within"):
        check_size(name, np.array([0.0, -1.01 * largest]))


@pytest.mark.parametrize(("rate", "count"), [(64, 64 * 2 + 1), (64, 64 * 100 + 1), (1024, 100_000)])
def test_the_shortest_and_the_longest_logs_are_accepted(rate, count):
    # The times are exact in binary.
    assert check_times(np.arange(count) / rate) == 1.0 / rate


@pytest.mark.parametrize(
    ("theta", "theta_dot"),
    [
        (lambda a: 0.0 * a, lambda w: w),
        (lambda a: a, lambda w: 0.0 * w),
        # No two readings are 0.1 s apart.
        (lambda a: np.where(rows(a) % 7 == 0, a, np.nan), lambda w: w / 9.0),
        (lambda a: a, lambda w: np.random.default_rng(0).uniform(-25.0, 25.0, len(w))),
    ],
    ids=["no motion", "no rate", "few positions", "noise"],
)
def test_a_rate_that_cannot_be_compared_with_its_position_is_accepted(log, theta, theta_dot):
    read_log({**log, "theta": theta(log["theta"]), "theta_dot": theta_dot(log["theta_dot"])})


def test_masked_readings_are_lost(log):
    lost = rows(log["theta"]) % 7 == 0
    found = read_log({**log, "theta": np.ma.array(log["theta"], mask=lost)})["theta"]
    assert np.array_equal(found, np.where(lost, np.nan, log["theta"]), equal_nan=True)


class Frame:
    """A DataFrame, of which pandas and polars both have this interface."""

    def __init__(self, columns):
        self.columns = list(columns)
        self.column = columns.get

    def __getitem__(self, name):
        return self.column(name)


def test_a_dataframe_is_a_log(log):
    lost = np.where(rows(log["t"]) == 3, None, log["x_dot"])
    found = read_log(Frame({**log, "x_dot": lost}))
    assert list(found) == list(log)
    assert np.array_equal(found["theta"], log["theta"])
    assert np.isnan(found["x_dot"]).nonzero()[0].tolist() == [3]


@pytest.mark.parametrize("period", [0.005, 0.02])
@pytest.mark.parametrize(("seconds", "lies"), [(0.2, False), (0.4, True)])
def test_a_pendulum_that_stays_near_its_stop_lies_on_it(period, seconds, lies):
    t = np.arange(0.0, 2.0, period)
    near = (t > 1.0) & (t <= 1.0 + seconds)
    with pytest.raises(ValueError, match="'theta' must be") if lies else nullcontext():
        check_stop(np.where(near, 1.45, 0.5), period)
