"""Disturbances and varied plants: the sensors err as documented, and nothing else changes."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, Controller, Randomization
from capsule_gym.parameters import NOMINAL, REAL, Disturbances

CLEAN = Disturbances(stick_threshold=0.0)
EXACT = replace(CLEAN, x_noise=0.0)
NEAR = {name: (0.9 * getattr(NOMINAL, name), 1.1 * getattr(NOMINAL, name)) for name in "mlkc"}
VARIED = Randomization(M=(0.45, 0.55), mu=(0.009, 0.3), log_mu=True, **NEAR)
# The entries theta, theta_dot and x_dot of a state.
SENSED = [0, 1, 3]
# Bounds of their observations.
BOUNDS = np.array([math.pi / 2, 20.0, 2.0])
# Whether the law and the agent observe the sensors, for each value of `controls`.
CONTROLS = pytest.mark.parametrize(
    ("controls", "law", "agent"), [("both", 1, 1), ("law", 1, 0), ("agent", 0, 1)]
)


def swing(steps, count=1):
    """Torques that swing the pendulum, and throw it over in some environments."""
    torques = np.random.default_rng(0).uniform(-0.6, 0.6, (steps // 10 + 1, count, 1))
    return np.repeat(torques, 10, axis=0)[:steps].astype(np.float32)


def rest(steps):
    return np.zeros((steps, 1, 1), np.float32)


def run(env, actions, **reset):
    """The infos of an episode with these actions, including the observations."""
    observation, info = env.reset(**reset)
    infos = [{**info, "observation": observation}]
    for action in actions[:, 0]:
        observation, _, terminated, _, info = env.step(action)
        infos.append({**info, "observation": observation})
        if terminated:
            break
    return infos


@pytest.mark.parametrize(
    ("task", "controller", "clean"),
    [
        ("speed", None, CLEAN),
        ("speed", "baselines:gait", CLEAN),
        ("goal", None, EXACT),
        ("velocity", None, EXACT),
    ],
)
def test_disturbances_of_size_zero_change_no_bit(task, controller, clean):
    plain = run(CapsuleEnv(task=task, controller=controller), swing(300), seed=3)
    env = CapsuleEnv(task=task, controller=controller, disturbances=clean)
    disturbed = run(env, swing(300), seed=3)
    for one, other in zip(plain, disturbed, strict=True):
        assert_array_equal(one["state"], other["state"])
        assert_array_equal(one["observation"], other["observation"])
        assert one["torque"] == other["torque"]
        assert one["law_torque"] == other["law_torque"]
        assert_array_equal(other["reading"][SENSED], other["state"][SENSED])


CONSTANTS = {
    "m": 0.15,
    "l": 0.28,
    "g": 9.7,
    "k": 0.3,
    "c": 0.1,
    "static_ratio": 1.4,
    "backward_ratio": 1.2,
    "viscous": 0.3,
    "stribeck_speed": 0.1,
    "slope": -0.02,
    "motor_friction": 0.03,
}
PLANTS = Randomization(M=(0.4, 0.6), mu=(0.1, 0.3))
POINTS = replace(PLANTS, **{name: (value, value) for name, value in CONSTANTS.items()})


def test_drawn_constants_make_the_plant_of_a_capsule_with_these():
    capsule = Capsule(**CONSTANTS)
    fixed = CapsuleEnv(randomization=PLANTS, capsule=capsule, physics_dt=0.002)
    drawn = run(CapsuleEnv(randomization=POINTS), swing(200), seed=1)
    assert drawn[0]["capsule"] == CONSTANTS
    for one, other in zip(drawn, run(fixed, swing(200), seed=1), strict=True):
        assert_allclose(one["state"], other["state"], rtol=0.0, atol=1e-11)
        assert one["normal_force"] == pytest.approx(other["normal_force"], rel=1e-9)


def test_options_of_a_reset_make_the_plant_that_another_environment_draws():
    drawn = run(CapsuleEnv(randomization=POINTS), swing(200), seed=1)
    options = {key: drawn[0][key] for key in ("M", "mu", "state", "capsule")}
    options |= {"disturbances": {}, "changes": []}
    given = run(CapsuleEnv(randomization=VARIED), swing(200), options=options)
    for one, other in zip(drawn, given, strict=True):
        assert_array_equal(one["state"], other["state"])


def test_readings_are_late_by_the_latency():
    env = CapsuleEnv(disturbances=Disturbances(latency=(0.0, 0.0409)))
    infos = run(env, swing(100), seed=0, options={"disturbances": {"latency": 0.0409}})
    assert infos[0]["disturbances"]["latency"] == 0.0409
    for now, past in zip(infos[2:], infos, strict=False):
        assert_array_equal(now["reading"][SENSED], past["state"][SENSED])
        assert_allclose(now["observation"][:3], past["state"][SENSED], rtol=1e-6)
    # Until the first delayed state arrives, the sensors show the initial state.
    assert_array_equal(infos[1]["reading"][SENSED], infos[0]["state"][SENSED])


SIZES = {"theta": 0.01, "theta_dot": 0.1, "x_dot": 0.02}
PLATFORMS = 400
STEPS = 50
# The largest |mean| of the products of independent normal numbers, with five standard deviations.
INDEPENDENT = 5.0 / math.sqrt(PLATFORMS * STEPS)


def reading_errors(**given):
    """The errors of readings over their sizes, shape (steps, environments, sensors)."""
    batch = CapsuleVectorEnv(PLATFORMS, disturbances=Disturbances(**given))
    _, info = batch.reset(seed=0)
    errors = []
    for _ in range(STEPS):
        errors.append((info["reading"] - info["state"])[:, SENSED])
        *_, info = batch.step(np.zeros((PLATFORMS, 1), np.float32))
    return np.array(errors) / list(SIZES.values())


def test_the_noise_of_readings_is_white():
    errors = reading_errors(**{f"{name}_noise": size for name, size in SIZES.items()})
    for n in range(3):
        noise = errors[:, :, n]
        assert stats.kstest(noise.ravel(), "norm").pvalue > 1e-3
        assert abs((noise[1:] * noise[:-1]).mean()) < INDEPENDENT
        assert abs((noise * errors[:, :, n - 1]).mean()) < INDEPENDENT


def test_the_drift_of_readings_is_stationary_with_its_correlation_time():
    drifts = {f"{name}_drift": size for name, size in SIZES.items()}
    errors = reading_errors(**drifts, drift_time=0.05)
    for n in range(3):
        drift = errors[:, :, n]
        assert stats.kstest(drift[0], "norm").pvalue > 1e-3
        assert stats.kstest(drift[-1], "norm").pvalue > 1e-3
        # Readings 20 ms apart have the correlation exp(-t / drift_time).
        correlation = (drift[1:] * drift[:-1]).mean() / (drift**2).mean()
        assert correlation == pytest.approx(math.exp(-0.02 / 0.05), abs=0.02)


def test_the_bias_of_readings_is_uniform_and_constant():
    errors = reading_errors(**{f"{name}_bias": (-size, size) for name, size in SIZES.items()})
    for n in range(3):
        bias = errors[:, :, n]
        assert_allclose(bias, np.broadcast_to(bias[0], bias.shape), atol=1e-12)
        assert stats.kstest(bias[0], stats.uniform(-1.0, 2.0).cdf).pvalue > 1e-3


def proportional(theta, theta_dot, x, x_dot, memory, reference):
    """A torque that depends on every value that the law observes."""
    return 0.1 * theta + 0.01 * theta_dot + 0.1 * x + x_dot, memory


PROPORTIONAL = Controller("proportional", proportional, np.zeros((1, 2)))


@CONTROLS
def test_controls_says_who_sees_the_sensors(controls, law, agent):
    env = CapsuleEnv(controller=PROPORTIONAL, disturbances=replace(REAL, controls=controls))
    for info in run(env, swing(100), seed=4):
        states = info["state"], info["reading"]
        torque = np.clip(states[law] @ [0.1, 0.01, 0.1, 1.0], -1.5, 1.5)
        assert info["law_torque"] == pytest.approx(torque, abs=1e-12)
        seen = states[agent][SENSED].clip(-BOUNDS, BOUNDS)
        assert_allclose(info["observation"][:3], seen, rtol=1e-6)
        if agent:
            assert info["observation"][3] == (abs(info["reading"][3]) <= 0.01)


def test_the_law_integrates_the_velocity_that_it_reads():
    env = CapsuleEnv(controller=PROPORTIONAL, disturbances=Disturbances(x_dot_bias=0.5))
    infos = run(env, rest(15), seed=4)
    drift = infos[-1]["reading"][2] - infos[-1]["state"][2]
    assert drift == pytest.approx(0.5 * 0.02 * (len(infos) - 1), abs=2e-3)


def test_a_sensor_of_x_shows_a_late_x_with_its_noise():
    disturbances = Disturbances(x_noise=0.003, x_dot_bias=0.5, latency=0.04)
    batch = CapsuleVectorEnv(PLATFORMS, disturbances=disturbances)
    _, info = batch.reset(seed=0)
    past = [info["state"][:, 2]]
    errors = [info["reading"][:, 2] - past[0]]
    for actions in swing(30, PLATFORMS):
        *_, info = batch.step(actions)
        late = past[-2] if len(past) > 1 else past[0]
        # At the end of an episode the next one begins.
        runs = info["reward_termination"] == 0.0
        errors.append((info["reading"][:, 2] - late)[runs])
        past.append(info["state"][:, 2])
    for one, other in pairwise(errors):
        if len(one) == len(other) == PLATFORMS:
            assert stats.kstest(one / 0.003, "norm").pvalue > 1e-4
            assert abs(np.corrcoef(one, other)[0, 1]) < 0.25


def reads_error(theta, theta_dot, x, x_dot, memory, reference):
    """A torque that shows the task's error and held time, and the difference of the positions."""
    return 0.1 * reference[3] + 0.01 * reference[5] + 0.001 * (reference[2] - x), memory


