"""Rates, their tables, files and error messages of the benchmarks. These tests measure no time."""

from __future__ import annotations

import importlib
import statistics

import numpy as np
import pytest

from benchmarks import accuracy, measurement, mujoco, regression, throughput
from benchmarks.regression import Guard
from benchmarks.throughput import Contender
from capsule_gym.parameters import Capsule

COMMANDS = ("accuracy", "mujoco", "regression", "throughput", "web")
ABSENT = "a_package_that_nobody_has"


@pytest.mark.parametrize(
    ("command", "words", "message"),
    [
        *((name, ["--markdown", "{folder}"], "--markdown") for name in COMMANDS),
        ("throughput", ["--turns", "0"], "--turns must be above 0"),
    ],
)
def test_bad_arguments_are_refused_before_the_measurement(command, words, message, tmp_path, capsys) -> None:
    with pytest.raises(SystemExit) as stop:
        importlib.import_module(f"benchmarks.{command}").main([word.format(folder=tmp_path) for word in words])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err


def test_contenders_take_turns_and_are_closed() -> None:
    log: list[str] = []

    def contender(name: str) -> Contender:
        def step(count: int) -> None:
            log.append(name)
            np.zeros(1000 * count).sum()

        return Contender(name, lambda: (step, lambda: log.append(f"{name} closed")), environments=3)

    rates = throughput.measure([contender("a"), contender("b")], 3)
    assert log[-8:] == ["a", "b"] * 3 + ["b closed", "a closed"]
    assert {name: len(turns) for name, turns in rates.items()} == {"a, 3 environments": 3, "b, 3 environments": 3}
    assert measurement.spread([5.0, 1.0, 3.0, 2.0, 4.0]) == pytest.approx(2.0 / 3.0)


def test_every_ratio_refers_to_a_measured_contender() -> None:
    everything = [*throughput.ours(), *throughput.peers()]
    names = [one.name for one in everything]
    assert len(set(names)) == len(names)
    assert {one.peer for one in everything if one.peer} <= set(names)


def test_throughput_writes_its_table(tmp_path, monkeypatch, capsys) -> None:
    def contender(label, peer=None, **kwargs):
        return Contender(label, list, peer=peer, **kwargs)

    batch = contender(throughput.DIRECT, "slow", environments=1024, substeps=10)
    listed = [batch, contender("slow"), contender("lonely", "gone"), contender("gone", package=ABSENT)]
    rates = {batch.name: [2700.0, 3000.0, 3300.0], "slow": [1500.0], "lonely": [10.0]}
    monkeypatch.setattr(throughput, "ours", lambda: [*listed, contender("wide", threads=1000)])
    monkeypatch.setattr(throughput, "peers", list)
    monkeypatch.setattr(throughput, "measure", lambda *_: rates)
    page = tmp_path / "page.md"
    assert throughput.main(["--markdown", str(page)]) == 0
    lines = page.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("<!-- Written by python -m benchmarks.throughput")
    header, _, fast, slow, lonely = (
        [cell.strip() for cell in line.split("|")] for line in lines if line.count("|") > 5
    )
    cells = dict(zip(header, fast, strict=True))
    assert (cells["ratio"], cells["to"], cells["env-steps/s"], cells["IQR"]) == ("2", "slow", "3,000", "10%")
    assert slow[header.index("ratio")] == lonely[header.index("ratio")] == ""
    # The output names everything that cannot be measured, with the reason.
    assert f"gone is left out: {ABSENT}" in capsys.readouterr().out and "wide, 1000 threads is left out" in lines[-1]


def test_a_ratio_below_its_floor_is_measured_again_and_fails(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(regression, "TURNS", 3)
    rates = iter([1.0, 100.0, 2.0, 5.0, 5.0, 5.0])
    assert Guard("disturbed", 1.0, lambda: next(rates), lambda: 4.0).measure() == statistics.median([5 / 4] * 3)
    good, bad = Guard("good", 1.0, lambda: 4.0, lambda: 1.0), Guard("bad", 5.0, lambda: 4.0, lambda: 1.0)
    for found, status in (([good], 0), ([good, bad], 1)):
        monkeypatch.setattr(regression, "guards", lambda found=found: found)
        assert regression.main(["--markdown", str(tmp_path / "ratios.md")]) == status
    assert "below its floor" in (tmp_path / "ratios.md").read_text(encoding="utf-8")


# --- MuJoCo ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("friction", [None, *mujoco.ALL_FRICTIONS], ids=lambda found: found and found.name)
def test_mujoco_has_the_same_plant_and_about_the_same_friction(friction: mujoco.FrictionModel | None) -> None:
    pytest.importorskip("mujoco")
    torques = np.random.default_rng(0).uniform(-0.5, 0.5, 100)

    def end(mu: float) -> np.ndarray:
        return accuracy.run(torques[:, None], Capsule(mu=mu).plant(), 1e-3)[1:, :, 0]

    mu = 0.1 if friction else 0.0
    model = mujoco.build_model(friction or mujoco.FRICTIONS[0], "RK4", 1e-3, Capsule(mu=mu))
    states = mujoco.simulate(model, torques[None])[0]
    difference = np.abs(states - end(mu)).max()
    assert difference < (0.03 if friction else 1e-8)
    assert not friction or np.abs(states - end(0.0)).max() > 5.0 * difference
