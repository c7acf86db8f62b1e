"""Disturbances and varied plants: the sensors err as documented, nothing else changes, and every
contract holds."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, Controller, Randomization
from capsule_gym.parameters import NOMINAL, REAL, Disturbances

CLEAN = Disturbances(stick_threshold=0.0)
EXACT = replace(CLEAN, x_noise=0.0)
CASES = [
    ("speed", None, CLEAN),
    ("speed", "baselines:gait", CLEAN),
    ("goal", None, EXACT),
    ("velocity", None, EXACT),
]
NEAR = {name: (0.9 * getattr(NOMINAL, name), 1.1 * getattr(NOMINAL, name)) for name in "mlkc"}
VARIED = Randomization(M=(0.45, 0.55), mu=(0.009, 0.3), log_mu=True, **NEAR)


def swing(steps, count=1, seed=0):
    """Torques that swing the pendulum, and throw it over in some environments."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-0.6, 0.6, (steps // 10 + 1, count, 1)), 10, axis=0)[
        :steps
    ].astype(np.float32)


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


@pytest.mark.parametrize(("task", "controller", "clean"), CASES)
def test_disturbances_of_size_zero_change_no_bit(task, controller, clean):
    plain, disturbed = (
        CapsuleEnv(task=task, controller=controller, disturbances=each) for each in ("none", clean)
    )
    actions = swing(300)
    for one, other in zip(
        run(plain, actions, seed=3), run(disturbed, actions, seed=3), strict=True
    ):
        np.testing.assert_array_equal(one["state"], other["state"])
        np.testing.assert_array_equal(one["observation"], other["observation"])
        assert one["torque"] == other["torque"] and one["law_torque"] == other["law_torque"]
        np.testing.assert_array_equal(other["reading"][[0, 1, 3]], other["state"][[0, 1, 3]])


def test_drawn_constants_make_the_plant_of_a_capsule_with_these():
    given = {
        "m": 0.15,
        "l": 0.28,
        "g": 9.7,
        "k": 0.3,
        "c": 0.1,
        "static_ratio": 1.4,
        "backward_ratio": 1.2,
    }
    given |= {"viscous": 0.3, "stribeck_speed": 0.1, "slope": -0.02, "motor_friction": 0.03}
    capsule = Capsule(**given)
    ranges = Randomization(
        M=(0.4, 0.6), mu=(0.1, 0.3), **{name: (value, value) for name, value in given.items()}
    )
    actions, own = swing(200), Randomization(M=ranges.M, mu=ranges.mu)
    drawn = run(CapsuleEnv(randomization=ranges), actions, seed=1)
    begun = {key: drawn[0][key] for key in ("M", "mu", "state")}
    options = {**begun, "capsule": given, "disturbances": {}, "changes": []}
    set_ = run(CapsuleEnv(randomization=VARIED), actions, options=options)
    fixed = run(CapsuleEnv(randomization=own, capsule=capsule, physics_dt=0.002), actions, seed=1)
    assert drawn[0]["capsule"] == given
    for one, other, third in zip(drawn, fixed, set_, strict=True):
        np.testing.assert_allclose(one["state"], other["state"], rtol=0.0, atol=1e-11)
        np.testing.assert_array_equal(one["state"], third["state"])
        assert one["normal_force"] == pytest.approx(other["normal_force"], rel=1e-9)


def test_readings_are_late_by_the_latency():
    env = CapsuleEnv(disturbances=Disturbances(latency=(0.0, 0.0409)))
    infos = run(env, swing(100), seed=0, options={"disturbances": {"latency": 0.0409}})
    assert infos[0]["disturbances"]["latency"] == 0.0409
    for now, past in zip(infos[2:], infos, strict=False):
        np.testing.assert_array_equal(now["reading"][[0, 1, 3]], past["state"][[0, 1, 3]])
        np.testing.assert_allclose(now["observation"][:3], past["state"][[0, 1, 3]], rtol=1e-6)
    # Until the first delayed state arrives, the sensors show the initial state.
    np.testing.assert_array_equal(infos[1]["reading"][[0, 1, 3]], infos[0]["state"][[0, 1, 3]])