READS_ERROR = Controller("reads_error", reads_error, np.zeros((1, 2)), task="goal")


@pytest.mark.parametrize("x_noise", [None, 0.001])
@CONTROLS
def test_goals_are_seen_through_the_sensors(controls, law, agent, x_noise):
    disturbances = replace(REAL, controls=controls, x_noise=x_noise, stick_threshold=0.05)
    env = CapsuleEnv(task="goal", controller=READS_ERROR, disturbances=disturbances)
    # The start is close to the goal and at rest, so that the truth and the readings both hold it
    # for some time.
    latency = {"latency": 0.007}
    start = {"state": [0.0, 0.0, 2.0, 0.0], "goal": 0.001, "mu": 0.4, "disturbances": latency}
    infos = run(env, np.concatenate([rest(20), swing(100)]), seed=4, options=start)
    assert infos[0]["disturbances"]["latency"] == 0.007
    # Of the truth and of the readings.
    held = np.zeros(2)
    last = 2.001 - np.array([2.0, infos[0]["reading"][2]])
    for n, info in enumerate(infos):
        x, x_dot = np.array([info["state"], info["reading"]]).T[2:]
        expected = 0.1 * last + 0.01 * held + 0.001 * (2.001 - x)
        assert info["law_torque"] == pytest.approx(expected[law], abs=1e-12)
        last = 2.001 - x
        if n > 0:
            rests = np.abs(x_dot) <= (0.0, 0.05)
            rests[0] &= x[0] == infos[n - 1]["state"][2]
            held = np.where(rests & (np.abs(last) <= 0.002), held + 0.02, 0.0)
        entries = [last[agent], np.tanh(last[agent] / 0.02), min(1.0, held[agent])]
        assert_allclose(info["observation"][-3:], entries, rtol=1e-5, atol=1e-7)
        # The info, and with it the reward, is true.
        assert info["held"] == pytest.approx(held[0])
        assert info["error"] == pytest.approx(last[0])
    assert np.ptp([info["observation"][-1] for info in infos]) > 0.02


