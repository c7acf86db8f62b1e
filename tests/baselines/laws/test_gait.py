"""The gait as a law: the torque of its family, the guard of the contact, and what it reaches without being told."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from baselines.gaits.families import FAMILIES
from baselines.laws import gait as module
from baselines.laws.gait import COEFFICIENTS, LIGHTEST, PARAMETERS, gait, gait_identifying, known_parameters
from baselines.policies import SCRIPTED
from capsule_gym import CapsuleVectorEnv
from capsule_gym.layout import ROWS, Row
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS
from capsule_gym.resets import draw_plant
from capsule_gym.task import HORIZON, TORQUE_LIMIT

POLYNOMIAL = FAMILIES["phase-space"]
CONTROL_DT = 0.02


def without_guard():
    """The parameters of the gait, with a guard that does nothing."""
    return (*known_parameters()[:-2], 0.0, 0.0)


def episodes(controller, M, mu, horizon=HORIZON, **options):
    """The environment after an episode without residual on these plants."""
    env = CapsuleVectorEnv(
        len(M),
        controller=controller,
        max_episode_steps=round(HORIZON / CONTROL_DT),
        autoreset_mode="DISABLED",
    )
    env.reset(seed=0, options={"M": np.array(M), "mu": np.array(mu), **options})
    for _ in range(round(horizon / CONTROL_DT)):
        env.step(np.zeros((len(M), 1), np.float32))
    return env


def family_torque(states):
    """What the family gives for states of shape (n, 4), in N m within the limit."""
    coefficients = known_parameters()[: len(COEFFICIENTS)]
    torques = [POLYNOMIAL.torque(coefficients, 0.0, theta, theta_dot, x_dot) for theta, theta_dot, _, x_dot in states]
    return np.clip(TORQUE_LIMIT * np.array(torques), -TORQUE_LIMIT, TORQUE_LIMIT)


def test_the_law_gives_the_torque_of_its_family():
    assert POLYNOMIAL.names == COEFFICIENTS == PARAMETERS[:-2]
    rng = np.random.default_rng(0)
    states = rng.uniform(-1.0, 1.0, (200, 4)) * (1.2, 8.0, 1.0, 0.6)
    states[::5, 3] = 0.0
    controller = gait(without_guard())
    torques = [controller.law(*state, controller.memory, (0.0, 0.0))[0] for state in states.tolist()]
    assert torques == family_torque(states).tolist()


def test_along_an_episode_the_compiled_law_gives_the_torque_of_its_family():
    env = CapsuleVectorEnv(2, controller=gait(without_guard()), control_dt=0.01, autoreset_mode="DISABLED")
    # Heavy enough to stay on the floor without the guard.
    env.reset(seed=0, options={"M": np.array([0.7, 0.75]), "mu": np.array([0.01, 0.1])})
    for _ in range(400):
        _, _, terminated, _, info = env.step(np.zeros((2, 1), np.float32))
        assert not terminated.any()
        assert env.simulation.row(Row.law_torque).tolist() == family_torque(info["state"]).tolist()


def test_the_guard_opposes_the_rate_in_proportion_to_its_excess():
    *_, gain, threshold = known_parameters()
    guarded, free = gait(), gait(without_guard())
    for theta in (-0.6, 0.0, 0.3):
        limit = math.sqrt(threshold / math.cos(theta))
        for theta_dot in (0.99 * limit, 1.1 * limit, -0.99 * limit, -1.2 * limit):
            torque, plain = (law.law(theta, theta_dot, 0.0, 0.1, (0.0,), (0.0, 0.0))[0] for law in (guarded, free))
            excess = max(0.0, theta_dot * theta_dot * math.cos(theta) - threshold)
            assert plain - torque == pytest.approx(math.copysign(gain * excess, theta_dot), abs=1e-9)


def test_only_the_guard_keeps_a_light_platform_on_the_floor():
    M, mu = [0.36] * 6, [0.006, 0.02, 0.05, 0.1, 0.2, 0.28]
    kept, lost = (episodes(controller, M, mu).episode_metrics() for controller in (gait(), gait(without_guard())))
    assert kept["failed"].sum() == 0.0
    assert kept["smallest_normal_ratio"].min() > 0.0
    assert lost["failed"].sum() > 0.0
    assert (lost["smallest_normal_ratio"][lost["failed"] > 0.0] <= 0.0).all()


@pytest.mark.parametrize(("name", "slowest", "mean"), [("paper", 16.0, 18.0), ("wide", 10.0, 17.0)])
def test_the_gait_is_fast_and_does_not_fail_on_plants_that_it_is_not_told(name, slowest, mean):
    rng = np.random.default_rng(31)
    M, mu = np.array([draw_plant(RANDOMIZATIONS[name], NOMINAL, rng) for _ in range(128)]).T
    metrics = episodes("baselines:gait", M, mu).episode_metrics()
    assert metrics["failed"].sum() == 0.0
    assert metrics["mean_speed"].min() > slowest
    assert metrics["mean_speed"].mean() > mean


LIGHT = ([0.26, 0.3, 0.3, 0.33, 0.33, 0.29], [0.003, 0.01, 0.5, 0.05, 0.4, 0.1])


def test_a_guard_that_identifies_keeps_platforms_that_are_lighter_than_it_was_made_for():
    assert max(LIGHT[0]) < LIGHTEST
    kept, lost = (episodes(controller, *LIGHT).episode_metrics() for controller in (gait_identifying(), gait()))
    assert kept["failed"].sum() == 0.0 < lost["failed"].sum()
    # It gives way no further than it must.
    assert kept["mean_speed"].min() > 10.0


def test_a_guard_that_identifies_knows_the_platform():
    env = episodes(gait_identifying(), *LIGHT, horizon=3.0)
    assert env.simulation.row(ROWS + 1) == pytest.approx(np.array(LIGHT[0]), rel=0.02)


def test_on_a_platform_that_the_guard_was_made_for_identifying_changes_nothing():
    M, mu = [0.38, 0.5, 0.5, 0.75], [0.01, 0.01, 0.2, 0.05]
    one, other = (episodes(controller, M, mu).simulation for controller in (gait(), gait_identifying()))
    for row in (Row.theta, Row.theta_dot, Row.x, Row.x_dot, Row.torque):
        assert one.row(row).tolist() == other.row(row).tolist()


@pytest.mark.parametrize("controller", [gait, gait_identifying])
def test_the_gait_follows_no_reference(controller):
    observations = episodes(controller(), [0.5], [0.01], horizon=1.0).simulation.observations
    assert observations[0, 5:9].tolist() == [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(("name", "law"), [("gait-guarded", "gait"), ("gait-identifying", "gait_identifying")])
def test_the_scripted_row_is_the_law_with_a_zero_residual(name, law):
    policy = SCRIPTED[name]
    assert policy.env_kwargs == {"controller": f"baselines:{law}"}
    assert policy.start([0, 1])(np.zeros((2, 10), np.float32)).tolist() == [[0.0], [0.0]]


def test_bad_parameters_are_named():
    with pytest.raises(ValueError, match=r"parameters must be 23 numbers, phi_000, .*, got \[1.0\]"):
        gait([1.0])
    with pytest.raises(ValueError, match="parameters, guard_from, must be a finite number, got nan"):
        gait_identifying((*known_parameters()[:-1], math.nan))
    with pytest.raises(TypeError, match="parameters, phi_000, must be a finite number, got '1'"):
        gait(("1", *known_parameters()[1:]))


def test_a_file_without_a_parameter_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "FILE", tmp_path / "gait.json")
    (tmp_path / "gait.json").write_text(json.dumps({"parameters": {"phi_000": 1.0}}), encoding="utf-8")
    known_parameters.cache_clear()
    try:
        with pytest.raises(ValueError, match=r"law_search` writes, got KeyError: 'phi_001'"):
            known_parameters()
    finally:
        known_parameters.cache_clear()
