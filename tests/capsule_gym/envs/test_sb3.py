import sys
from types import ModuleType

import gymnasium as gym
import numpy as np
import pytest
import torch
from numpy.testing import assert_array_equal
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecNormalize, VecVideoRecorder

from capsule_gym import CapsuleVectorEnv
from capsule_gym.core.layout import Row
from capsule_gym.sb3 import AsymmetricPolicy, CapsuleSB3VecEnv, FixedScale
from tests.capsule_gym.envs.actions import random_actions


def pair(n, privileged=False, **kwargs):
    """The batch for SB3 and the native one."""
    ours = CapsuleSB3VecEnv(n, seed=4, privileged=privileged, **kwargs)
    return ours, CapsuleVectorEnv(n, autoreset_mode="SAME_STEP", **kwargs)


@pytest.mark.parametrize(
    "kwargs", [{"controller": "baselines:adaptive", "residual_limit": 3.0}, {"task": "goal"}]
)
def test_sb3_batch_is_the_native_batch_with_terminal_observations(kwargs):
    ours, native = pair(6, max_episode_steps=11, **kwargs)
    first, _ = native.reset(seed=4)
    assert ours.reset().tobytes() == first.tobytes()
    seen = set()
    total_cost = 0.0
    returns = np.zeros(6)
    lengths = np.zeros(6, int)
    for actions in random_actions(0, 300, 6):
        observations, rewards, dones, infos = ours.step(actions)
        expected, native_rewards, terminated, truncated, info = native.step(actions)
        assert observations.tobytes() == expected.tobytes()
        assert_array_equal(rewards, native_rewards.astype(np.float32))
        assert_array_equal(dones, terminated | truncated)
        assert [len(each) > 1 for each in infos] == dones.tolist()
        costs = np.where(dones, info.get("final_info", info)["cost"], info["cost"])
        assert [each["cost"] for each in infos] == costs.tolist()
        total_cost += costs.sum()
        returns += native_rewards
        lengths += 1
        for i in np.flatnonzero(dones):
            last = infos[i]["terminal_observation"]
            assert last.tobytes() == info["final_obs"][i].tobytes()
            assert not np.array_equal(last, observations[i])
            assert infos[i]["TimeLimit.truncated"] == (truncated[i] and not terminated[i])
            assert infos[i]["episode"] == {"r": pytest.approx(returns[i]), "l": lengths[i]}
            metrics = info["final_info"]["metrics"]
            own = {name: metrics[name][i] for name in metrics if name[0] != "_"}
            assert infos[i]["metrics"] == own
            seen.add((bool(terminated[i]), bool(truncated[i])))
        returns[dones] = 0.0
        lengths[dones] = 0
    # Both kinds of end occurred, failures and time limits, also in one step.
    assert seen == {(True, False), (False, True), (True, True)}
    assert 0.0 < total_cost < 6 * 300


def test_episodes_go_on_with_the_random_numbers_of_the_seed():
    env = CapsuleSB3VecEnv(6, seed=4, max_episode_steps=11)
    masses = set()
    for _ in range(2):
        env.reset()
        env.step(np.ones((6, 1)))
        masses.add(env.batch.simulation.row(Row.M)[0])
    assert len(masses) == 2


def test_a_new_seed_restarts_the_random_numbers():
    ours, native = pair(6)
    ours.reset()
    ours.seed(4)
    first, _ = native.reset(seed=4)
    assert ours.reset().tobytes() == first.tobytes()


def test_images_without_a_render_mode():
    env = CapsuleSB3VecEnv(6)
    env.reset()
    with pytest.warns(UserWarning, match="draws nothing without a render_mode"):
        assert env.get_images() == [None] * 6


def test_interface_of_the_vec_env():
    env = CapsuleSB3VecEnv(3, controller="baselines:adaptive", render_mode="rgb_array")
    env.seed(3)
    env.reset()
    assert env.get_attr("max_episode_steps") == [1650] * 3
    assert env.get_attr("render_mode", [0]) == ["rgb_array"]
    assert env.env_is_wrapped(gym.Wrapper) == [False] * 3
    assert env.env_is_wrapped(Monitor, [0, 2]) == [True] * 2
    with pytest.raises(AttributeError, match="share their settings"):
        env.set_attr("render_mode", None)
    with pytest.raises(AttributeError, match="attribute `batch`"):
        env.env_method("episode_metrics")
    assert [image.shape[2] for image in env.get_images()] == [3, 3, 3]
    env.close()
    assert env.batch.closed