@pytest.mark.parametrize("x_noise", [None, 0.001])
def test_velocities_are_seen_through_the_sensors(x_noise):
    env = CapsuleEnv(task="velocity", disturbances=replace(REAL, x_noise=x_noise))
    options = {"commands": [{"t": 0.0, "v": 0.05}, {"t": 0.4, "v": -0.1}]}
    infos = run(env, 0.5 * swing(100), seed=4, options=options)
    # Of the truth and of the readings.
    target = before = np.array([0.0, infos[0]["reading"][2]])
    speed = 0.0
    differences = []
    for n, info in enumerate(infos):
        x = np.array([info["state"][2], info["reading"][2]])
        if n > 0:
            # The command before this step; a new one begins at the present position.
            v = 0.05 if n <= 20 else -0.1
            target = x if n == 20 else x + np.clip(target + 0.02 * v - x, -0.3, 0.3)
            speed += ((x[1] - before[1]) / 0.02 - speed) * 0.02 / 0.27
            assert info["error"] == pytest.approx(target[0] - x[0], abs=1e-12)
        true_error, error = target - x
        expected = [np.tanh(error / 0.05), np.tanh(error / 0.2), np.clip(speed, -2.0, 2.0)]
        assert_allclose(info["observation"][-3:], expected, rtol=1e-5, atol=1e-7)
        before = x
        differences.append(abs(error - true_error))
    assert max(differences) > 1e-3
    assert len(differences) > 25