def test_the_errors_of_readings_have_the_sizes_and_the_memory_that_are_asked_for():
    size = {"theta": 0.01, "theta_dot": 0.1, "x_dot": 0.02}
    count, steps = 400, 50

    def errors(kind, **given):
        """The errors of the sensors relative to the size that is asked for, of readings by step and
        environment."""
        given |= {
            f"{name}_{kind}": (-value, value) if kind == "bias" else value
            for name, value in size.items()
        }
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
        # The drift is stationary from the start; between readings 20 ms apart, its correlation is
        # exp(-t / drift_time).
        assert stats.kstest(drift[0, :, n], "norm").pvalue > 1e-3
        assert stats.kstest(drift[-1, :, n], "norm").pvalue > 1e-3
        memory = (drift[1:, :, n] * drift[:-1, :, n]).mean() / (drift[:, :, n] ** 2).mean()
        assert memory == pytest.approx(math.exp(-0.02 / 0.05), abs=0.02)
        np.testing.assert_allclose(
            bias[:, :, n], np.broadcast_to(bias[0, :, n], (steps, count)), atol=1e-12
        )
        assert stats.kstest(bias[0, :, n], stats.uniform(-1.0, 2.0).cdf).pvalue > 1e-3


def proportional(theta, theta_dot, x, x_dot, memory, reference):
    """A torque that depends on every value that the law observes."""
    return 0.1 * theta + 0.01 * theta_dot + 0.1 * x + x_dot, memory


@pytest.mark.parametrize(
    ("controls", "law", "agent"), [("both", 1, 1), ("law", 1, 0), ("agent", 0, 1)]
)
def test_controls_says_who_sees_the_sensors(controls, law, agent):
    controller = Controller("proportional", proportional, np.zeros((1, 2)))
    env = CapsuleEnv(controller=controller, disturbances=replace(REAL, controls=controls))
    for info in run(env, swing(100), seed=4):
        states = info["state"], info["reading"]
        torque = np.clip(states[law] @ [0.1, 0.01, 0.1, 1.0], -1.5, 1.5)
        assert info["law_torque"] == pytest.approx(torque, abs=1e-12)
        seen = states[agent][[0, 1, 3]].clip(
            -np.array([math.pi / 2, 20.0, 2.0]), [math.pi / 2, 20.0, 2.0]
        )
        np.testing.assert_allclose(info["observation"][:3], seen, rtol=1e-6)
        if agent:
            assert info["observation"][3] == (abs(info["reading"][3]) <= 0.01)


def test_the_law_integrates_the_velocity_that_it_reads():
    controller = Controller("proportional", proportional, np.zeros((1, 2)))
    env = CapsuleEnv(controller=controller, disturbances=Disturbances(x_dot_bias=0.5))
    infos = run(env, np.zeros((15, 1, 1), np.float32), seed=4)
    drift = infos[-1]["reading"][2] - infos[-1]["state"][2]
    assert drift == pytest.approx(0.5 * 0.02 * (len(infos) - 1), abs=2e-3)


def test_a_sensor_of_x_shows_a_late_x_with_its_noise():
    batch = CapsuleVectorEnv(
        400, disturbances=Disturbances(x_noise=0.003, x_dot_bias=0.5, latency=0.04)
    )
    _, info = batch.reset(seed=0)
    past, errors = [info["state"][:, 2]], [info["reading"][:, 2] - info["state"][:, 2]]
    for actions in swing(30, 400):
        _, _, _, _, info = batch.step(actions)
        # At the end of an episode the next one begins.
        errors.append(
            (info["reading"][:, 2] - past[-2 if len(past) > 1 else -1])[
                info["reward_termination"] == 0.0
            ]
        )
        past.append(info["state"][:, 2])
    for one, other in pairwise(errors):
        if len(one) == len(other) == 400:
            assert (
                stats.kstest(one / 0.003, "norm").pvalue > 1e-4
                and abs(np.corrcoef(one, other)[0, 1]) < 0.25
            )


