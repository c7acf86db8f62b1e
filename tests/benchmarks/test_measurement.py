"""Rates, ratios, tables, files and error messages of the benchmarks. These tests measure no time."""

import importlib

import numpy as np
import pytest

from benchmarks import accuracy, measurement, mujoco, throughput, training
from capsule_gym.layout import Row
from capsule_gym.parameters import Capsule

COMMANDS = ("accuracy", "first_step", "throughput", "training", "web")


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


def test_contenders_take_turns_and_the_tenth_percentile_counts() -> None:
    log: list[str] = []
    contenders = {name: lambda name=name: log.append(name) or float(len(log)) for name in "ab"}
    assert measurement.rates(contenders, 11) == {"a": pytest.approx(1.0 / 3.0), "b": pytest.approx(1.0 / 4.0)}
    assert log == ["a", "b"] * 11


def test_a_training_ends_at_its_speed_and_evaluations_cost_nothing(monkeypatch) -> None:
    now, speeds = [0.0], iter([14.0, 15.0])
    monkeypatch.setattr("time.process_time", lambda: now[0])

    def evaluate(policy, plants):
        now[0] += 100.0
        return [{"mean_speed": next(speeds), "policy": policy}]

    monkeypatch.setattr(training, "evaluate", evaluate)
    clock = training.Clock(None, 50.0)
    for steps, over in ((training.EVERY, False), (training.EVERY + 1, False), (2 * training.EVERY, True)):
        now[0] += 1.0
        clock.check(steps, lambda: None)
        assert clock.over is over
    assert (clock.seconds, clock.steps, clock.speed) == (3.0, 2 * training.EVERY, 15.0)
    clock = training.Clock(None, 0.5)
    speeds = iter([1.0])
    now[0] += 1.0
    clock.check(training.EVERY, lambda: None)
    assert clock.over and clock.speed == 1.0


def test_every_ratio_is_measured() -> None:
    left_out = {f"capsule, plain C, {throughput.BATCH}"} if throughput.COMPILER is None else set()
    assert {name for pair in throughput.FLOORS for name in pair} - left_out <= set(throughput.contenders())


def test_a_ratio_below_its_floor_fails(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(throughput, "contenders", lambda: {"fast": list, "slow": list, "other": list})
    monkeypatch.setattr(throughput, "rates", lambda turns, _: {name: rates[name] for name in turns})
    rates = {"fast": 2.0, "slow": 1.0, "other": 1.0}
    for floor, status in ((1.9, 0), (2.1, 1)):
        monkeypatch.setattr(throughput, "FLOORS", {("fast", "slow"): floor, ("fast", "not installed"): 100.0})
        page = tmp_path / "page.md"
        assert throughput.main(["--markdown", str(page)]) == status
        assert f"|fast|2|2.00|slow|{floor:g}|" in page.read_text(encoding="utf-8")
        assert "|other|1||||" in page.read_text(encoding="utf-8")


# --- plain C ---------------------------------------------------------------------------------------------------------


# Without the end of episodes, and with it.
@pytest.mark.parametrize("scale", [throughput.ACTION_SCALE, 1.0])
def test_plain_c_does_the_work_of_the_core(scale, monkeypatch) -> None:
    compiler = throughput.COMPILER
    if compiler is None:
        pytest.skip("no C compiler")
    monkeypatch.setattr(throughput, "ACTION_SCALE", scale)
    (core, expected), (plain, world) = throughput.from_the_start(), throughput.from_the_start(compiler)
    # The options of plain C hold for it alone: the process keeps subnormal numbers.
    assert np.float64(5e-324) * 1.0 > 0.0
    for _ in range(throughput.EPISODE):
        core()
        plain()
        rows = expected[:, : Row.clock]
        whole = np.isfinite(rows)
        assert np.abs(world[whole] - rows[whole]).max() < 1e-6
    assert (world[:, Row.stuck] > 0.0).any() and (world[:, Row.backward] > 0.0).any()
    assert (world[:, Row.termination] != 0.0).any() == (scale == 1.0)


# --- MuJoCo ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("friction", [None, *mujoco.FRICTIONS])
def test_mujoco_has_the_same_plant_and_about_the_same_friction(friction: str | None) -> None:
    module = pytest.importorskip("mujoco")
    torques = np.random.default_rng(0).uniform(-0.5, 0.5, 100)

    capsule = Capsule(mu=0.1 if friction else 0.0)
    model, data = mujoco.build(friction or mujoco.FRICTIONS[0], 1e-3, capsule)
    model.opt.integrator = module.mjtIntegrator.mjINT_RK4
    state = [mujoco.hold(model, data, torque) for torque in torques][-1]
    difference = np.abs(state - accuracy.run(torques, capsule, 1e-3)).max()
    assert difference < (0.03 if friction else 1e-8)
    assert not friction or np.abs(state - accuracy.run(torques, Capsule(mu=0.0), 1e-3)).max() > 5.0 * difference
