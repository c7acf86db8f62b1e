import math
import multiprocessing
from dataclasses import asdict
from functools import partial, reduce

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_allclose
from stable_baselines3.common.env_checker import check_env as check_sb3

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, Disturbances, Randomization
from capsule_gym.core.layout import Row
from capsule_gym.parameters import NOMINAL
from capsule_gym.tasks.registry import TASKS
from capsule_gym.tasks.task import ENV_ID, METRICS, Termination
from tests.capsule_gym.fakes import flatten, layout

ADAPTIVE = {"controller": "baselines:adaptive"}
IDLE = np.zeros(1, np.float32)
# Full torque in long stretches reaches the extremes of the state space.
EXTREMES = np.repeat(np.sign(np.random.default_rng(0).uniform(-1.0, 1.0, 200)), 5)


@pytest.fixture(
    params=[
        {},
        {**ADAPTIVE, "residual_limit": 3.0, "observe_parameters": True},
        {"observe_parameters": True, "randomization": "wide", "initial_noise": 0.05},
        {**ADAPTIVE, "residual_limit": 1.0, "total_torque": True},
        {
            "controller": "baselines:gait_predictive",
            "disturbances": "real",
            "randomization": "real-wide",
        },
        *({"task": name} for name in TASKS if name != "speed"),
    ]
)
def made(request):
    """An environment of every kind, with the wrappers of its id."""
    task = request.param.get("task", "speed")
    return gym.make(TASKS[task].env_id, **request.param)


def extreme_steps(env):
    """Yields the results of steps with full torque, also after the ends of episodes."""
    env.reset(seed=0)
    for action in EXTREMES.astype(np.float32):
        observation, reward, terminated, _, info = env.step(action[None])
        yield observation, reward, terminated, info
        if terminated:
            env.reset()


def test_the_checkers_are_silent(made, no_screen):
    check_env(made.unwrapped)
    check_sb3(made)


@pytest.mark.parametrize("task", TASKS)
def test_the_time_limit_of_a_task(task):
    seconds = {"speed": 33.0, "goal": 15.0, "velocity": 20.0}[task]
    env = gym.make(TASKS[task].env_id)
    steps = TASKS[task].episode_steps
    assert env.spec.max_episode_steps == steps
    assert steps * env.unwrapped.simulation.options.control_dt == seconds


def test_every_info_has_the_form_of_the_first(made):
    env = made.unwrapped
    _, info = env.reset(seed=0)
    expected = layout(info)
    for _, dtype, _ in flatten(expected):
        assert np.issubdtype(dtype, np.number) or dtype == np.bool_
    assert expected["state"][1:] == (np.float64, (4,))
    assert expected["termination"][1:] == (np.int64, ())
    assert "cost" in expected
    task = env.simulation.task
    assert {*task.reward_terms, *dict(task.places)} <= set(expected)
    for _, _, _, info in extreme_steps(env):
        assert layout(info) == expected


def test_observations_lie_in_their_space(made):
    space = made.observation_space
    seen = []
    for observation, *_ in extreme_steps(made.unwrapped):
        assert space.contains(observation)
        seen.append(observation)
    # Clipping would show as values exactly on the bounds of the rates theta_dot and x_dot.
    assert (np.abs(seen).max(axis=0) < space.high)[1:3].all()


def test_the_reward_is_the_sum_of_its_terms(made):
    env = made.unwrapped
    terms = env.simulation.task.reward_terms
    ends = 0
    for _, reward, terminated, info in extreme_steps(env):
        assert reward == reduce(float.__add__, (info[term] for term in terms))
        penalty = env.simulation.options.termination_penalty if terminated else 0.0
        assert info["reward_termination"] == -penalty
        ends += terminated
    assert ends > 0
    metrics = env.episode_metrics(None)
    assert set(metrics) >= set(METRICS)
    assert not np.isnan(list(metrics.values())).any()


def test_a_step_costs_where_it_ends_an_episode_or_comes_close(made):
    env = made.unwrapped
    capsule = asdict(env.simulation.capsule)
    costs = set()
    for _, _, terminated, info in extreme_steps(env):
        drawn = info.get("capsule", capsule)
        light = info["normal_force"] < 0.1 * (info["M"] + drawn["m"]) * drawn["g"]
        low = abs(info["state"][0]) > 0.45 * math.pi
        assert info["cost"] == float(terminated or light or low)
        costs.add((info["cost"], terminated))
    assert costs == {(0.0, False), (1.0, False), (1.0, True)}


