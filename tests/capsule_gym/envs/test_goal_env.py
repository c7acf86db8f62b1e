import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_allclose, assert_array_equal
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env as check_sb3

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, Disturbances
from capsule_gym.sb3 import CapsuleSB3VecEnv
from tests.capsule_gym.envs.actions import random_actions

GOAL = {"task": "goal", "goal_env": True, "energy_weight": 0.5}
LAW = {"controller": "baselines:goal_pulses", "residual_limit": 0.2}


@pytest.mark.parametrize(
    "kwargs", [{}, LAW, {"stack_size": 2, "observe_parameters": True}], ids=str
)
def test_the_checkers_accept_it(kwargs):
    env = gym.make("capsule_gym:CapsuleGoal-v0", goal_env=True, **kwargs).unwrapped
    check_env(env, skip_render_check=True)
    check_sb3(env)


def reward_of(env, observation, info):
    return env.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)


BOTH = pytest.mark.parametrize("law", [{}, LAW], ids=["direct", "law"])


@BOTH
def test_it_is_the_same_environment_with_other_observations(law):
    env = CapsuleEnv(**GOAL, **law)
    plain = CapsuleEnv(task="goal", energy_weight=0.5, **law)
    seen, info = env.reset(seed=5)
    expected, _ = plain.reset(seed=5)
    for n, (action,) in enumerate(random_actions(0, 60, 1)):
        assert env.observation_space.contains(seen)
        # Without the entries of the task, which know the goal.
        assert_array_equal(seen["observation"], expected[:-3])
        assert_array_equal(seen["achieved_goal"], info["state"][2:])
        assert_array_equal(seen["desired_goal"], [info["goal"], 0.0])
        if n == 30:
            env = pickle.loads(pickle.dumps(env))
        seen, reward, terminated, _, info = env.step(action)
        expected, plain_reward, *_ = plain.step(action)
        assert reward == plain_reward
        assert reward == reward_of(env, seen, info)
        if terminated:
            break


@BOTH
def test_a_batch_has_the_same_observations(law):
    env = CapsuleEnv(**GOAL, **law)
    batch = CapsuleVectorEnv(3, **GOAL, **law, autoreset_mode="SAME_STEP", max_episode_steps=60)
    seen, _ = env.reset(seed=5)
    batched, _ = batch.reset(seed=4)
    ends = set()
    for n, (action,) in enumerate(random_actions(0, 60, 1)):
        assert batch.observation_space.contains(batched)
        for name, part in seen.items():
            assert_array_equal(batched[name][1], part)
        if n == 30:
            batch = copy.deepcopy(batch)
        seen, reward, terminated, _, _ = env.step(action)
        step = batch.step(np.array([[1.0], action, [-1.0]], np.float32))
        batched, rewards, terminations, truncations, infos = step
        assert rewards[1] == reward
        ended = terminations | truncations
        for i in np.flatnonzero(ended):
            ends.add(bool(terminations[i]))
            last = infos["final_obs"][i]
            names = ("reward_energy", "reward_termination")
            terms = {name: infos["final_info"][name][i] for name in names}
            assert reward_of(batch, last, terms) == rewards[i]
        if ended[1]:
            assert_array_equal(infos["final_obs"][1]["achieved_goal"], seen["achieved_goal"])
        if terminated:
            break
        if not ended.any():
            assert_array_equal(reward_of(batch, batched, infos), rewards)
    assert True in ends or (law and ends)


def test_a_reward_at_the_goal_in_motion_and_at_rest():
    env = CapsuleEnv(**GOAL)
    moves_and_rests = [[0.1, 0.05], [0.1, 0.0]]
    rewards = env.compute_reward(moves_and_rests, [[0.1, 0.0]] * 2, [{}, {}])
    assert rewards == pytest.approx([0.04, 0.1])


def test_the_reward_of_goals_in_float32_is_computed_in_float64():
    env = CapsuleEnv(**GOAL)
    achieved, desired = np.float32([[-0.1, 0.0]]), np.float32([[0.3, 0.0]])
    narrow = env.compute_reward(achieved, desired, {})
    assert_array_equal(
        narrow, env.compute_reward(achieved.astype(float), desired.astype(float), {})
    )


def test_only_goal_environments_compute_rewards():
    assert not hasattr(CapsuleEnv(task="goal"), "compute_reward")
    assert not hasattr(CapsuleVectorEnv(2), "compute_reward")


def test_disturbed_goals_are_measured():
    disturbances = Disturbances(x_dot_bias=0.05, stick_threshold=0.06)
    env = CapsuleEnv(task="goal", goal_env=True, disturbances=disturbances)
    seen, info = env.reset(seed=0, options={"state": [0.0] * 4, "mu": 0.4})
    for _ in range(20):
        assert_array_equal(seen["achieved_goal"], info["reading"][2:])
        seen, _, _, _, info = env.step(np.zeros(1, np.float32))
    achieved = seen["achieved_goal"]
    assert achieved == pytest.approx([0.02, 0.05])
    assert seen["desired_goal"][0] == info["goal"]
    # A measured rest counts as one.
    at_rest = env.compute_reward(achieved, achieved - [0.0, 0.05], {})
    assert at_rest == pytest.approx(0.02 * 5.0)


def test_infos_of_the_batch_for_sb3_give_the_rewards_of_its_goals():
    env = CapsuleSB3VecEnv(4, seed=0, max_episode_steps=40, **GOAL)
    seen = env.reset()
    # The first one fails, the others swing gently until the time limit.
    actions = np.array([[1.0], [0.05], [0.05], [0.05]], np.float32)
    failures = 0
    for _ in range(40):
        goals = seen["desired_goal"]
        seen, rewards, dones, infos = env.step(actions)
        assert [info["cost"] for info in infos[1:]] == [0.0] * 3
        failures += dones[0]
        last = {name: part.copy() for name, part in seen.items()}
        for i in np.flatnonzero(dones):
            for name, part in infos[i]["terminal_observation"].items():
                last[name][i] = part
        given = (last["achieved_goal"], last["desired_goal"], infos)
        (found,) = env.env_method("compute_reward", *given, indices=[0])
        assert_allclose(found, rewards, rtol=1e-6)
        assert_array_equal(last["desired_goal"], goals)
    assert failures > 0
    assert dones[1:].all()
    assert [info["episode"]["l"] for info in infos[1:]] == [40] * 3


def test_hindsight_replay_takes_the_native_batch():
    env = CapsuleSB3VecEnv(4, seed=0, max_episode_steps=40, **GOAL)
    model = SAC(
        "MultiInputPolicy",
        env,
        learning_starts=160,
        batch_size=16,
        device="cpu",
        seed=0,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": True},
    )
    model.learn(176)
    assert model.replay_buffer.sample(64).rewards.shape == (64, 1)
