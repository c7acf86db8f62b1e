"""Tables of benchmarks: orders and errors of the step, identified plants, and agents on hidden plants."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from benchmarks import accuracy, identification, rig, sensitivity
from capsule_gym import load_policy
from tests.agents.fakes import Sine


def test_derivatives_agree_with_differences():
    found, events = sensitivity.errors(3, seed=2)
    assert found.shape == (3, len(sensitivity.NAMES)) and found.max() < 1e-6 and events > 3.0


def test_errors_of_the_step_grow_with_it(monkeypatch, tmp_path):
    changes = {"FRICTION": (0.1,), "AMPLITUDES": (0.5,), "TRAJECTORIES": 2, "PLANTS": 1, "SECONDS": 1.0}
    for name, value in {**changes, "find_spec": lambda _: None}.items():
        monkeypatch.setattr(accuracy, name, value)
    assert accuracy.main(["--markdown", str(tmp_path / "page.md")]) == 0
    rows = [line.strip("|").split("|") for line in (tmp_path / "page.md").read_text().splitlines() if "±" in line]
    assert [row[:2] + row[-1:] for row in rows] == [["μ = 0.1", "±0.5", "1.0 s"], ["1 random", "±0.7", "1.0 s"]]
    for row in rows:
        errors = [float(cell.split()[0]) for cell in row[2:-1]]
        assert errors == sorted(errors) and errors[0] < 1e-8 < errors[-1]


def test_errors_and_coverage_of_identified_plants(monkeypatch, capsys):
    truth = {"M": 0.5, "mu": 0.1, "latency": 0.01, "lag": 0.0}
    # Estimates that are off by a tenth, of which the interval of M alone contains the truth.
    found = {name: 1.1 * value for name, value in truth.items()}
    intervals = {name: (0.0 if name == "M" else value, 9.0) for name, value in found.items()}
    fit = SimpleNamespace(estimates=found, intervals={0.95: intervals}.get, chi2=1.5)
    monkeypatch.setattr(identification, "make_logs", lambda count, *_: [(truth, truth)] * count)
    monkeypatch.setattr(identification, "identify", lambda _: fit)
    identification.main(["--plants", "3"])
    _, *words, last = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert words[:3] == [
        ["M", "0.05", "10.0%", "100.0%"],
        ["mu", "0.01", "10.0%", "0.0%"],
        ["latency", "0.001", "0.0%"],
    ]
    assert words[-1] == ["latency", "+", "lag", "0.001"] and last[:2] == ["chi2:", "1.50,"]


def test_logs_are_of_plants_that_the_prior_contains():
    (log, truth), (_, other) = identification.make_logs(2, 5, identification.SENSORS["white"], 0.4)
    low, high = identification.FREE["static_ratio"]
    assert low <= truth["static_ratio"] <= high and truth["static_ratio"] != other["static_ratio"]
    assert len(log["t"]) > 1990 and truth["x_dot_bias"] == 0.0
    assert abs(truth["latency"] / identification.PHYSICS_DT % 1.0 - 0.5) > 0.5 - 1e-9


def test_the_agent_of_the_identified_plant_is_compared_with_the_others(monkeypatch, capsys):
    trained = []

    def train(seed, total_steps, **env_kwargs):
        trained.append((seed, total_steps, env_kwargs))
        # The agents of the paper's and of wide ranges fail, and stand still.
        return load_policy("residual-real-wide") if "found" in env_kwargs else Sine(0.0 if env_kwargs else 1.5)

    monkeypatch.setattr(rig, "train", train)
    monkeypatch.setattr(rig, "identify", lambda log: SimpleNamespace(env_kwargs=lambda level: {"found": len(log["t"])}))
    rig.main(["--plants", "2", "--total-steps", "64"])
    assert [seed for seed, *_ in trained] == [0, 0, rig.SEED, rig.SEED + 1] and {n for _, n, _ in trained} == {64}
    assert trained[2][2] == {"found": 2000}
    lines = [line for line in capsys.readouterr().out.splitlines() if line[0] != "7"]
    found = {line.split()[0]: float(re.search(r"mean +(\S+)", line)[1]) for line in lines[::2]}
    assert found["identified"] > 5.0 and abs(found["real-wide"]) < 0.5 and "2 of 2 fail" in lines[2]
    assert [line.split()[-1] for line in lines[1::2]] == ["0", "2", "2"]


def test_an_agent_is_trained_on_the_plants_that_it_is_given(monkeypatch):
    monkeypatch.setattr(rig, "CONFIG", replace(rig.CONFIG, num_envs=8, n_steps=32, batch_size=64, n_epochs=1))
    agent = rig.train(0, 64, randomization="wide")
    assert agent.start([0])(np.zeros((1, 20), np.float32)).shape == (1, 1)