def reads_error(theta, theta_dot, x, x_dot, memory, reference):
    """A torque that shows the error and the held time in the task's memory, and the difference of
    the positions."""
    return 0.1 * reference[3] + 0.01 * reference[5] + 0.001 * (reference[2] - x), memory


@pytest.mark.parametrize("x_noise", [None, 0.001])
@pytest.mark.parametrize(
    ("controls", "law", "agent"), [("both", 1, 1), ("law", 1, 0), ("agent", 0, 1)]
)
def test_goals_are_seen_through_the_sensors(controls, law, agent, x_noise):
    disturbances = replace(REAL, controls=controls, x_noise=x_noise, stick_threshold=0.05)
    controller = Controller("reads_error", reads_error, np.zeros((1, 2)), task="goal")
    env = CapsuleEnv(task="goal", controller=controller, disturbances=disturbances)
    # The start is close to the goal and at rest, so that the truth and the readings both hold it
    # for some time.
    options = {
        "state": [0.0, 0.0, 2.0, 0.0],
        "goal": 0.001,
        "mu": 0.4,
        "disturbances": {"latency": 0.007},
    }
    infos = run(
        env,
        np.concatenate([np.zeros((20, 1, 1)), swing(100)]).astype(np.float32),
        seed=4,
        options=options,
    )
    assert infos[0]["disturbances"]["latency"] == 0.007
    held = np.zeros(2)
    for n, info in enumerate(infos):
        seen = np.array(
            [[info["state"][2], info["state"][3]], [info["reading"][2], info["reading"][3]]]
        )
        if n == 0:
            last = 2.001 - seen[:, 0]
        expected = 0.1 * last + 0.01 * held + 0.001 * (2.001 - seen[:, 0])
        assert info["law_torque"] == pytest.approx(expected[law], abs=1e-12)
        if n > 0:
            last = 2.001 - seen[:, 0]
            rests = np.abs(seen[:, 1]) <= (0.0, 0.05)
            rests[0] &= info["state"][2] == infos[n - 1]["state"][2]
            held = np.where(rests & (np.abs(last) <= 0.002), held + 0.02, 0.0)
        entries = [last[agent], np.tanh(last[agent] / 0.02), min(1.0, held[agent])]
        np.testing.assert_allclose(info["observation"][-3:], entries, rtol=1e-5, atol=1e-7)
        # The info, and with it the reward, is true.
        assert info["held"] == pytest.approx(held[0]) and info["error"] == pytest.approx(last[0])
    assert np.ptp([info["observation"][-1] for info in infos]) > 0.02


@pytest.mark.parametrize("x_noise", [None, 0.001])
def test_velocities_are_seen_through_the_sensors(x_noise):
    env = CapsuleEnv(task="velocity", disturbances=replace(REAL, x_noise=x_noise))
    commands = [{"t": 0.0, "v": 0.05}, {"t": 0.4, "v": -0.1}]
    speed = before = true_target = 0.0
    differences = []
    for n, info in enumerate(run(env, 0.5 * swing(100), seed=4, options={"commands": commands})):
        x, entries = info["reading"][2], info["observation"][-3:]
        if n == 0:
            target = x
        else:
            # The command before this step.
            v = 0.05 if n <= 20 else -0.1
            target = x if n == 20 else x + np.clip(target + 0.02 * v - x, -0.3, 0.3)
            speed += ((x - before) / 0.02 - speed) * 0.02 / 0.27
            true_x = info["state"][2]
            true_target = (
                true_x if n == 20 else true_x + np.clip(true_target + 0.02 * v - true_x, -0.3, 0.3)
            )
            assert info["error"] == pytest.approx(true_target - true_x, abs=1e-12)
        expected = [
            np.tanh((target - x) / 0.05),
            np.tanh((target - x) / 0.2),
            np.clip(speed, -2.0, 2.0),
        ]
        np.testing.assert_allclose(entries, expected, rtol=1e-5, atol=1e-7)
        before = x
        differences.append(abs(target - x - true_target + info["state"][2]))
    assert max(differences) > 1e-3 and len(differences) > 25


