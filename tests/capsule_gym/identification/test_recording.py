import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from capsule_gym import CapsuleEnv, Disturbances, Excitation, record
from capsule_gym.control.laws.periodic import FEEDFORWARD
from capsule_gym.evaluation.episodes import evaluate, failures, validation_set
from capsule_gym.identification.log import read_log
from tests.capsule_gym.identification.rig import make_env

CONTROL_DT = 0.01


@pytest.fixture(scope="module")
def policies():
    """Torques, N m, of the same excitation at rest, at an angle, and at a rate."""
    excitation = Excitation(seed=3, amplitude=0.2, torque_limit=2.0)

    def torques(theta, theta_dot):
        act = excitation.start()
        observation = np.float32([theta, theta_dot, 0.0, 0.0, 0.0])
        return np.concatenate([2.0 * act(observation) for _ in range(4000)])

    return torques(0.0, 0.0), torques(0.1, 0.0), torques(0.0, 1.0)


def test_an_excitation_is_a_multisine_of_its_size(policies):
    rest, _, _ = policies
    power = np.abs(np.fft.rfft(rest * np.hanning(len(rest)))) ** 2
    frequencies = np.fft.rfftfreq(len(rest), CONTROL_DT)
    inside = (frequencies > 0.25) & (frequencies < 8.05)
    assert np.sqrt(np.mean(rest**2)) == pytest.approx(0.2, rel=0.1)
    assert power[inside].sum() > 0.999 * power.sum()


def test_an_excitation_contains_a_weak_pd_law(policies):
    rest, leant, swung = policies
    assert leant - rest == pytest.approx(-0.06, abs=1e-6)
    assert swung - rest == pytest.approx(-0.04, abs=1e-6)


@pytest.mark.parametrize(("theta", "action"), [(9.0, -1.0), (-9.0, 1.0)])
def test_an_excitation_is_limited(theta, action):
    assert Excitation().start()(np.float32([theta, 0.0]))[0] == action


def test_numbers_of_an_excitation_are_named():
    with pytest.raises(TypeError, match="positional"):
        Excitation(3, 0.2)


def test_an_excitation_is_also_a_law():
    excitation = Excitation(seed=3, amplitude=0.3)
    env = CapsuleEnv(control_dt=CONTROL_DT, controller=None, randomization="none")
    expected = record(env, excitation, seconds=2.0, seed=0)
    env = CapsuleEnv(
        control_dt=CONTROL_DT, controller=excitation.controller(3.0), randomization="none"
    )
    env.reset(seed=0)
    torques = []
    for _ in expected["t"]:
        _, _, _, _, info = env.step(np.zeros(1, np.float32))
        torques.append(info["torque"])
    # The actions of the policy are in float32.
    np.testing.assert_allclose(torques, expected["torque"], rtol=0.0, atol=1e-5)


def test_the_excitations_of_all_seeds_cover_its_frequencies():
    power = np.zeros(1001)
    for seed in range(10):
        controller = Excitation(seed=seed, amplitude=0.1).controller()
        assert len(controller.reference) == 2000
        torques = controller.reference[:, FEEDFORWARD]
        power += np.abs(np.fft.rfft(torques * np.hanning(2000))) ** 2
    frequencies = np.fft.rfftfreq(2000, CONTROL_DT)
    present = frequencies[power > 0.01 * power.max()]
    assert present.min() == pytest.approx(0.3, abs=0.1)
    assert present.max() == pytest.approx(8.0, rel=0.1)


def test_an_excitation_takes_the_observations_of_tasks_with_a_goal():
    observation = np.float32([0.3, -1.0, 0.0])
    excitation = Excitation()
    assert excitation.start()({"observation": observation}) == excitation.start()(observation)


def test_the_excitation_of_a_log_is_that_of_its_environment():
    options = {"control_dt": 0.02, "residual_limit": 3.0, "torque_limit": 3.0}
    found = record(make_env(**options), seconds=1.0, seed=0)
    excitation = Excitation(control_dt=0.02, torque_limit=3.0)
    expected = record(make_env(**options), excitation, seconds=1.0, seed=0)
    assert np.array_equal(found["torque"], expected["torque"])


def test_the_shortest_excitation_has_two_steps():
    assert len(Excitation().controller(0.02).reference) == 2


@pytest.mark.parametrize("seconds", [0.0, -1.0, math.nan])
def test_an_excitation_has_a_duration(seconds):
    with pytest.raises(ValueError, match="seconds must be a finite number"):
        Excitation().controller(seconds)


def test_no_plant_meets_its_stop_under_the_law():
    plants = validation_set("real-wide", "excited", 22_000_000, 20, disturbances="real")
    law = Excitation(amplitude=0.35).controller()
    episodes = evaluate(law, plants, env_kwargs={"control_dt": CONTROL_DT}, horizon=20.0)
    assert failures(episodes) == 0