LIGHT = Capsule(M=0.1, mu=0.7)
PLANTS = pytest.mark.parametrize(
    ("kwargs", "largest"),
    [
        ({"randomization": Randomization(M=(0.3, 9.0), mu=(0.001, 3.0))}, [9.0, 3.0]),
        ({"capsule": LIGHT, "randomization": Randomization(M=(0.1, 0.55))}, [0.55, 1.0]),
    ],
)


@PLANTS
def test_every_drawn_plant_lies_in_the_observation_space(kwargs, largest):
    env = CapsuleEnv(observe_parameters=True, **kwargs)
    high = env.observation_space.high
    assert np.isfinite(high).all()
    assert high[-2:] == pytest.approx(largest, rel=1e-5)
    assert (high[-2:] >= largest).all()
    for seed in range(10):
        observation, info = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        assert_allclose(observation[-2:], [info["M"], info["mu"]], rtol=1e-6)


@PLANTS
def test_a_reset_accepts_plants_up_to_the_bounds_of_the_space(kwargs, largest):
    env = CapsuleEnv(observe_parameters=True, **kwargs)
    M, mu = env.observation_space.high[-2:].tolist()
    inside = {"M": M * (1.0 - 1e-6), "mu": min(mu * (1.0 - 1e-6), 1.0)}
    observation, _ = env.reset(options=inside)
    assert env.observation_space.contains(observation)
    observation, *_ = env.step(IDLE)
    assert env.observation_space.contains(observation)
    heavy = {"M": 1.01 * M}
    rough = {"M": M, "mu": 1.01 * mu}
    for beyond, message in ((heavy, "M must be at most"), (rough, "mu must be at most")):
        change = {"t": 1.0, "M": 0.5, "mu": 0.0, **beyond}
        for options in (beyond, {"changes": [change]}):
            with pytest.raises(ValueError, match=message):
                env.reset(options=options)


def test_rewards_are_progress_and_the_integral_of_power_not_its_sample():
    make = partial(CapsuleEnv, physics_dt=1e-3, randomization="none", energy_weight=0.5)
    coarse = make(control_dt=0.02)
    fine = make(control_dt=0.001)
    fine.reset(seed=0)
    _, info = coarse.reset(seed=0)
    energy = 0.0
    riemann = 0.0
    for n in range(40):
        action = np.array([0.6 * np.sin(0.3 * n)], np.float32)
        x = info["state"][2]
        *_, info = coarse.step(action)
        progress = 100.0 * (info["state"][2] - x)
        assert info["reward_progress"] == pytest.approx(progress, abs=1e-12)
        assert info["reward_energy"] == -0.5 * info["energy"]
        energy += info["energy"]
        for _ in range(20):
            *_, sample = fine.step(action)
            riemann += abs(sample["torque"] * sample["state"][1]) * 1e-3
    assert energy == pytest.approx(riemann, rel=0.01)
    torques = 0.9 * np.sin(0.3 * np.arange(40))
    rms_torque = coarse.episode_metrics(None)["rms_torque"]
    assert rms_torque**2 == pytest.approx(np.mean(torques**2))
    # The sum over the finer environment is the same integral.
    assert fine.episode_metrics(None)["energy"] == pytest.approx(energy, rel=1e-5)


UPRIGHT = math.nextafter(math.pi / 2, 0.0)
# At this rate, the centripetal force of the upright ball carries the whole weight.
LIFTING = math.sqrt((NOMINAL.M + NOMINAL.m) * NOMINAL.g / (NOMINAL.m * NOMINAL.l))