def test_what_is_not_measured_reads_zero():
    env = CapsuleEnv(disturbances=Disturbances(unmeasured=("x_dot",)))
    for info in run(env, swing(100), seed=4):
        assert info["reading"][2:].tolist() == [0.0, 0.0]
        assert info["observation"][2] == 0.0


@pytest.mark.parametrize(("name", "entry", "unit"), [("theta", 0, 0.01), ("theta_dot", 1, 0.25)])
def test_rounded_readings_are_the_nearest_multiples(name, entry, unit):
    disturbances = Disturbances(unmeasured=("x_dot",), **{f"{name}_resolution": unit})
    for info in run(CapsuleEnv(disturbances=disturbances), swing(100), seed=4):
        reading = info["reading"][entry]
        assert reading / unit == pytest.approx(round(reading / unit), abs=1e-9)
        assert abs(reading - info["state"][entry]) <= 0.5 * unit + 1e-12


def motor_torques(actions, **given):
    env = CapsuleEnv(disturbances=Disturbances(**given))
    return np.array([info["torque"] for info in run(env, actions, seed=0)[1:]])


def test_the_motor_follows_the_command_with_its_lag():
    torques = motor_torques(rest(10) + np.float32(0.2), lag=0.03)
    expected = 0.3 * (1.0 - np.exp(-0.02 / 0.03 * np.arange(1, 11)))
    assert_allclose(torques, expected, rtol=1e-6)


def test_the_motor_follows_the_command_in_steps_of_its_resolution():
    steps = motor_torques(swing(100), torque_resolution=0.07) / 0.07
    assert_allclose(steps, np.round(steps), atol=1e-9)


def test_rounding_does_not_take_the_command_beyond_its_limit():
    torques = motor_torques(rest(3) + np.float32(1.0), torque_resolution=0.4)
    assert torques.tolist() == [1.5] * 3


def test_a_push_changes_the_momentum_by_its_impulse():
    smooth = Randomization(M=(0.5, 0.5), mu=(0.0, 0.0))
    env = CapsuleEnv(disturbances=Disturbances(push=0.4), randomization=smooth, physics_dt=5e-4)
    momenta = []
    for info in run(env, rest(501), seed=0):
        theta, theta_dot, _, x_dot = info["state"]
        ball_dot = x_dot - NOMINAL.l * math.cos(theta) * theta_dot
        momenta.append(0.5 * x_dot + NOMINAL.m * ball_dot)
    # A push lasts 0.1 s of every second. At 20 ms a step, at most six steps contain a part of it.
    per_second = np.diff(momenta[::50])
    assert len(per_second) == 10
    assert np.abs(per_second).max() <= 0.4 * 0.1 + 1e-9
    assert len(set(np.round(per_second, 9))) == 10
    for steps in np.diff(momenta)[:500].reshape(10, 50):
        assert 5 <= np.count_nonzero(np.abs(steps) > 1e-9) <= 6


@pytest.mark.parametrize(("push", "moves"), [(0.5, False), (2.0, True)])
def test_static_friction_balances_a_push_below_the_threshold_only(push, moves):
    plant = Randomization(M=(0.5, 0.5), mu=(0.1, 0.1))
    env = CapsuleEnv(disturbances=Disturbances(push=push), randomization=plant)
    # Without a torque, the upright pendulum does not fall: the platform stands still until it is
    # pushed.
    infos = run(env, rest(150), options={"state": [0.0] * 4}, seed=3)
    assert any(info["state"][3] != 0.0 for info in infos) == moves
