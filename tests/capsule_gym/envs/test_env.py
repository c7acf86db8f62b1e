import dataclasses
import math
import multiprocessing
import warnings
from functools import partial, reduce

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_sb3

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, Disturbances, Randomization
from capsule_gym.core.layout import Row
from capsule_gym.parameters import NOMINAL
from capsule_gym.tasks.registry import TASKS, find_task
from capsule_gym.tasks.task import ENV_ID, METRICS, Termination
from tests.capsule_gym.fakes import flatten, layout

VARIANTS = [
    {},
    {"controller": "baselines:adaptive", "residual_limit": 3.0, "observe_parameters": True},
    {"observe_parameters": True, "randomization": "wide", "initial_noise": 0.05},
    {"controller": "baselines:adaptive", "residual_limit": 1.0, "total_torque": True},
    {
        "controller": "baselines:gait_predictive",
        "disturbances": "real",
        "randomization": "real-wide",
    },
    *({"task": name} for name in TASKS if name != "speed"),
]


@pytest.mark.parametrize("kwargs", VARIANTS)
def test_the_checkers_are_silent_and_every_info_has_the_form_of_the_first(kwargs, no_screen):
    task = find_task(kwargs.get("task", "speed"))
    env_id, steps = task.env_id, task.episode_steps
    assert gym.spec(env_id).max_episode_steps == task.episode_steps == steps
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(env_id, **kwargs).unwrapped
        check_env(env)
        check_sb3(gym.make(env_id, **kwargs))
    assert (
        steps * env.simulation.options.control_dt
        == {"speed": 33.0, "goal": 15.0, "velocity": 20.0}[task.name]
    )
    space, seen, ended, costs = env.observation_space, [], 0, set()
    expected = layout(env.reset(seed=0)[1])
    assert all(
        np.issubdtype(dtype, np.number) or dtype == np.bool_ for _, dtype, _ in flatten(expected)
    )
    assert (expected["state"][1:], expected["termination"][1:]) == (
        (np.float64, (4,)),
        (np.int64, ()),
    )
    assert {*task.reward_terms, *dict(task.places)} <= set(expected)
    # Full torque in long stretches reaches the extremes of the state space.
    signs = np.sign(np.random.default_rng(0).uniform(-1.0, 1.0, 200))
    for action in np.repeat(signs, 5).astype(np.float32):
        observation, reward, terminated, _, info = env.step(action[None])
        assert space.contains(observation) and layout(info) == expected
        assert reward == reduce(float.__add__, (info[term] for term in task.reward_terms))
        assert info["reward_termination"] == (
            -env.simulation.options.termination_penalty if terminated else 0.0
        )
        options = {**dataclasses.asdict(env.simulation.capsule), **info.get("capsule", {})}
        light = info["normal_force"] < 0.1 * (info["M"] + options["m"]) * options["g"]
        assert info["cost"] == float(terminated or light or abs(info["state"][0]) > 0.45 * math.pi)
        costs.add((info["cost"], terminated))
        seen.append(observation)
        if terminated:
            ended += 1
            env.reset()
    assert ended > 0 and expected["cost"] and costs == {(0.0, False), (1.0, False), (1.0, True)}
    # Clipping would show as values exactly on the bounds of the rates.
    largest = np.abs(np.array(seen)).max(axis=0)
    assert largest[1] < space.high[1] and largest[2] < space.high[2]
    metrics = env.episode_metrics(None)
    assert set(metrics) >= set(METRICS) and not np.isnan([*metrics.values()]).any()


@pytest.mark.parametrize(
    "kwargs",
    [
        {"randomization": Randomization(M=(0.3, 9.0), mu=(0.001, 3.0))},
        {"capsule": Capsule(M=0.1, mu=0.7)},
    ],
)
def test_every_plant_that_can_occur_lies_in_the_observation_space(kwargs):
    env = CapsuleEnv(observe_parameters=True, **kwargs)
    space, none = env.observation_space, np.zeros(1, np.float32)
    largest = [9.0, 3.0] if "randomization" in kwargs else [0.55, 1.0]
    assert np.isfinite(space.high).all() and space.high[-2:] == pytest.approx(largest, rel=1e-5)
    assert (space.high[-2:] >= largest).all()
    for seed in range(10):
        observation, info = env.reset(seed=seed)
        assert space.contains(observation)
        np.testing.assert_allclose(observation[-2:], [info["M"], info["mu"]], rtol=1e-6)
    # A reset accepts values up to the bounds of the space, and no larger ones.
    M, mu = space.high[-2:].tolist()
    observation, _ = env.reset(options={"M": M * (1.0 - 1e-6), "mu": min(mu * (1.0 - 1e-6), 1.0)})
    assert space.contains(observation) and space.contains(env.step(none)[0])
    for beyond, message in (
        ({"M": 1.01 * M}, "M must be at most"),
        ({"M": M, "mu": 1.01 * mu}, "mu must be at most"),
    ):
        for options in (beyond, {"changes": [{"t": 1.0, "M": 0.5, "mu": 0.0, **beyond}]}):
            with pytest.raises(ValueError, match=message):
                env.reset(options=options)


