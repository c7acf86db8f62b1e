"""When readings are taken, repeated and lost; nothing else changes."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats
from scipy.interpolate import CubicHermiteSpline

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, load_policy
from capsule_gym.core.layout import Row
from capsule_gym.parameters import REAL, Disturbances
from capsule_gym.parameters.disturbances import SAMPLING
from tests.capsule_gym.envs.test_disturbances import SENSED, run, swing

# All at once, from ranges.
ROUGH = replace(
    REAL,
    jitter=(0.0, 0.007),
    lost=(0.0, 0.5),
    hold=(0.0, 3.0),
    theta_latency=(0.0, 0.01),
    theta_dot_latency=(0.0, 0.02),
    x_dot_latency=(0.0, 0.03),
)
COUNT = 300


def batch_readings(steps=60, **given):
    """States, readings and the rows from `early` to `lost_x_dot` of a batch, by steps."""
    batch = CapsuleVectorEnv(COUNT, disturbances=Disturbances(**given))
    _, info = batch.reset(seed=0)
    found = []
    for actions in 0.5 * swing(steps, COUNT):
        sampling = batch.simulation.rows(Row.early, Row.lost_x_dot + 1)
        found.append((info["state"].T, info["reading"].T, sampling))
        *_, info = batch.step(actions)
    return map(np.array, zip(*found, strict=True))


@pytest.mark.parametrize("controller", [None, "baselines:gait"])
def test_a_sensor_is_late_by_its_own_latency(controller):
    late = {"latency": 0.02, "theta_latency": 0.04, "x_dot_latency": 0.0201}
    env = CapsuleEnv(controller=controller, disturbances=Disturbances(controls="agent", **late))
    infos = run(env, 0.02 * swing(60), seed=0)
    states = np.array([info["state"] for info in infos])
    assert len(states) == 61
    for step, info in enumerate(infos):
        theta, theta_dot, _, x_dot = info["reading"]
        assert theta == states[max(0, step - 3), 0]
        assert theta_dot == states[max(0, step - 1), 1]
        assert x_dot == states[max(0, step - 2), 3]


def fine_trajectory(torques, physics_dt):
    """Times and states of the plant at every step of the integrator."""
    env = CapsuleEnv(control_dt=physics_dt, physics_dt=physics_dt, randomization="none")
    actions = np.repeat(torques, round(0.02 / physics_dt), axis=0)
    states = np.array([info["state"] for info in run(env, actions, seed=0)])
    return physics_dt * np.arange(len(states)), states


@pytest.mark.parametrize(("physics_dt", "tolerance"), [(0.002, 1e-11), (0.0002, 1e-3)])
def test_jitter_takes_readings_early(physics_dt, tolerance):
    disturbances = Disturbances(jitter=0.015, latency=0.02)
    env = CapsuleEnv(randomization="none", disturbances=disturbances)
    torques = 0.1 * swing(60)
    t, states = fine_trajectory(torques, physics_dt)
    theta = CubicHermiteSpline(t, states[:, 0], states[:, 1])
    x = CubicHermiteSpline(t, states[:, 2], states[:, 3])
    env.reset(seed=0)
    shifts = []
    for step in range(1, 61):
        *_, info = env.step(torques[step - 1, 0])
        early = env.simulation.row(Row.early)[0]
        shifts.append(early)
        time = 0.02 * step - 0.02 - early
        if time < 0.0:
            continue
        expected = [theta(time), theta.derivative()(time), x.derivative()(time)]
        assert_allclose(info["reading"][SENSED], expected, rtol=0.0, atol=tolerance)
    assert len(set(shifts)) == 60


def test_jitter_is_uniform_and_white():
    _, _, sampling = batch_readings(jitter=0.003)
    early = sampling[:, 0]
    assert stats.kstest(early.ravel(), stats.uniform(0.0, 0.003).cdf).pvalue > 1e-3
    between = np.corrcoef(early[1:].ravel(), early[:-1].ravel())[0, 1]
    assert abs(between) < 5.0 / math.sqrt(early.size)


@pytest.mark.parametrize("hold", [1, 2.4, 7])
def test_a_sensor_repeats_its_sample(hold):
    env = CapsuleEnv(disturbances=Disturbances(hold=(0.0, hold), x_noise=0.0))
    infos = run(env, 0.2 * swing(60), seed=0, options={"disturbances": {"hold": hold}})
    assert infos[0]["disturbances"]["hold"] == hold
    for step, info in enumerate(infos):
        sampled = infos[step - step % (round(hold) + 1)]
        assert_array_equal(info["reading"], sampled["state"])


def test_noise_and_drift_of_a_repeated_sample_are_repeated():
    env = CapsuleEnv(disturbances=replace(REAL, hold=4))
    readings = np.array([info["reading"][SENSED] for info in run(env, swing(40), seed=2)])
    changes = np.any(np.diff(readings, axis=0) != 0.0, axis=1)
    assert_array_equal(np.flatnonzero(changes), np.arange(4, len(changes), 5))


def test_readings_are_lost_with_their_probability():
    _, _, sampling = batch_readings(lost=0.3)
    lost = sampling[1:, -4:]
    assert not sampling[0, -4:].any()
    bound = 5.0 / math.sqrt(lost[:, 0].size)
    for sensor in range(4):
        own, other = lost[:, sensor], lost[:, sensor - 1]
        assert own.mean() == pytest.approx(0.3, abs=0.5 * bound)
        assert abs(np.corrcoef(own.ravel(), other.ravel())[0, 1]) < bound
        assert abs(np.corrcoef(own[1:].ravel(), own[:-1].ravel())[0, 1]) < bound


@pytest.mark.parametrize("hold", [0, 3])
def test_a_lost_reading_leaves_the_last_one_received(hold):
    states, readings, sampling = batch_readings(lost=0.4, hold=hold, x_noise=0.0, steps=25)
    # Those of the first episodes: a batch begins others.
    lost = sampling[:, -4:] != 0.0
    for step in range(1, 10):
        sample = states[step - step % (hold + 1)]
        assert_array_equal(readings[step], np.where(lost[step], readings[step - 1], sample))


def test_everything_but_the_first_reading_may_be_lost():
    env = CapsuleEnv(controller="baselines:gait", disturbances=Disturbances(lost=1.0))
    infos = run(env, 0.1 * swing(30), seed=0)
    for info in infos:
        assert_array_equal(info["reading"][SENSED], infos[0]["state"][SENSED])
        assert info["law_torque"] == infos[0]["law_torque"]


@pytest.mark.parametrize("name", SAMPLING)
def test_sampling_changes_no_other_draw(name):
    plain = CapsuleEnv(disturbances=REAL).reset(seed=5)[1]["disturbances"]
    given = replace(REAL, **{name: (0.0, 0.5)})
    drawn = CapsuleEnv(disturbances=given).reset(seed=5)[1]["disturbances"]
    assert 0.0 < drawn.pop(name) < 0.5
    assert plain.pop(name) == 0.0
    assert drawn == plain


def test_losses_change_no_other_bit():
    actions = 0.3 * swing(60)
    plain = run(CapsuleEnv(disturbances=REAL), actions, seed=5)
    lossy = run(CapsuleEnv(disturbances=replace(REAL, lost=0.5)), actions, seed=5)
    received = 0
    for one, other in zip(plain, lossy, strict=True):
        assert_array_equal(one["state"], other["state"])
        received += np.sum(one["reading"][SENSED] == other["reading"][SENSED])
    assert 0.4 < received / (3 * len(plain)) < 0.6


@pytest.mark.parametrize("controller", [None, "baselines:gait_predictive"])
def test_a_batch_has_the_bits_of_single_environments(controller):
    options = {"controller": controller, "disturbances": ROUGH}
    batch = CapsuleVectorEnv(9, **options)
    single = [CapsuleEnv(**options) for _ in range(9)]
    for seed in (3, 11):
        observations, _ = batch.reset(seed=seed)
        expected = [env.reset(seed=seed + n)[0] for n, env in enumerate(single)]
        assert_array_equal(observations, expected)
        for actions in 0.1 * swing(20, 9):
            observations, *_, info = batch.step(actions)
            steps = [env.step(action) for env, action in zip(single, actions, strict=True)]
            assert_array_equal(observations, [step[0] for step in steps])
            assert_array_equal(info["reading"], [step[4]["reading"] for step in steps])


@pytest.mark.parametrize("name", ["residual-real", "dp-distilled-real", "goal", "velocity"])
def test_policies_meet_rough_sampling(name):
    policy = load_policy(name)
    options = {**policy.env_kwargs, "disturbances": replace(ROUGH, lost=0.9, hold=5)}
    env = CapsuleVectorEnv(4, **options)
    observations, _ = env.reset(seed=0)
    act = policy.start(range(4))
    for _ in range(60):
        assert np.isfinite(observations).all()
        observations, rewards, *_ = env.step(act(observations))
        assert np.isfinite(rewards).all()


def without_sampling(env):
    """A copy from a pickle as it was before environments knew when readings are taken."""
    state = env.simulation.__getstate__()
    del state["rows"]
    state["world"] = np.delete(state["world"], np.arange(Row.jitter, Row.key), axis=1)
    options = pickle.loads(pickle.dumps(state["options"]))
    for name in SAMPLING:
        del options.disturbances.__dict__[name]
    copied = env.simulation.__class__.__new__(env.simulation.__class__)
    copied.__setstate__({**state, "options": options})
    return copied


def test_an_older_pickle_continues_its_episodes():
    env = CapsuleVectorEnv(130, disturbances=replace(REAL, latency=(0.0, 0.03)))
    env.reset(seed=2)
    actions = 0.2 * swing(20, 130)
    for torques in actions:
        env.step(torques)
    copied = without_sampling(env)
    for torques in actions:
        env.simulation.step(torques[:, 0])
        copied.step(torques[:, 0])
    assert_array_equal(copied.observations, env.simulation.observations)
