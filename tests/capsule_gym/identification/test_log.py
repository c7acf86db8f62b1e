"""Invalid logs raise errors that name the column."""

from contextlib import nullcontext

import numpy as np
import pytest

from capsule_gym import identify
from capsule_gym.identification.log import check_stop, read_log


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
        (changed(torque=lambda u: 5.0 + 1e-6 * u), r"'torque' must be varied \(N m\), got .*5"),
        (
            changed(torque=lambda u: np.where(u > 0.5, np.nan, u)),
            "column 'torque' must be finite numbers",
        ),
        (changed(theta=np.degrees), "column 'theta' must be in rad"),
        (changed(theta=lambda a: np.where(rows(a) == 500, -1.6, a)), "stop at 90 deg.* row 500"),
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