@pytest.mark.parametrize(("control_dt", "fps"), [(0.02, 50), (0.01, 100), (0.04, 25)])
def test_a_video_runs_in_real_time(control_dt, fps, tmp_path, monkeypatch):
    # Writes videos, which this test does not.
    monkeypatch.setitem(sys.modules, "moviepy", ModuleType("moviepy"))
    env = CapsuleSB3VecEnv(1, render_mode="rgb_array", control_dt=control_dt)
    recorder = VecVideoRecorder(env, str(tmp_path), lambda step: False)
    assert recorder.frames_per_sec == fps


def test_options_of_the_next_reset_reach_each_environment_and_only_that_reset():
    env = CapsuleSB3VecEnv(2, seed=0)
    options = [{"M": 0.6, "state": [0.1, 0.0, 0.0, 0.0]}, {"M": 0.7, "state": [0.2, 0.0, 0.0, 0.0]}]
    env.set_options(options)
    observations = env.reset()
    assert env.batch.simulation.row(Row.M).tolist() == [0.6, 0.7]
    assert observations[:, 0].tolist() == pytest.approx([0.1, 0.2])
    env.reset()
    assert (env.batch.simulation.row(Row.M) <= 0.55).all()


def test_options_have_the_same_keys_for_every_environment():
    env = CapsuleSB3VecEnv(2)
    env.set_options([{"M": 0.6}, {}])
    with pytest.raises(ValueError, match="same keys"):
        env.reset()


def privileged_columns(info, disturbed):
    """What a critic observes, from an info of the native batch."""
    columns = [info["M"], np.log(info["mu"])]
    if disturbed:
        columns += [info["capsule"][name] for name in "mlkc"]
        names = ("theta_bias", "theta_dot_bias", "x_dot_bias", "latency")
        columns += [info["disturbances"][name] for name in names]
        columns += list(info["state"].T[[0, 1, 3]])
    return np.array(columns, np.float32).T


@pytest.mark.parametrize(
    ("kwargs", "entries"),
    [
        ({"randomization": "wide"}, 2),
        ({"disturbances": "real", "randomization": "real-wide"}, 2 + 4 + 4 + 3),
    ],
)
def test_a_privileged_critic_observes_the_plant_and_the_true_state(kwargs, entries):
    ours, native = pair(70, privileged=True, max_episode_steps=10, **kwargs)
    disturbed = "disturbances" in kwargs
    space = gym.spaces.Box(-np.inf, np.inf, (entries,), np.float32)
    assert ours.observation_space["critic"] == space

    def check(found, observations, info, rows):
        assert found["policy"].tobytes() == observations.tobytes()
        assert found["critic"].dtype == np.float32
        assert_array_equal(found["critic"], privileged_columns(info, disturbed)[rows])

    every = np.arange(70)
    check(ours.reset(), *native.reset(seed=4), every)
    for actions in random_actions(0, 25, 70):
        found, _, dones, infos = ours.step(actions)
        observations, _, _, _, info = native.step(actions)
        check(found, observations, info, every)
        for i in np.flatnonzero(dones):
            check(infos[i]["terminal_observation"], info["final_obs"][i], info["final_info"], i)


def test_fixed_scales_multiply_observations():
    factors = np.array([0.5, 1.0, 2.0, 3.0, 4.0])
    env = VecNormalize(CapsuleSB3VecEnv(2, seed=0), clip_obs=100.0)
    env.obs_rms = FixedScale(factors)
    env.reset()
    observation = np.array([1.0, -1.0, 0.5, 1.0, 10.0])
    assert env.normalize_obs(observation) == pytest.approx(factors * observation)


def test_the_actor_ignores_what_only_the_critic_observes(tmp_path):
    env = CapsuleSB3VecEnv(4, seed=0, privileged=True, max_episode_steps=20, randomization="wide")
    model = PPO(AsymmetricPolicy, env, n_steps=16, batch_size=32, seed=0, device="cpu")
    before = [parameter.clone() for parameter in model.policy.parameters()]
    model.learn(128)
    for old, new in zip(before, model.policy.parameters(), strict=True):
        assert not torch.equal(old, new)
    model.save(tmp_path / "model.zip")
    model = PPO.load(tmp_path / "model.zip", device="cpu")
    actions = []
    values = []
    observations = env.reset()
    for change in (0.0, 1.0):
        seen = {**observations, "critic": observations["critic"] + np.float32(change)}
        action, _ = model.predict(seen, deterministic=True)
        actions.append(action)
        tensors, _ = model.policy.obs_to_tensor(seen)
        values.append(model.policy.predict_values(tensors))
    assert_array_equal(*actions)
    assert (values[0] != values[1]).all()