def test_rewards_are_progress_and_the_integral_of_power_not_its_sample():
    kwargs = {"physics_dt": 1e-3, "randomization": "none", "energy_weight": 0.5}
    coarse, fine = (CapsuleEnv(control_dt=dt, **kwargs) for dt in (0.02, 0.001))
    _, before = coarse.reset(seed=0)
    fine.reset(seed=0)
    total = riemann = 0.0
    for n in range(40):
        action = np.array([0.6 * np.sin(0.3 * n)], np.float32)
        now = coarse.step(action)[4]
        assert now["reward_progress"] == pytest.approx(
            100.0 * (now["state"][2] - before["state"][2]), abs=1e-12
        )
        assert now["reward_energy"] == -0.5 * now["energy"]
        total, before = total + now["energy"], now
        for _ in range(20):
            _, _, _, _, info = fine.step(action)
            riemann += abs(info["torque"] * info["state"][1]) * 1e-3
    assert total == pytest.approx(riemann, rel=0.01)
    square = coarse.episode_metrics(None)["rms_torque"] ** 2
    assert square == pytest.approx(np.mean((0.9 * np.sin(0.3 * np.arange(40))) ** 2))
    # The sum over the finer environment is the same integral.
    assert fine.episode_metrics(None)["energy"] == pytest.approx(total, rel=1e-5)


UPRIGHT = math.nextafter(math.pi / 2, 0.0)
# At this rate, the centripetal force of the upright ball carries the whole weight.
LIFTING = math.sqrt((NOMINAL.M + NOMINAL.m) * NOMINAL.g / (NOMINAL.m * NOMINAL.l))
# Within 1 ns the angle reaches the limit itself.
ENDS = [
    (sign * UPRIGHT, sign * rate, end)
    for sign in (1, -1)
    for rate, end in ((0.0, "none"), (2e-7, "pendulum"))
]
ENDS += [(0.0, 0.9999 * LIFTING, "none"), (0.0, 1.0001 * LIFTING, "contact")]


@pytest.mark.parametrize(("theta", "theta_dot", "ends"), ENDS)
def test_termination_is_at_the_limit_itself(theta, theta_dot, ends):
    env = CapsuleEnv(randomization="none", control_dt=1e-9, physics_dt=1e-9)
    env.reset(seed=0, options={"state": [theta, theta_dot, 0.0, math.copysign(0.1, theta)]})
    _, _, terminated, truncated, info = env.step(np.zeros(1, np.float32))
    ends = Termination[ends]
    assert info["termination"] == ends and not truncated
    assert terminated == (ends != Termination.none) == env.episode_metrics(None)["failed"]
    assert (info["normal_force"] == 0.0) == (ends == Termination.contact)
    assert env.episode_metrics(None)["backward_ratio"] == (math.inf if theta < 0.0 else 0.0)
    assert math.isinf(env.episode_metrics(None)["cost_of_transport"]) == (theta < 0.0)
    if terminated:
        with pytest.raises(gym.error.ResetNeeded):
            env.step(np.zeros(1, np.float32))


def test_a_plant_that_the_step_does_not_resolve_ends_as_diverged():
    # A ball of 1 mg: a torque of 1 N m turns it thousands of times within a substep.
    env = CapsuleEnv(capsule=Capsule(m=1e-6, k=0.0, c=0.0), randomization="none")
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(np.ones(1, np.float32))
    assert terminated and info["termination"] == Termination.diverged
    # The diverged substep changes nothing.
    assert info["state"].tolist() == [-np.pi / 3, 0.0, 0.0, 0.0]
    assert reward == info["reward_termination"] == -10.0 and info["energy"] == 0.0
    metrics = env.episode_metrics(None)
    assert metrics["failed"] == 1.0 and metrics["duration"] == 0.0
    assert all(np.isfinite(value) for name, value in metrics.items() if name != "cost_of_transport")
    assert not env.reset()[1]["termination"]


@pytest.mark.parametrize("make", [gym.make, partial(gym.make_vec, num_envs=2)])
def test_a_spec_comes_back_from_json(make):
    ranges = Randomization(mu=(0.1, 0.2), l=(0.2, 0.3), log_mu=True)
    noisy = Disturbances(latency=(0.005, 0.015), unmeasured=("x_dot",))
    env = make(
        ENV_ID,
        capsule=Capsule(M=0.7),
        randomization=ranges,
        disturbances=noisy,
        initial_range=(0.1, 0.2),
    )
    again = make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.simulation.options == env.unwrapped.simulation.options
    assert again.reset(seed=3)[0].tobytes() == env.reset(seed=3)[0].tobytes()