def test_what_is_not_measured_reads_zero_and_rounded_readings_are_multiples():
    env = CapsuleEnv(
        disturbances=Disturbances(
            unmeasured=("x_dot",), theta_resolution=0.01, theta_dot_resolution=0.25
        )
    )
    infos = run(env, swing(100), seed=4)
    assert all(
        info["reading"][3] == info["reading"][2] == info["observation"][2] == 0.0 for info in infos
    )
    for n, unit in ((0, 0.01), (1, 0.25)):
        readings, states = (
            np.array([info[name][n] for info in infos]) for name in ("reading", "state")
        )
        np.testing.assert_allclose(readings / unit, np.round(readings / unit), atol=1e-9)
        assert np.abs(readings - states).max() <= 0.5 * unit + 1e-12


def test_the_motor_follows_the_command_with_its_lag_in_steps_of_its_resolution():
    env = CapsuleEnv(disturbances=Disturbances(lag=0.03))
    torques = np.array(
        [info["torque"] for info in run(env, np.full((10, 1, 1), 0.2, np.float32), seed=0)[1:]]
    )
    np.testing.assert_allclose(
        torques, 0.3 * (1.0 - np.exp(-0.02 / 0.03 * np.arange(1, 11))), rtol=1e-6
    )
    env = CapsuleEnv(disturbances=Disturbances(torque_resolution=0.07))
    torques = np.array([info["torque"] for info in run(env, swing(100), seed=0)[1:]])
    np.testing.assert_allclose(torques / 0.07, np.round(torques / 0.07), atol=1e-9)


def test_a_push_changes_the_momentum_by_its_impulse():
    smooth = Randomization(M=(0.5, 0.5), mu=(0.0, 0.0))
    env = CapsuleEnv(disturbances=Disturbances(push=0.4), randomization=smooth, physics_dt=5e-4)
    momenta = []
    for info in run(env, np.zeros((501, 1, 1), np.float32), seed=0):
        theta, theta_dot, _, x_dot = info["state"]
        momenta.append(
            (0.5 + NOMINAL.m) * x_dot - NOMINAL.m * NOMINAL.l * math.cos(theta) * theta_dot
        )
    per_second = np.diff(momenta[::50])
    assert len(per_second) == 10 and np.abs(per_second).max() <= 0.4 * 0.1 + 1e-9
    steps = np.diff(momenta)
    # A push lasts 0.1 s of every second. At 20 ms a step, at most six steps contain a part of it.
    for second in range(10):
        assert 5 <= np.count_nonzero(np.abs(steps[50 * second : 50 * second + 50]) > 1e-9) <= 6
    assert len(set(np.round(per_second, 9))) == 10


@pytest.mark.parametrize(("push", "moves"), [(0.5, False), (2.0, True)])
def test_static_friction_balances_a_push_below_the_threshold_only(push, moves):
    env = CapsuleEnv(
        disturbances=Disturbances(push=push),
        randomization=Randomization(M=(0.5, 0.5), mu=(0.1, 0.1)),
    )
    # Without a torque, the upright pendulum does not fall: the platform stands still until it is
    # pushed.
    infos = run(env, np.zeros((150, 1, 1), np.float32), options={"state": [0.0] * 4}, seed=3)
    assert any(info["state"][3] != 0.0 for info in infos) == moves
