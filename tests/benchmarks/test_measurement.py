"""Rates, their tables, files and error messages of the benchmarks: nothing here measures a time."""

from __future__ import annotations

import importlib
import json
from functools import partial
from itertools import chain, repeat
from typing import Any

import numpy as np
import pytest

from benchmarks import accuracy, measurement, mujoco, regression, throughput
from benchmarks.measurement import Contender, Rate, Stepper
from benchmarks.regression import Guard, Turn, difference
from capsule_gym.parameters import Capsule

COMMANDS = ("accuracy", "mujoco", "regression", "throughput", "training", "web")
ABSENT = "a_package_that_nobody_has"


def make_stepper(log: list[str], name: str) -> Stepper:
    return Stepper(lambda count: log.append(f"{name} {count}"), lambda: log.append(f"{name} closed"))


def contender(label: str, peer: str | None = None, **kwargs: Any) -> Contender:
    return Contender(label, partial(make_stepper, [], label), peer=peer, **kwargs)


def turn(*seconds: float) -> Turn:
    """A turn of ten steps that takes these seconds one after the other, the last for ever."""
    times = chain(seconds, repeat(seconds[-1]))
    return lambda: (next(times), 10)


@pytest.mark.parametrize(
    ("command", "words", "message"),
    [
        *((name, ["--json", "{folder}/full.json"], "--json") for name in COMMANDS),
        *((name, ["--markdown", "{folder}/no/x.md"], "--markdown") for name in COMMANDS),
        *((name, ["--figure", "{folder}"], "--figure") for name in ("throughput", "training")),
        *((name, ["--turns", "0"], "--turns must be above 0") for name in ("throughput", "training", "web")),
        ("mujoco", ["--trajectories", "0"], "--trajectories"),
        ("training", ["--seconds", "0"], "--seconds"),
        ("training", ["--seeds", "1"], "--seeds must be at least 2"),
        ("training", ["--parts", "sideways"], "sideways"),
    ],
)
def test_bad_arguments_are_refused_before_the_measurement(command, words, message, tmp_path, capsys) -> None:
    full = tmp_path / "full.json"
    full.write_text("{}", encoding="utf-8")
    with pytest.raises(SystemExit) as stop:
        importlib.import_module(f"benchmarks.{command}").main([word.format(folder=tmp_path) for word in words])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
    assert full.read_text(encoding="utf-8") == "{}"


def test_contenders_take_turns_and_are_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measurement, "CALIBRATION_SECONDS", 0.0)
    log: list[str] = []
    rates = measurement.measure([Contender(name, partial(make_stepper, log, name)) for name in "ab"], 3, 0.0)
    assert [entry[0] for entry in log[-8:]] == ["a", "b"] * 4
    assert log[-2:] == ["a closed", "b closed"]
    assert set(rates) == {"a", "b"}
    found = Rate.of([5.0, 1.0, 3.0, 2.0, 4.0])
    assert (found.low, found.median, found.high, found.spread) == (2.0, 3.0, 4.0, pytest.approx(2.0 / 3.0))


def test_a_contender_that_cannot_be_measured_is_named_with_the_reason() -> None:
    everything = [contender("here"), contender("gone", packages=(ABSENT,)), contender("wide", threads=2)]
    found, lines = measurement.select_available(everything, cores=1)
    assert [one.label for one in found] == ["here"]
    assert "capsule-gym[bench]" in lines[0] and ABSENT in lines[0] and "gone" in lines[0]
    assert "2 threads" in lines[1] and "wide" in lines[1]


def test_every_ratio_refers_to_a_measured_contender() -> None:
    everything = [*throughput.ours(large=True), *throughput.peers()]
    names = [one.name for one in everything]
    assert len(set(names)) == len(names)
    assert {one.peer for one in everything if one.peer} <= set(names)