@pytest.mark.parametrize(
    ("theta", "theta_dot", "ends"),
    [
        # Within 1 ns the angle reaches the limit itself.
        (UPRIGHT, 0.0, Termination.none),
        (UPRIGHT, 2e-7, Termination.pendulum),
        (-UPRIGHT, -0.0, Termination.none),
        (-UPRIGHT, -2e-7, Termination.pendulum),
        (0.0, 0.9999 * LIFTING, Termination.none),
        (0.0, 1.0001 * LIFTING, Termination.contact),
    ],
)
def test_termination_is_at_the_limit_itself(theta, theta_dot, ends):
    env = CapsuleEnv(randomization="none", control_dt=1e-9, physics_dt=1e-9)
    env.reset(seed=0, options={"state": [theta, theta_dot, 0.0, math.copysign(0.1, theta)]})
    _, _, terminated, truncated, info = env.step(IDLE)
    assert info["termination"] == ends
    assert not truncated
    assert terminated == (ends != Termination.none)
    assert (info["normal_force"] == 0.0) == (ends == Termination.contact)
    metrics = env.episode_metrics(None)
    assert metrics["failed"] == terminated
    assert metrics["backward_ratio"] == (math.inf if theta < 0.0 else 0.0)
    assert math.isinf(metrics["cost_of_transport"]) == (theta < 0.0)
    if terminated:
        with pytest.raises(gym.error.ResetNeeded):
            env.step(IDLE)


def test_a_plant_that_the_step_does_not_resolve_ends_as_diverged():
    # A ball of 1 mg: a torque of 1 N m turns it thousands of times within a substep.
    env = CapsuleEnv(capsule=Capsule(m=1e-6, k=0.0, c=0.0), randomization="none")
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(np.ones(1, np.float32))
    assert terminated
    assert info["termination"] == Termination.diverged
    # The diverged substep changes nothing.
    assert info["state"].tolist() == [-np.pi / 3, 0.0, 0.0, 0.0]
    assert reward == info["reward_termination"] == -10.0
    assert info["energy"] == 0.0
    metrics = env.episode_metrics(None)
    assert metrics["failed"] == 1.0
    assert metrics["duration"] == 0.0
    del metrics["cost_of_transport"]
    assert np.isfinite(list(metrics.values())).all()
    _, info = env.reset()
    assert not info["termination"]


@pytest.mark.parametrize("make", [gym.make, partial(gym.make_vec, num_envs=2)])
def test_a_spec_comes_back_from_json(make):
    env = make(
        ENV_ID,
        capsule=Capsule(M=0.7),
        randomization=Randomization(mu=(0.1, 0.2), l=(0.2, 0.3), log_mu=True),
        disturbances=Disturbances(latency=(0.005, 0.015), unmeasured=("x_dot",)),
        initial_range=(0.1, 0.2),
    )
    again = make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.simulation.options == env.unwrapped.simulation.options
    assert again.reset(seed=3)[0].tobytes() == env.reset(seed=3)[0].tobytes()


@pytest.mark.parametrize("kind", [CapsuleEnv, CapsuleVectorEnv])
@pytest.mark.parametrize(
    ("control_dt", "fps"), [(0.02, 50), (0.03, 1 / 0.03), (2.5, 0.4), (1e3, 0.01), (1e-6, 1e3)]
)
def test_the_frame_rate_is_real_time_where_a_video_can_have_it(kind, control_dt, fps):
    physics_dt = control_dt / (1e6 if control_dt > 1.0 else 20)
    env = kind(control_dt=control_dt, physics_dt=physics_dt)
    assert env.metadata["render_fps"] == pytest.approx(fps)
    assert kind.metadata["render_fps"] == 50


def test_a_batch_contains_one_environment_by_default():
    assert CapsuleVectorEnv().num_envs == 1


def test_an_episode_is_truncated_after_33_seconds():
    env = gym.make(ENV_ID, randomization="none", **ADAPTIVE)
    env.reset(seed=0)
    for n in range(1650):
        _, _, terminated, truncated, _ = env.step(IDLE)
        assert not terminated
        assert truncated == (n == 1649)
    assert env.unwrapped.episode_metrics(1650)["duration"] == pytest.approx(33.0)