@pytest.mark.parametrize(
    ("control_dt", "fps"), [(0.02, 50), (0.03, 1 / 0.03), (2.5, 0.4), (1e3, 0.01), (1e-6, 1e3)]
)
def test_the_frame_rate_is_real_time_where_a_video_can_have_it(control_dt, fps):
    for kind in (CapsuleEnv, CapsuleVectorEnv):
        env = kind(control_dt=control_dt, physics_dt=control_dt / (1e6 if control_dt > 1.0 else 20))
        assert (
            env.metadata["render_fps"] == pytest.approx(fps) and kind.metadata["render_fps"] == 50
        )
    assert env.num_envs == 1


def test_an_episode_is_truncated_after_33_seconds_and_its_metrics_follow_their_definitions():
    env = gym.make(ENV_ID, randomization="none", controller="baselines:adaptive")
    env.reset(seed=0, options={"state": (-0.5, 0.0, 0.25, 0.0)})
    x, torques, energy = [0.25], [], 0.0
    for n in range(1650):
        _, _, terminated, truncated, info = env.step(np.zeros(1, np.float32))
        assert not terminated and truncated == (n == 1649)
        x.append(info["state"][2])
        torques.append(abs(info["torque"]))
        energy += info["energy"]
    metrics, distance = env.unwrapped.episode_metrics(1650), x[-1] - x[0]
    assert metrics["duration"] == pytest.approx(33.0) and metrics["failed"] == 0.0
    assert metrics["mean_speed"] == pytest.approx(100.0 * distance / 33.0)
    assert metrics["energy"] == pytest.approx(energy)
    assert metrics["cost_of_transport"] == pytest.approx(energy / (0.638 * 9.81 * distance))
    assert metrics["peak_torque"] >= max(torques)
    backward = np.clip(-np.diff(x), 0.0, None).sum() / np.clip(np.diff(x), 0.0, None).sum()
    assert metrics["backward_ratio"] == pytest.approx(backward, abs=0.01)
    assert 0.5 < metrics["stuck_fraction"] < 1.0


def test_the_torque_is_the_law_plus_the_action_or_the_action_within_the_residual_limit():
    law = {"controller": "baselines:adaptive", "control_dt": 0.001}
    residual, kwargs = CapsuleEnv(**law, residual_limit=1.0), {**law, "total_torque": True}
    near, free = CapsuleEnv(**kwargs, residual_limit=1.0), CapsuleEnv(**kwargs, residual_limit=3.0)
    direct = CapsuleEnv(control_dt=0.001, physics_dt=0.001)
    for env in (residual, near, free, direct):
        env.reset(seed=4)
    bounded = 0
    for action in np.random.default_rng(0).uniform(-0.3, 0.3, (200, 1)).astype(np.float32):
        law_torque, (_, _, _, _, info) = near.simulation.row(Row.law_torque)[0], near.step(action)
        wanted = 1.5 * float(action[0])
        assert info["torque"] == pytest.approx(
            np.clip(wanted, law_torque - 1.0, law_torque + 1.0), abs=1e-15
        )
        bounded += info["torque"] != pytest.approx(wanted)
        wide, law_torque = 5.0 * action, residual.simulation.row(Row.law_torque)[0]
        info = residual.step(wide)[4]
        assert info["torque"] == np.clip(law_torque + np.clip(float(wide[0]), -1.0, 1.0), -1.5, 1.5)
        # Without a binding limit the law has no effect.
        (one, *_), (other, *_) = free.step(action), direct.step(action)
        np.testing.assert_allclose(one[:5], other[:5], rtol=0.0, atol=1e-6)
    assert 50 < bounded < 200


def test_observation_entries():
    env = gym.make(
        ENV_ID, controller="baselines:adaptive", observe_parameters=True, residual_limit=1.0
    )
    env.reset(seed=0)
    bounds = [np.pi / 2, 20.0, 2.0, 1.0, 1.0, np.pi / 2, 20.0, 1.0, 1.0, 1.5, 2.0, 1.0]
    assert env.observation_space.high.tolist() == np.float32(bounds).tolist()
    table = env.unwrapped.simulation.reference
    for n in range(1, 400):
        observation, _, _, _, info = env.step(np.array([0.125], np.float32))
        theta, theta_dot, _, x_dot = info["state"]
        row = (20 * n) % len(table)
        phase = 2.0 * np.pi * row / len(table)
        expected = [
            theta,
            theta_dot,
            x_dot,
            float(x_dot == 0.0),
            0.125,
            *table[row, :2],
            np.sin(phase),
            np.cos(phase),
        ]
        expected += [info["law_torque"], info["M"], info["mu"]]
        np.testing.assert_allclose(observation, expected, rtol=1e-6, atol=1e-6)
        assert info["stick"] == observation[3]


def first_mass():
    return gym.make("capsule_gym:CapsuleStickSlip-v0").reset(seed=4)[1]["M"]


def test_spawned_workers_know_the_environment():
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply_async(first_mass).get(timeout=60) == first_mass()
