from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, load_policy
from capsule_gym.core.layout import LANES, Row
from capsule_gym.policies.rollout import rollout
from capsule_gym.tasks.task import METRICS
from tests.capsule_gym.fakes import EPISODE_ROWS
from tests.capsule_gym.policies.test_policy import make_policy


def begun(policy, n, changes=None, **kwargs):
    """A batch at the start of its episodes, without autoreset."""
    env = CapsuleVectorEnv(
        n, autoreset_mode="DISABLED", max_episode_steps=10_000, **{**policy.env_kwargs, **kwargs}
    )
    observations, _ = env.reset(seed=3, options={} if changes is None else {"changes": changes})
    return env, observations


def stepped(env, policy, observations, steps):
    act = policy.start(range(len(observations)))
    for _ in range(steps):
        observations, _, _, _, _ = env.step(act(observations))
    return observations


def assert_same(one, other, rows=None):
    """Asserts equal bits in all rows of the environments, or in some rows."""
    assert one.observations.tobytes() == other.observations.tobytes()
    for row in range(one.world.shape[1]) if rows is None else rows:
        assert one.row(row).tobytes() == other.row(row).tobytes(), row
    for name, values in one.metrics(np.arange(one.num_envs), 100).items():
        assert values.tobytes() == other.metrics(np.arange(one.num_envs), 100)[name].tobytes(), name


def jumps(n):
    """Four, none, one or three jumps of M and mu: between steps, on a step, two in one step, and
    one after the end."""
    one = [{"t": 0.3, "M": 0.6, "mu": 0.1}]
    three = [
        {"t": 0.505, "M": 0.4, "mu": 0.02},
        {"t": 0.51, "M": 0.7, "mu": 0.05},
        {"t": 1.9, "M": 0.5, "mu": 0.2},
    ]
    return [([*three, {"t": 50.0, "M": 0.5, "mu": 0.01}], [], one, three)[i % 4] for i in range(n)]


def on_a_law():
    """A policy that observes estimates of M and mu on a law, and pumps with all of them."""
    weights = np.array(
        [[-1.0, 0.07, 0.02, 0.0, 0.01, *[0.0] * 5, 0.4, 0.05, 0.3, -0.02]], np.float32
    )
    env_kwargs = {
        "observe_estimates": True,
        "controller": "baselines:adaptive",
        "residual_limit": 3.0,
    }
    layers = ((weights, np.full(1, 0.1, np.float32)),)
    return make_policy(
        layers=layers, mean=np.zeros(14), variance=np.ones(14), env_kwargs=env_kwargs
    )


PRETRAINED = [
    partial(load_policy, name)
    for name in ("direct-ppo", "direct-sac", "residual-ppo", "dp-distilled-wide")
]


@pytest.mark.parametrize("n", [1, 2 * LANES + 3])
@pytest.mark.parametrize("make", [*PRETRAINED, on_a_law])
def test_a_rollout_gives_the_bits_of_a_loop_in_python_and_of_environments_alone(make, n):
    policy, steps = make(), 130
    policy = replace(policy, env_kwargs={**policy.env_kwargs, "randomization": "wide"})
    looped, observations = begun(policy, n, jumps(n), threads=2)
    rolled, _ = begun(policy, n, jumps(n), threads=3)
    stepped(looped, policy, observations, steps)
    metrics = rollout(rolled.simulation, policy, steps)
    assert set(metrics) == set(METRICS)
    # The action of an environment whose episode has ended has no effect.
    assert_same(looped.simulation, rolled.simulation, EPISODE_ROWS)
    # The platform moves, so that the filter can estimate M and mu, which have changed.
    assert np.median(metrics["distance"] + metrics["backward_ratio"]) > 0.01
    assert (
        n == 1
        or len(set(rolled.simulation.row(Row.mu)[1:5]))
        == len(set(rolled.simulation.row(Row.M)[1:5]))
        > 1
    )
    for i in {0, n // 2, n - 1}:
        alone = CapsuleEnv(**policy.env_kwargs)
        observation, _ = alone.reset(seed=3 + i, options={"changes": jumps(n)[i]})
        act, terminated, step = policy.start([0]), False, 0
        while not terminated and step < steps:
            observation, _, terminated, _, _ = alone.step(act(observation))
            step += 1
        assert observation.tobytes() == rolled.simulation.observations[i].tobytes()


def test_a_rollout_goes_on_from_where_it_is_and_steps_go_on_from_there():
    policy, n = load_policy("direct-ppo"), 70
    looped, observations = begun(policy, n, jumps(n))
    stepped(looped, policy, observations, 90)
    mixed, observations = begun(policy, n, jumps(n))
    stepped(mixed, policy, observations, 20)
    rollout(mixed.simulation, policy, 8)
    rollout(mixed.simulation, policy, 22)
    # The first environment has pending changes, too.
    changes = mixed.simulation._changes
    assert (changes[changes[:, 0] == 0.0, 1] > 51 * mixed.simulation.options.control_dt).any()
    stepped(mixed, policy, mixed.simulation.observations.copy(), 40)
    assert_same(looped.simulation, mixed.simulation)


def test_blocks_that_have_ended_stop_and_the_metrics_have_the_rollouts_horizon():
    # The policy pushes in one direction until the pendulum lies down.
    push = np.zeros((1, 5), np.float32), np.full(1, 3.0, np.float32)
    policy = make_policy(layers=(push,), env_kwargs={"torque_limit": 1.5, "randomization": "wide"})
    env, _ = begun(policy, 3)
    metrics = rollout(env.simulation, policy, 500)
    assert metrics["failed"].all() and (env.simulation.row(Row.steps) < 100).all()
    distance = env.simulation.row(Row.x) - env.simulation.row(Row.start_x)
    np.testing.assert_allclose(metrics["mean_speed"], 100.0 * distance / (500 * 0.02), rtol=1e-12)
    before = env.simulation.world.copy()
    rollout(env.simulation, policy, 10)
    assert env.simulation.world.tobytes() == before.tobytes()
