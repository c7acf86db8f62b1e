"""Disturbances and varied plants: the sensors err as documented, nothing else changes, and every contract holds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, Controller, Randomization
from capsule_gym.native import evaluate
from capsule_gym.parameters import NOMINAL, REAL, Disturbances

CLEAN = Disturbances(stick_threshold=0.0)
VARIED = Randomization(
    M=(0.45, 0.55),
    mu=(0.009, 0.3),
    log_mu=True,
    **{name: (0.9 * getattr(NOMINAL, name), 1.1 * getattr(NOMINAL, name)) for name in "mlkc"},
)


def swing(steps: int, count: int = 1, seed: int = 0) -> np.ndarray:
    """Torques that swing the pendulum, and throw it over in some environments."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-0.6, 0.6, (steps // 10 + 1, count, 1)), 10, axis=0)[:steps].astype(np.float32)


def run(env: CapsuleEnv, actions: np.ndarray, **reset: object) -> list[dict]:
    """The infos of an episode with these actions, including the observations."""
    observation, info = env.reset(**reset)
    infos = [{**info, "observation": observation}]
    for action in actions[:, 0]:
        observation, _, terminated, _, info = env.step(action)
        infos.append({**info, "observation": observation})
        if terminated:
            break
    return infos


@pytest.mark.parametrize("controller", [None, "baselines:gait"])
def test_disturbances_of_size_zero_change_no_bit(controller):
    plain, disturbed = CapsuleEnv(controller=controller), CapsuleEnv(controller=controller, disturbances=CLEAN)
    actions = swing(300)
    for one, other in zip(run(plain, actions, seed=3), run(disturbed, actions, seed=3), strict=True):
        np.testing.assert_array_equal(one["state"], other["state"])
        np.testing.assert_array_equal(one["observation"], other["observation"])
        assert one["torque"] == other["torque"] and one["law_torque"] == other["law_torque"]
        np.testing.assert_array_equal(other["reading"][[0, 1, 3]], other["state"][[0, 1, 3]])


def test_drawn_constants_make_the_plant_of_a_capsule_with_these():
    given = {"m": 0.15, "l": 0.28, "g": 9.7, "k": 0.3, "c": 0.1, "static_ratio": 1.4, "backward_ratio": 1.2}
    given |= {"viscous": 0.3, "stribeck_speed": 0.1, "slope": -0.02, "motor_friction": 0.03}
    capsule = Capsule(**given)
    ranges = Randomization(M=(0.4, 0.6), mu=(0.1, 0.3), **{name: (value, value) for name, value in given.items()})
    actions, own = swing(200), Randomization(M=ranges.M, mu=ranges.mu)
    drawn = run(CapsuleEnv(randomization=ranges), actions, seed=1)
    options = {"capsule": given, "M": drawn[0]["M"], "mu": drawn[0]["mu"]}
    set_ = run(CapsuleEnv(randomization=VARIED), actions, options=options)
    fixed = run(CapsuleEnv(randomization=own, capsule=capsule, physics_dt=0.002), actions, seed=1)
    assert drawn[0]["capsule"] == given
    for one, other, third in zip(drawn, fixed, set_, strict=True):
        np.testing.assert_allclose(one["state"], other["state"], rtol=0.0, atol=1e-11)
        np.testing.assert_array_equal(one["state"], third["state"])


def test_readings_are_late_by_the_latency():
    env = CapsuleEnv(disturbances=Disturbances(latency=(0.0, 0.06)))
    infos = run(env, swing(100), seed=0, options={"disturbances": {"latency": 0.04}})
    assert infos[0]["disturbances"]["latency"] == 0.04
    for now, past in zip(infos[2:], infos, strict=False):
        np.testing.assert_array_equal(now["reading"][[0, 1, 3]], past["state"][[0, 1, 3]])
        np.testing.assert_allclose(now["observation"][:3], past["state"][[0, 1, 3]], rtol=1e-6)
    # Until the first delayed state arrives, the sensors show the initial state.
    np.testing.assert_array_equal(infos[1]["reading"][[0, 1, 3]], infos[0]["state"][[0, 1, 3]])


