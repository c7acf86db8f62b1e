"""What calls a policy keeps the memory of a recurrent one: evaluation, demo, logs, autoreset."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from sb3_contrib import RecurrentPPO

import capsule_gym
from capsule_gym import CapsuleEnv, CapsuleVectorEnv, Policy, demo, load_policy, record
from capsule_gym.core.layout import Row
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.evaluation.sets import EvaluationSet, load_set
from capsule_gym.policies.rollout import rollout
from capsule_gym.sb3 import CapsuleSB3VecEnv
from capsule_gym.tasks.task import CONTROL_DT, TORQUE_LIMIT
from tests.capsule_gym.policies.test_recurrent import TRAINED, recurrent_policy

PLANTS = EvaluationSet("three", load_set("paper").plants[:3])
SECONDS = 4.0
STEPS = round(SECONDS / CONTROL_DT)


def played(policy, plant):
    """The environment after an episode on a plant, with a memory of its own."""
    env = CapsuleEnv(**(policy.env_kwargs | PLANTS.env_kwargs))
    observation, _ = env.reset(seed=plant.seed, options=plant.reset_options())
    act = policy.start([plant.seed])
    for _ in range(STEPS):
        observation, *_ = env.step(act(observation))
    return env


def expected_distances(policy):
    """The distances of episodes, m, each played alone."""
    envs = [played(policy, plant) for plant in PLANTS.plants]
    return [env.episode_metrics(STEPS)["distance"] for env in envs]


def distances(episodes):
    return [episode["distance"] for episode in episodes]


@pytest.mark.parametrize("kind", [str, load_policy, lambda path: find_candidate(str(path))])
def test_evaluate_gives_the_episodes_of_a_loop(kind):
    episodes = capsule_gym.evaluate(kind(TRAINED), PLANTS, horizon=SECONDS)
    assert distances(episodes) == expected_distances(load_policy(TRAINED))


def test_evaluate_takes_an_agent_of_sb3_contrib():
    model = RecurrentPPO("MlpLstmPolicy", CapsuleSB3VecEnv(1), seed=1, device="cpu")
    # Without training the actions are almost 0.
    model.policy.action_net.weight.data *= 50.0
    found, expected = (
        [episode["rms_torque"] for episode in capsule_gym.evaluate(policy, PLANTS, horizon=1.0)]
        for policy in (model, Policy.from_sb3(model))
    )
    assert min(expected) > 1e-3
    # The agent computes in float32.
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_the_policy_has_learnt_to_move():
    episodes = capsule_gym.evaluate(str(TRAINED), "paper")
    # The laws alone reach 1.4 cm/s.
    assert np.mean([episode["mean_speed"] for episode in episodes]) > 4.0
    assert not any(episode["failed"] for episode in episodes)


def test_tables_describe_the_policy():
    candidate = find_candidate(str(TRAINED))
    assert candidate.description.startswith("Recurrent PPO, the whole torque, trained with ")
    assert candidate.inputs == ("state, stick of all steps", "nothing")


@pytest.mark.parametrize("plant", PLANTS.plants, ids=lambda plant: str(plant.seed))
def test_the_demo_shows_the_episode(plant):
    policy = demo.find_policy(str(TRAINED))
    episode = demo.Episode(policy, PLANTS, plant)
    # As a window advances it, frame by frame.
    for time in np.linspace(0.0, SECONDS, 101):
        episode.advance(time)
    expected = played(policy, plant).episode_metrics(STEPS)
    assert episode.env.episode_metrics(STEPS) == expected


def test_a_log_contains_the_torques_of_the_episode():
    policy = load_policy(TRAINED)
    log = record(CapsuleEnv(**policy.env_kwargs), policy, seconds=1.0, seed=5)
    env = CapsuleEnv(**policy.env_kwargs)
    observation, _ = env.reset(seed=5)
    act = policy.start([0])
    for torque in log["torque"]:
        action = act(observation)
        assert torque == pytest.approx(TORQUE_LIMIT * action[0], rel=1e-6)
        observation, *_ = env.step(action)


def test_a_rollout_with_threads_is_that_of_a_loop_for_episodes_of_different_lengths():
    # The random policy lets the pendulum fall.
    policy = recurrent_policy()
    env_kwargs = {"autoreset_mode": "DISABLED", "randomization": "wide"}

    def begun(threads):
        env = CapsuleVectorEnv(50, threads=threads, **env_kwargs)
        return env, env.reset(seed=11)[0]

    looped, observations = begun(1)
    act = policy.start(range(50))
    for _ in range(60):
        observations, *_ = looped.step(act(observations))
    lengths = looped.simulation.row(Row.steps)
    assert len(set(lengths)) > 3
    for threads in (1, 2, 3, 7):
        env, _ = begun(threads)
        rollout(env.simulation, policy, 60)
        assert env.simulation.observations.tobytes() == looped.simulation.observations.tobytes()
        assert env.simulation.row(Row.steps).tobytes() == lengths.tobytes()


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_a_batch_with_autoreset_gives_every_episode_a_new_memory(mode):
    policy = recurrent_policy()
    n = 7
    env = CapsuleVectorEnv(n, autoreset_mode=mode, max_episode_steps=29, randomization="wide")
    observations, _ = env.reset(seed=2)
    act = policy.start(range(n))
    starts = np.ones(n, bool)
    alone = [None] * n
    ended = np.zeros(n, bool)
    begun = 0
    for _ in range(100):
        actions = act(observations, starts)
        for i in range(n):
            if starts[i]:
                alone[i] = policy.start([0])
                begun += 1
            assert alone[i](observations[i]).tobytes() == actions[i].tobytes()
        observations, _, terminated, truncated, _ = env.step(actions)
        before = ended
        ended = terminated | truncated
        # With NEXT_STEP, the observation after the last one is the first of the next episode.
        starts = ended if mode is AutoresetMode.SAME_STEP else before
        assert np.array_equal(starts, env.simulation.row(Row.steps) == 0)
    assert begun > 3 * n
