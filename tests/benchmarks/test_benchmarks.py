"""The benchmarks of identification and of the leaderboard, at small sizes."""

import re
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import fresh_draws, identification, rig, sensitivity
from capsule_gym import load_policy
from tests.agents.fakes import Sine


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


@pytest.fixture
def rig_trainings(monkeypatch):
    """The arguments of the trainings of `rig`.

    The agent of the paper's ranges fails, and that of wide ranges stands still.
    """
    trainings = []

    def train(seed, total_steps, **env_kwargs):
        trainings.append((seed, total_steps, env_kwargs))
        if "found" in env_kwargs:
            return load_policy("residual-real")
        return Sine(0.0) if env_kwargs else Sine(1.5)

    def identify(log):
        return SimpleNamespace(env_kwargs=lambda level: {"found": len(log["t"])})

    monkeypatch.setattr(rig, "train", train)
    monkeypatch.setattr(rig, "identify", identify)
    return trainings


def test_the_agent_of_the_identified_plant_is_compared_with_the_others(rig_trainings, capsys):
    rig.main(["--plants", "2", "--total-steps", "64"])
    seeds, steps, env_kwargs = zip(*rig_trainings, strict=True)
    assert seeds == (0, 0, rig.SEED, rig.SEED + 1)
    assert set(steps) == {64}
    assert env_kwargs[2] == {"found": 2000}
    lines = [line for line in capsys.readouterr().out.splitlines() if line[0] != "7"]
    speeds = {}
    for line in lines[::2]:
        mean, lowest = re.findall(r"-?\d+\.\d+", line)
        speeds[line.split()[0]] = float(mean), float(lowest)
    mean, lowest = speeds["identified"]
    assert mean > 5.0
    assert mean >= lowest
    assert abs(speeds["real-wide"][0]) < 0.5
    assert "2 of 2 fail" in lines[2]
    assert [line.split()[-1] for line in lines[1::2]] == ["0", "2", "2"]


def test_an_agent_is_trained_on_the_plants_that_it_is_given(monkeypatch):
    small = replace(rig.CONFIG, num_envs=8, n_steps=32, batch_size=64, n_epochs=1)
    monkeypatch.setattr(rig, "CONFIG", small)
    act = rig.train(0, 64, randomization="wide").start([0])
    assert act(np.zeros((1, 20), np.float32)).shape == (1, 1)


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