def test_the_errors_of_readings_have_the_sizes_and_the_memory_that_are_asked_for():
    size = {"theta": 0.01, "theta_dot": 0.1, "x_dot": 0.02}
    count, steps = 400, 50

    def errors(kind: str, **given: object) -> np.ndarray:
        """The errors of the sensors relative to the size that is asked for, of readings by step and environment."""
        given |= {f"{name}_{kind}": (-value, value) if kind == "bias" else value for name, value in size.items()}
        batch = CapsuleVectorEnv(count, disturbances=Disturbances(**given), randomization="paper")
        _, info = batch.reset(seed=0)
        rows = []
        for _ in range(steps):
            rows.append((info["reading"] - info["state"])[:, [0, 1, 3]] / [*size.values()])
            _, _, _, _, info = batch.step(np.zeros((count, 1), np.float32))
        return np.array(rows)

    white, drift, bias = errors("noise"), errors("drift", drift_time=0.05), errors("bias")
    independent = 5.0 / math.sqrt(count * steps)
    for n in range(3):
        assert stats.kstest(white[:, :, n].ravel(), "norm").pvalue > 1e-3
        assert abs((white[1:, :, n] * white[:-1, :, n]).mean()) < independent
        assert abs((white[:, :, n] * white[:, :, n - 1]).mean()) < independent
        # The drift is stationary from the start; between readings 20 ms apart, its correlation is exp(-t / drift_time).
        assert stats.kstest(drift[0, :, n], "norm").pvalue > 1e-3
        assert stats.kstest(drift[-1, :, n], "norm").pvalue > 1e-3
        memory = (drift[1:, :, n] * drift[:-1, :, n]).mean() / (drift[:, :, n] ** 2).mean()
        assert memory == pytest.approx(math.exp(-0.02 / 0.05), abs=0.02)
        np.testing.assert_allclose(bias[:, :, n], np.broadcast_to(bias[0, :, n], (steps, count)), atol=1e-12)
        assert stats.kstest(bias[0, :, n], stats.uniform(-1.0, 2.0).cdf).pvalue > 1e-3


def test_normal_numbers_are_normal():
    # The bits of whole numbers, which the core mixes to random words.
    numbers = np.array(evaluate("normals", np.arange(20_000, dtype=np.uint64).view(np.float64)))
    assert stats.kstest(numbers.ravel(), "norm").pvalue > 1e-3
    assert abs((numbers[0] * numbers[1]).mean()) < 5.0 / math.sqrt(numbers.shape[1])


def proportional(theta, theta_dot, x, x_dot, memory, reference):
    """A torque that depends on every value that the law observes."""
    return 0.1 * theta + 0.01 * theta_dot + 0.1 * x + x_dot, memory


def shown(reading: np.ndarray) -> float:
    return float(np.clip(reading @ [0.1, 0.01, 0.1, 1.0], -1.5, 1.5))


@pytest.mark.parametrize(("controls", "law", "agent"), [("both", 1, 1), ("law", 1, 0), ("agent", 0, 1)])
def test_controls_says_who_sees_the_sensors(controls, law, agent):
    controller = Controller("proportional", proportional, np.zeros((1, 2)))
    env = CapsuleEnv(controller=controller, disturbances=replace(REAL, controls=controls))
    for info in run(env, swing(100), seed=4):
        states = info["state"], info["reading"]
        assert info["law_torque"] == pytest.approx(shown(states[law]), abs=1e-12)
        seen = states[agent][[0, 1, 3]].clip(-np.array([math.pi / 2, 20.0, 2.0]), [math.pi / 2, 20.0, 2.0])
        np.testing.assert_allclose(info["observation"][:3], seen, rtol=1e-6)
        if agent:
            assert info["observation"][3] == (abs(info["reading"][3]) <= 0.01)


def test_the_law_integrates_the_velocity_that_it_reads():
    controller = Controller("proportional", proportional, np.zeros((1, 2)))
    env = CapsuleEnv(controller=controller, disturbances=Disturbances(x_dot_bias=0.5))
    infos = run(env, np.zeros((15, 1, 1), np.float32), seed=4)
    drift = infos[-1]["reading"][2] - infos[-1]["state"][2]
    assert drift == pytest.approx(0.5 * 0.02 * (len(infos) - 1), abs=2e-3)


def test_what_is_not_measured_reads_zero_and_rounded_readings_are_multiples():
    env = CapsuleEnv(disturbances=Disturbances(unmeasured=("x_dot",), theta_resolution=0.01, theta_dot_resolution=0.25))
    infos = run(env, swing(100), seed=4)
    assert all(info["reading"][3] == info["reading"][2] == info["observation"][2] == 0.0 for info in infos)
    for n, unit in ((0, 0.01), (1, 0.25)):
        readings, states = (np.array([info[name][n] for info in infos]) for name in ("reading", "state"))
        np.testing.assert_allclose(readings / unit, np.round(readings / unit), atol=1e-9)
        assert np.abs(readings - states).max() <= 0.5 * unit + 1e-12