def test_throughput_writes_table_numbers_and_chart(tmp_path, monkeypatch, capsys) -> None:
    batch = contender(throughput.DIRECT, "slow", environments=1024, substeps=10)
    listed = [batch, contender("slow"), contender("lonely", "gone"), contender("gone", packages=(ABSENT,))]
    rates = {batch.name: Rate(3000.0, 2700.0, 3300.0, 0.1), "slow": Rate(1500.0, 1.0, 2.0), "lonely": Rate(10.0, 1, 2)}
    monkeypatch.setattr(throughput, "ours", lambda large: listed)
    monkeypatch.setattr(throughput, "peers", list)
    monkeypatch.setattr(throughput, "measure", lambda *_: rates)
    numbers, page, chart = (tmp_path / name for name in ("numbers.json", "page.md", "chart.png"))
    assert throughput.main(["--json", str(numbers), "--markdown", str(page), "--figure", str(chart)]) == 0
    lines = page.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("<!-- Written by python -m benchmarks.throughput")
    header, _, fast, slow, lonely = (
        [cell.strip() for cell in line.split("|")] for line in lines if line.count("|") > 5
    )
    cells = dict(zip(header, fast, strict=True))
    assert (cells["ratio"], cells["to"], cells["substeps/s"], cells["IQR"]) == ("2", "slow", "30,000", "20%")
    assert slow[header.index("ratio")] == lonely[header.index("ratio")] == ""
    assert ABSENT in capsys.readouterr().out and ABSENT in lines[-1]
    content = json.loads(numbers.read_text(encoding="utf-8"))
    assert content["rates"][0]["reset_seconds"] == 0.1 and content["machine"]["versions"]["numba"]
    assert chart.read_bytes().startswith(b"\x89PNG")


def test_a_ratio_is_the_median_over_turns_and_is_measured_again_below_its_floor(monkeypatch) -> None:
    monkeypatch.setattr(regression, "TURNS", 3)
    assert Guard("", 0.0, turn(1.0, 100.0, 2.0), turn(4.0)).measure() == 2.0
    monkeypatch.setattr(regression, "TURNS", 1)
    assert Guard("disturbed", 3.0, turn(2.0, 2.0, 1.0), turn(4.0)).best() == 4.0
    slow = Guard("slow", 3.0, turn(2.0), turn(4.0))
    assert slow.best() == 2.0 and slow.row(2.0) == ["slow", "2.00", "3", "below its floor"]
    physics = turn(3.0)
    assert Guard("", 1.0, difference(turn(5.0), physics), physics).measure() == 1.5
    # Noise may make the law seem to take no time at all, which is no reason to fail.
    assert Guard("", 1.0, difference(turn(3.0), physics), physics).measure() == np.inf


def test_regression_fails_where_a_ratio_is_below_its_floor(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(regression, "TURNS", 1)
    good, bad = Guard("good", 1.0, turn(1.0), turn(4.0)), Guard("bad", 5.0, turn(1.0), turn(4.0))
    for found, status in (([good], 0), ([good, bad], 1)):
        monkeypatch.setattr(regression, "guards", lambda found=found: found)
        assert regression.main(["--markdown", str(tmp_path / "ratios.md")]) == status
    assert "below its floor" in (tmp_path / "ratios.md").read_text(encoding="utf-8")


# --- MuJoCo ----------------------------------------------------------------------------------------------------------


def test_this_package_does_not_creep_below_the_limit_and_slips_beyond() -> None:
    assert [mujoco.largest_creep(load, 2e-3) for load in mujoco.LOADS] == [0.0] * len(mujoco.LOADS)
    assert mujoco.largest_creep(1.1, 2e-3) > 1e-3


@pytest.mark.parametrize("friction", [None, *mujoco.ALL_FRICTIONS], ids=lambda found: found and found.name)
def test_mujoco_has_the_same_plant_and_about_the_same_friction(friction: mujoco.FrictionModel | None) -> None:
    pytest.importorskip("mujoco")
    torques = np.random.default_rng(0).uniform(-0.5, 0.5, 100)

    def end(mu: float) -> np.ndarray:
        from benchmarks import driver

        return driver.run(torques, accuracy.START, Capsule(mu=mu).plant(), 0.02, 20).states[1:]

    mu = 0.1 if friction else 0.0
    model = mujoco.build_model(friction or mujoco.FRICTIONS[0], "RK4", 1e-3, Capsule(mu=mu))
    states = mujoco.simulate(model, torques[None])[0]
    difference = np.abs(states - end(mu)).max()
    assert difference < (0.03 if friction else 1e-8)
    assert not friction or np.abs(states - end(0.0)).max() > 5.0 * difference


def test_mujoco_steps_a_batch() -> None:
    pytest.importorskip("mujoco")
    stepper = throughput.step_mujoco(mujoco.FRICTIONS[1], 2e-3, 4, 2)
    stepper.step(3)
    stepper.close()
