import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env as check_sb3

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, Disturbances
from capsule_gym.sb3 import CapsuleSB3VecEnv

GOAL = {"task": "goal", "goal_env": True, "energy_weight": 0.5}
LAW = {"controller": "baselines:goal_pulses", "residual_limit": 0.2}


@pytest.mark.parametrize(
    "kwargs", [{}, LAW, {"stack_size": 2, "observe_parameters": True}], ids=str
)
def test_the_checkers_accept_it(kwargs):
    env = gym.make("capsule_gym:CapsuleGoal-v0", goal_env=True, **kwargs).unwrapped
    check_env(env, skip_render_check=True)
    check_sb3(env)


@pytest.mark.parametrize("kwargs", [{}, LAW], ids=["direct", "law"])
def test_it_is_the_same_environment_with_other_observations(kwargs):
    env, other = CapsuleEnv(**GOAL, **kwargs), CapsuleEnv(**{**GOAL, **kwargs, "goal_env": False})
    batch = CapsuleVectorEnv(3, **GOAL, **kwargs, autoreset_mode="SAME_STEP", max_episode_steps=60)
    (seen, info), (plain, _) = env.reset(seed=5), other.reset(seed=5)
    batched, infos = batch.reset(seed=4)
    rng, ends = np.random.default_rng(0), set()
    for n in range(60):
        assert env.observation_space.contains(seen) and batch.observation_space.contains(batched)
        # Without the entries of the task, which know the goal.
        np.testing.assert_array_equal(seen["observation"], plain[:-3])
        np.testing.assert_array_equal(seen["achieved_goal"], info["state"][2:])
        np.testing.assert_array_equal(seen["desired_goal"], [info["goal"], 0.0])
        for name, part in seen.items():
            np.testing.assert_array_equal(batched[name][1], part)
        action = rng.uniform(-1.0, 1.0, 1).astype(np.float32)
        if n == 30:
            env, batch = pickle.loads(pickle.dumps(env)), copy.deepcopy(batch)
        seen, reward, terminated, _, info = env.step(action)
        plain, expected, *_ = other.step(action)
        batched, rewards, terminations, truncations, infos = batch.step(
            np.array([[1.0], action, [-1.0]], np.float32)
        )
        assert reward == expected == rewards[1]
        assert env.compute_reward(seen["achieved_goal"], seen["desired_goal"], info) == reward
        for i in np.flatnonzero(terminations | truncations):
            ends.add(bool(terminations[i]))
            final = infos["final_obs"][i]
            own = {
                name: infos["final_info"][name][i]
                for name in ("reward_energy", "reward_termination")
            }
            assert (
                batch.compute_reward(final["achieved_goal"], final["desired_goal"], own)
                == rewards[i]
            )
            if i == 1:
                np.testing.assert_array_equal(final["achieved_goal"], seen["achieved_goal"])
        if terminated or terminations[1]:
            break
        if not terminations.any() and not truncations.any():
            found = batch.compute_reward(batched["achieved_goal"], batched["desired_goal"], infos)
            np.testing.assert_array_equal(found, rewards)
    assert True in ends or (kwargs and ends)
    # At the goal, in motion and at rest.
    assert env.compute_reward(
        [[0.1, 0.05], [0.1, 0.0]], [[0.1, 0.0]] * 2, [{}, {}]
    ) == pytest.approx([0.04, 0.1])
    assert not hasattr(CapsuleEnv(task="goal"), "compute_reward") and not hasattr(
        CapsuleVectorEnv(2), "compute_reward"
    )


def test_disturbed_goals_are_measured():
    env = CapsuleEnv(
        task="goal", goal_env=True, disturbances=Disturbances(x_dot_bias=0.05, stick_threshold=0.06)
    )
    seen, info = env.reset(seed=0, options={"state": [0.0] * 4, "mu": 0.4})
    for _ in range(20):
        np.testing.assert_array_equal(seen["achieved_goal"], info["reading"][2:])
        seen, _, _, _, info = env.step(np.zeros(1, np.float32))
    assert (
        seen["achieved_goal"] == pytest.approx([0.02, 0.05])
        and seen["desired_goal"][0] == info["goal"]
    )
    # A measured rest counts as one.
    at_rest = env.compute_reward(seen["achieved_goal"], seen["achieved_goal"] - [0.0, 0.05], {})
    assert at_rest == pytest.approx(0.02 * 5.0)


def test_hindsight_replay_takes_the_native_batch():
    env = CapsuleSB3VecEnv(4, seed=0, max_episode_steps=40, **GOAL)
    returns, seen = np.zeros(4), env.reset()
    for _ in range(40):
        before = seen
        seen, rewards, dones, infos = env.step(np.full((4, 1), 0.05, np.float32))
        returns += rewards
        last = {name: part.copy() for name, part in seen.items()}
        for i in np.flatnonzero(dones):
            for name, part in infos[i]["terminal_observation"].items():
                last[name][i] = part
        goals = last["achieved_goal"], last["desired_goal"], infos
        (found,) = env.env_method("compute_reward", *goals, indices=[0])
        np.testing.assert_allclose(found, rewards, rtol=1e-6)
        np.testing.assert_array_equal(last["desired_goal"], before["desired_goal"])
    assert dones.all() and [info["episode"]["l"] for info in infos] == [40] * 4
    buffer = {
        "replay_buffer_class": HerReplayBuffer,
        "replay_buffer_kwargs": {"copy_info_dict": True},
    }
    model = SAC(
        "MultiInputPolicy", env, learning_starts=160, batch_size=16, device="cpu", seed=0, **buffer
    )
    model.learn(176)
    assert model.replay_buffer.sample(64).rewards.shape == (64, 1)