@pytest.fixture
def recorded(tmp_path):
    """The actions of a policy, the log, and its file."""
    actions = []

    def policy(observation):
        actions.append(np.float32([0.5 - 0.2 * observation[0]]))
        return actions[-1]

    path = tmp_path / "log.csv"
    log = record(make_env(torque_limit=1.0), policy, path, seconds=0.5, seed=0)
    return actions, log, path


def test_a_log_contains_what_happens(recorded):
    actions, log, _ = recorded
    assert list(log) == ["t", "torque", "theta", "theta_dot", "x", "x_dot"]
    assert len(log["t"]) == 50
    assert np.array_equal(log["torque"], np.ravel(actions).astype(float))
    states = np.transpose([log[name] for name in list(log)[2:]])
    env = make_env(torque_limit=1.0)
    env.reset(seed=0)
    for action, following in zip(actions, states[1:], strict=False):
        assert np.array_equal(following, env.step(action)[4]["state"])


def test_the_file_contains_the_bits_of_the_log(recorded):
    _, log, path = recorded
    read = np.genfromtxt(path, delimiter=",", names=True)
    for name, column in log.items():
        assert np.array_equal(read[name], column)


def test_an_existing_file_is_not_replaced(recorded):
    with pytest.raises(ValueError, match="path must be that of a new file"):
        record(make_env(), path=recorded[-1])


def test_an_environment_with_a_controller_raises_an_error():
    with pytest.raises(ValueError, match="env must be an environment with direct torque"):
        record(CapsuleEnv(controller="baselines:gait"))


TOTAL = {"residual_limit": 0.5, "total_torque": True}


@pytest.mark.parametrize(
    ("action", "torque", "options"),
    [(0.2, 0.3, TOTAL), (0.9, 0.5, TOTAL), (0.9, 1.5, {"residual_limit": 2.0})],
)
def test_the_torque_is_that_of_the_environment(action, torque, options):
    log = record(make_env(**options), lambda _: np.float32([action]), seconds=CONTROL_DT)
    assert log["torque"] == pytest.approx([torque])


def test_the_torque_is_that_behind_wrappers():
    env = gym.wrappers.RescaleAction(make_env(), np.float32(0.0), np.float32(1.0))
    log = record(env, lambda _: np.float32([0.75]), seconds=CONTROL_DT)
    assert log["torque"] == pytest.approx([0.75])


def test_sensors_that_do_not_exist_are_left_out():
    env = make_env(disturbances=Disturbances(latency=0.01, unmeasured=("x_dot",)))
    assert list(record(env, seconds=0.1, seed=0)) == ["t", "torque", "theta", "theta_dot"]


def test_lost_readings_are_empty_cells_and_held_ones_are_written(tmp_path):
    disturbances = Disturbances(lost=0.3, hold=2, theta_noise=0.01)
    path = tmp_path / "log.csv"
    log = record(make_env(disturbances=disturbances), path=path, seconds=3.0, seed=0)
    assert "nan" not in path.read_text(encoding="utf-8")
    read = read_log(path)
    for name in ("theta", "theta_dot", "x_dot"):
        assert np.array_equal(read[name], log[name], equal_nan=True)
        assert 0.2 < np.isnan(log[name]).mean() < 0.4
        for sample in np.reshape(log[name], (-1, 3)):
            assert len({*sample[~np.isnan(sample)]}) <= 1


def test_a_log_without_lost_readings_is_that_of_an_environment_without():
    rough = Disturbances(lost=0.3, theta_noise=0.01)
    lossy = record(make_env(disturbances=rough), lambda _: np.float32([0.2]), seconds=0.5, seed=0)
    smooth = replace(rough, lost=0.0)
    whole = record(make_env(disturbances=smooth), lambda _: np.float32([0.2]), seconds=0.5, seed=0)
    received = ~np.isnan(lossy["theta"])
    assert np.array_equal(lossy["theta"][received], whole["theta"][received])
    assert not np.isnan(whole["theta"]).any()


def test_times_of_a_log_are_those_of_its_readings():
    rest = [0.3, 0.0, 0.0, 0.0]
    disturbances = Disturbances(jitter=0.004)
    late = record(make_env(disturbances=disturbances), seconds=1.0, seed=0, options={"state": rest})
    policy = iter(np.float32(late["torque"])[:, None] / np.float32(1.5))
    exact = record(make_env(), lambda _: next(policy), seconds=1.0, seed=0, options={"state": rest})
    early = exact["t"] - late["t"]
    assert early.min() >= 0.0
    assert 0.003 < early.max() < 0.004
    # Rates are of the order of 1 rad/s, and curves of 10 rad/s^2.
    theta = CubicHermiteSpline(exact["t"], exact["theta"], exact["theta_dot"])
    assert late["theta"][1:] == pytest.approx(theta(late["t"][1:]), abs=1e-4)
    assert np.abs(late["theta"] - exact["theta"]).max() > 1e-3