def test_the_motor_follows_the_command_with_its_lag_in_steps_of_its_resolution():
    lag = 0.03
    env = CapsuleEnv(disturbances=Disturbances(lag=lag))
    torques = np.array([info["torque"] for info in run(env, np.full((10, 1, 1), 0.2, np.float32), seed=0)[1:]])
    np.testing.assert_allclose(torques, 0.3 * (1.0 - np.exp(-0.02 / lag * np.arange(1, 11))), rtol=1e-6)
    env = CapsuleEnv(disturbances=Disturbances(torque_resolution=0.07))
    torques = np.array([info["torque"] for info in run(env, swing(100), seed=0)[1:]])
    np.testing.assert_allclose(torques / 0.07, np.round(torques / 0.07), atol=1e-9)


def test_a_push_changes_the_momentum_by_its_impulse():
    smooth = Randomization(M=(0.5, 0.5), mu=(0.0, 0.0))
    env = CapsuleEnv(disturbances=Disturbances(push=0.4), randomization=smooth, physics_dt=5e-4)
    momenta = []
    for info in run(env, np.zeros((501, 1, 1), np.float32), seed=0):
        theta, theta_dot, _, x_dot = info["state"]
        momenta.append((0.5 + NOMINAL.m) * x_dot - NOMINAL.m * NOMINAL.l * math.cos(theta) * theta_dot)
    per_second = np.diff(momenta[::50])
    assert len(per_second) == 10 and np.abs(per_second).max() <= 0.4 * 0.1 + 1e-9
    steps = np.diff(momenta)
    # A push lasts 0.1 s of every second. At 20 ms a step, at most six steps contain a part of it.
    for second in range(10):
        assert 5 <= np.count_nonzero(np.abs(steps[50 * second : 50 * second + 50]) > 1e-9) <= 6
    assert len(set(np.round(per_second, 9))) == 10


@pytest.mark.parametrize(("push", "moves"), [(0.5, False), (2.0, True)])
def test_static_friction_balances_a_push_below_the_threshold_only(push, moves):
    env = CapsuleEnv(disturbances=Disturbances(push=push), randomization=Randomization(M=(0.5, 0.5), mu=(0.1, 0.1)))
    # Without a torque, the upright pendulum does not fall: the platform stands still until it is pushed.
    infos = run(env, np.zeros((150, 1, 1), np.float32), options={"state": [0.0] * 4}, seed=3)
    assert any(info["state"][3] != 0.0 for info in infos) == moves


def reset(**options: object) -> None:
    CapsuleEnv(disturbances="real").reset(options=options)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Disturbances(latency=-1.0),
            r"Disturbances\.latency must be a number from 0 to 0\.5, or a pair .*-1\.0",
        ),
        (lambda: Disturbances(theta_bias=(1.0, 0.0)), r"Disturbances\.theta_bias must be .*, got \(1\.0, 0\.0\)"),
        (lambda: Disturbances(unmeasured=("x",)), r"Disturbances\.unmeasured must be .* got \('x',\)"),
        (lambda: Disturbances(controls="all"), r"Disturbances\.controls must be 'both', 'law' or 'agent', got 'all'"),
        (lambda: CapsuleEnv(disturbances="some"), r"disturbances must be a Disturbances or one of .*, got 'some'"),
        (lambda: Randomization(k=(2.0, 1.0)), r"Randomization\.k must be a pair .* got \(2\.0, 1\.0\)"),
        (lambda: CapsuleEnv(randomization=Randomization(m=(0.1, 40.0), mu=(0.5, 9.0))), r"Painleve"),
        (lambda: CapsuleEnv(randomization=Randomization(c=(0.1, 900.0))), r"physics_dt must be at most"),
        (lambda: reset(disturbances={"latency": 0.1}), r"\['latency'\] must be a number from 0 to 0\.016, got 0\.1"),
        (lambda: reset(disturbances={"speed": 0.1}), r"options\['disturbances'\] must be a dict with keys out of"),
        (lambda: reset(capsule={"m": -1.0}), r"Capsule\.m must be a finite number .* got -1\.0"),
        (
            lambda: CapsuleEnv().reset(options={"capsule": {"m": 0.1}}),
            r"options\['capsule'\] needs an environment with",
        ),
    ],
)
def test_what_cannot_be_is_refused_by_name(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        make()
