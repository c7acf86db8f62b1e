"""The benchmarks of identification and of the leaderboard, at small sizes."""

import math
import re
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import fresh_draws, identification, rig, sensitivity


def test_errors_and_coverage_of_identified_plants(monkeypatch, capsys):
    truth = {"M": 0.5, "mu": 0.1, "latency": 0.01, "lag": 0.005}
    # Estimates that are off by a tenth, of which the interval of M alone contains the truth.
    found = {name: 1.1 * value for name, value in truth.items()}
    intervals = {name: (value, 9.0) for name, value in found.items()}
    intervals["M"] = 0.0, 9.0
    chi2 = iter((1.0, 2.0, 3.0))

    def identify(_):
        chi2_of_log = next(chi2)
        if chi2_of_log > 2.0:
            warnings.warn("column 'x_dot' is late", UserWarning, stacklevel=2)
        return SimpleNamespace(estimates=found, intervals={0.95: intervals}.get, chi2=chi2_of_log)

    monkeypatch.setattr(identification, "make_logs", lambda count, *_: [(truth, truth)] * count)
    monkeypatch.setattr(identification, "identify", identify)
    identification.main(["--plants", "3"])
    _, M, mu, latency, _, both, pooled, warned, last = capsys.readouterr().out.splitlines()
    assert M.split() == ["M", "0.05", "10.0%", "100.0%"]
    assert mu.split() == ["mu", "0.01", "10.0%", "0.0%"]
    assert latency.split() == ["latency", "0.001", "0.0%"]
    assert both.split() == ["latency", "+", "lag", "0.0015"]
    assert pooled.split() == ["all", "25.0%"]
    assert warned == "a warning names a column in 1 of 3 logs"
    assert last == "chi2: 2.00, 90 % within 1.10 to 2.90; 0.0 s a fit"


def test_logs_are_of_plants_that_the_prior_contains():
    logs = identification.make_logs(2, 8, identification.SENSORS["white"], 0.55)
    (log, truth), (_, other) = logs
    low, high = identification.FREE["static_ratio"]
    assert low <= truth["static_ratio"] <= high
    assert truth["static_ratio"] != other["static_ratio"]
    # The first plant's log has 57 rows.
    assert len(log["t"]) > 1990
    assert truth["x_dot_bias"] == 0.0
    steps = truth["latency"] / identification.PHYSICS_DT
    assert abs(steps % 1.0 - 0.5) > 0.5 - 1e-9


class Swings:
    """Stands for a compiled program: a sine torque that swings across the upright."""

    def __init__(self, library):
        self.calls = 0

    def torque(self, reading, *, begins):
        self.calls = 0 if begins else self.calls + 1
        return 0.2 * math.sin(0.1 * self.calls)


def test_the_programs_of_hidden_plants_are_compared_with_other_policies(monkeypatch, capsys):
    logs = []
    monkeypatch.setattr(rig, "make_program", lambda folder, _: logs.append(folder / "log.csv"))
    monkeypatch.setattr(rig, "record_log", lambda seed, path: path.touch())
    monkeypatch.setattr(rig, "Program", Swings)
    monkeypatch.setattr(rig, "OTHERS", ("pd",))
    rig.main(["--plants", "2"])
    _, head, _, *plants, mean, failed = capsys.readouterr().out.splitlines()
    assert head.split() == ["plant", "identified,", "in", "C", "pd"]
    assert len(logs) == 2
    speeds = np.array([line.split() for line in plants], float)
    assert speeds[:, 0].tolist() == [rig.SEED, rig.SEED + 1]
    assert mean.split()[0] == "mean"
    found = np.array(mean.split()[1:], float)
    np.testing.assert_allclose(found, speeds[:, 1:].mean(axis=0), atol=0.006)
    assert (speeds[:, 2] != speeds[:, 1]).all()
    assert failed.split()[0] == "failed"


def test_the_derivatives_of_one_trajectory(capsys):
    sensitivity.main(["--trajectories", "1"])
    head, error, cost = capsys.readouterr().out.splitlines()
    assert head.startswith("1 trajectories with")
    assert float(error.split()[-1]) < 1e-6
    assert float(re.search(r"take (\S+) times", cost)[1]) > 1.0


@pytest.fixture
def one_small_set(monkeypatch):
    monkeypatch.setattr(fresh_draws, "PLANTS", 20)
    monkeypatch.setattr(fresh_draws, "MAIN_SETS", ("paper",))


@pytest.mark.usefixtures("one_small_set")
def test_means_on_new_plants_agree_with_the_table(capsys):
    assert fresh_draws.main(["open-loop"]) == 0
    assert "0 of 1 means differ" in capsys.readouterr().out


@pytest.mark.usefixtures("one_small_set")
def test_means_on_new_plants_differ_from_another_table(monkeypatch, capsys):
    load_row = fresh_draws.load_row

    def slower(path):
        row = load_row(path)
        return replace(row, scores={name: scores - 1.0 for name, scores in row.scores.items()})

    monkeypatch.setattr(fresh_draws, "load_row", slower)
    assert fresh_draws.main(["open-loop"]) == 1
    assert "0/20  differs" in capsys.readouterr().out
