"""Rates, ratios, tables, files and error messages of the benchmarks. These tests measure no time."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import accuracy, measurement, mujoco, throughput, training
from capsule_gym.layout import Row
from capsule_gym.parameters import Capsule


def test_contenders_take_turns_and_the_tenth_percentile_counts() -> None:
    log: list[str] = []
    contenders = {name: lambda name=name: log.append(name) or float(len(log)) for name in "ab"}
    assert measurement.rates(contenders, 11) == {"a": pytest.approx(1.0 / 3.0), "b": pytest.approx(1.0 / 4.0)}
    assert log == ["a", "b"] * 11


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


def test_evaluations_do_not_count_and_the_clock_stops_at_the_speed_or_the_time(monkeypatch):
    now, speeds = [0.0], iter((3.0, 15.0, 3.0))

    def evaluate(*_):
        now[0] += 50.0
        return [{"mean_speed": next(speeds)}]

    monkeypatch.setattr(training, "evaluate", evaluate)
    monkeypatch.setattr(training.time, "process_time", lambda: now[0])
    clock = training.Clock(None, _began=0.0)
    assert clock.check(training.EVERY - 1, list) and clock.seconds == 0.0
    for n, (seconds, going) in enumerate(((4.0, True), (10.0, False), (training.MOST_SECONDS, False)), start=1):
        now[0] += seconds - clock.seconds
        assert clock.check(n * training.EVERY, list) is going
        assert (clock.seconds, clock.steps) == (seconds, n * training.EVERY)


def test_an_agent_is_evaluated_while_it_learns():
    seen = []

    def check(steps, policy):
        seen.append((steps, policy().env_kwargs))
        return len(seen) < 3

    for library, num_envs in (("", training.CONFIG.num_envs), ("stable_baselines3", training.NUM_ENVS)):
        training.train_model(library, 0, SimpleNamespace(check=check))
        assert seen == [(n * num_envs, training.ENV_KWARGS) for n in (1, 2, 3)]
        seen.clear()