def test_metrics_follow_their_definitions():
    env = CapsuleEnv(randomization="none", **ADAPTIVE)
    env.reset(seed=0, options={"state": (-0.5, 0.0, 0.25, 0.0)})
    infos = [env.step(IDLE)[4] for _ in range(1650)]
    x = np.array([0.25] + [info["state"][2] for info in infos])
    distance = x[-1] - x[0]
    energy = sum(info["energy"] for info in infos)
    metrics = env.episode_metrics(1650)
    assert metrics["failed"] == 0.0
    assert metrics["mean_speed"] == pytest.approx(100.0 * distance / 33.0)
    assert metrics["energy"] == pytest.approx(energy)
    assert metrics["cost_of_transport"] == pytest.approx(energy / (0.638 * 9.81 * distance))
    assert metrics["peak_torque"] >= max(abs(info["torque"]) for info in infos)
    moves = np.diff(x)
    backward = -moves[moves < 0.0].sum() / moves[moves > 0.0].sum()
    assert metrics["backward_ratio"] == pytest.approx(backward, abs=0.01)
    assert 0.5 < metrics["stuck_fraction"] < 1.0


# Whole torques, and those of a law, at the law's own step.
MILLISECOND = partial(CapsuleEnv, control_dt=0.001, **ADAPTIVE)
ACTIONS = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 1)).astype(np.float32)


def test_a_residual_is_added_to_the_torque_of_the_law():
    env = MILLISECOND(residual_limit=1.0)
    env.reset(seed=4)
    for action in 5.0 * ACTIONS:
        law_torque = env.simulation.row(Row.law_torque)[0]
        *_, info = env.step(action)
        residual = np.clip(float(action[0]), -1.0, 1.0)
        assert info["torque"] == np.clip(law_torque + residual, -1.5, 1.5)


def test_a_total_torque_is_kept_within_the_residual_limit_of_the_law():
    env = MILLISECOND(total_torque=True, residual_limit=1.0)
    env.reset(seed=4)
    bounded = 0
    for action in ACTIONS:
        law_torque = env.simulation.row(Row.law_torque)[0]
        *_, info = env.step(action)
        wanted = 1.5 * float(action[0])
        kept = np.clip(wanted, law_torque - 1.0, law_torque + 1.0)
        assert info["torque"] == pytest.approx(kept, abs=1e-15)
        bounded += info["torque"] != pytest.approx(wanted)
    assert 50 < bounded < 200


def test_without_a_binding_limit_the_law_has_no_effect_on_a_total_torque():
    env = MILLISECOND(total_torque=True, residual_limit=3.0)
    direct = CapsuleEnv(control_dt=0.001, physics_dt=0.001)
    env.reset(seed=4)
    direct.reset(seed=4)
    for action in ACTIONS:
        observation, *_ = env.step(action)
        expected, *_ = direct.step(action)
        assert_allclose(observation[:5], expected[:5], rtol=0.0, atol=1e-6)


def test_observation_entries():
    env = CapsuleEnv(observe_parameters=True, residual_limit=1.0, **ADAPTIVE)
    env.reset(seed=0)
    bounds = [np.pi / 2, 20.0, 2.0, 1.0, 1.0, np.pi / 2, 20.0, 1.0, 1.0, 1.5, 2.0, 1.0]
    assert env.observation_space.high.tolist() == np.float32(bounds).tolist()
    table = env.simulation.reference
    for n in range(1, 400):
        observation, _, _, _, info = env.step(np.array([0.125], np.float32))
        theta, theta_dot, _, x_dot = info["state"]
        row = (20 * n) % len(table)
        phase = 2.0 * np.pi * row / len(table)
        expected = [theta, theta_dot, x_dot, x_dot == 0.0, 0.125]
        expected += [*table[row, :2], np.sin(phase), np.cos(phase)]
        expected += [info["law_torque"], info["M"], info["mu"]]
        assert_allclose(observation, expected, rtol=1e-6, atol=1e-6)
        assert info["stick"] == observation[3]


@pytest.mark.parametrize("seed", [0, 2**128 - 1])
def test_the_smallest_and_the_largest_seed_give_the_same_plant_again(seed):
    env = CapsuleEnv()
    masses = [env.reset(seed=seed)[1]["M"] for _ in range(2)]
    assert masses[0] == masses[1]
    with pytest.raises(ValueError, match="seed must be an integer in"):
        env.reset(seed=2**128)


def first_mass():
    _, info = gym.make("capsule_gym:CapsuleStickSlip-v0").reset(seed=4)
    return info["M"]


def test_spawned_workers_know_the_environment():
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply_async(first_mass).get(timeout=60) == first_mass()
