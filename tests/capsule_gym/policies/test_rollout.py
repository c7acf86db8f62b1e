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
from tests.capsule_gym.policies.test_recurrent import TRAINED, recurrent_policy

STEPS = 130


def begun(policy, n, changes=None, threads=1):
    """A batch at the start of its episodes, without autoreset."""
    options = {} if changes is None else {"changes": changes}
    batch = {"autoreset_mode": "DISABLED", "max_episode_steps": 10_000, "threads": threads}
    env = CapsuleVectorEnv(n, **batch, **policy.env_kwargs)
    observations, _ = env.reset(seed=3, options=options)
    return env, observations


def stepped(env, policy, observations, steps):
    act = policy.start(range(len(observations)))
    for _ in range(steps):
        observations, *_ = env.step(act(observations))


def assert_same(one, other, rows):
    """Asserts equal bits in these rows of the environments."""
    assert one.observations.tobytes() == other.observations.tobytes()
    for row in rows:
        assert one.row(row).tobytes() == other.row(row).tobytes(), row
    everyone = np.arange(one.num_envs)
    expected = other.metrics(everyone, 100)
    for name, values in one.metrics(everyone, 100).items():
        assert values.tobytes() == expected[name].tobytes(), name


def jumps(n):
    """Four, none, one or three jumps of M and mu in each of n environments.

    They are between steps, on a step, two in one step, and one after the end.
    """
    one = [{"t": 0.3, "M": 0.6, "mu": 0.1}]
    three = [
        {"t": 0.505, "M": 0.4, "mu": 0.02},
        {"t": 0.51, "M": 0.7, "mu": 0.05},
        {"t": 1.9, "M": 0.5, "mu": 0.2},
    ]
    four = [*three, {"t": 50.0, "M": 0.5, "mu": 0.01}]
    cycle = (four, [], one, three)
    return [cycle[i % 4] for i in range(n)]


def on_a_law():
    """A policy that observes estimates of M and mu on a law, and pumps with all of them."""
    weights = [-1.0, 0.07, 0.02, 0.0, 0.01, *[0.0] * 5, 0.4, 0.05, 0.3, -0.02]
    layer = np.array([weights], np.float32), np.full(1, 0.1, np.float32)
    env_kwargs = {
        "observe_estimates": True,
        "controller": "baselines:adaptive",
        "residual_limit": 3.0,
    }
    statistics = {"mean": np.zeros(14), "variance": np.ones(14)}
    return make_policy(layers=(layer,), **statistics, env_kwargs=env_kwargs)


@pytest.fixture(
    params=[
        partial(load_policy, "direct-ppo"),
        partial(load_policy, "direct-sac"),
        partial(load_policy, "residual-ppo"),
        partial(load_policy, "dp-distilled-wide"),
        on_a_law,
        partial(load_policy, TRAINED),
        partial(recurrent_policy, "gru"),
    ]
)
def policy(request):
    policy = request.param()
    return replace(policy, env_kwargs={**policy.env_kwargs, "randomization": "wide"})


@pytest.fixture(params=[1, 2 * LANES + 3])
def n(request):
    return request.param


@pytest.fixture
def rolled(policy, n):
    """The simulation and the metrics after a rollout through jumps of M and mu."""
    env, _ = begun(policy, n, jumps(n), threads=3)
    return env.simulation, rollout(env.simulation, policy, STEPS)


def test_a_rollout_gives_the_bits_of_a_loop_in_python(policy, n, rolled):
    looped, observations = begun(policy, n, jumps(n), threads=2)
    stepped(looped, policy, observations, STEPS)
    # The action of an environment whose episode has ended has no effect.
    assert_same(looped.simulation, rolled[0], EPISODE_ROWS)


def test_a_rollout_gives_the_bits_of_environments_alone(policy, n, rolled):
    for i in {0, n // 2, n - 1}:
        alone = CapsuleEnv(**policy.env_kwargs)
        observation, _ = alone.reset(seed=3 + i, options={"changes": jumps(n)[i]})
        act = policy.start([0])
        for _ in range(STEPS):
            observation, _, terminated, _, _ = alone.step(act(observation))
            if terminated:
                break
        assert observation.tobytes() == rolled[0].observations[i].tobytes()


def test_a_rollout_gives_the_metrics_of_its_episodes(rolled):
    simulation, metrics = rolled
    assert set(metrics) == set(METRICS)
    # The platform moves, so that the filter can estimate M and mu, which have changed.
    assert np.median(metrics["distance"] + metrics["backward_ratio"]) > 0.01
    if simulation.num_envs > 1:
        masses = set(simulation.row(Row.M)[1:5])
        assert len(masses) > 1
        assert len(set(simulation.row(Row.mu)[1:5])) == len(masses)


def test_a_rollout_goes_on_from_where_it_is_and_steps_go_on_from_there():
    policy = load_policy("direct-ppo")
    n = 70
    looped, observations = begun(policy, n, jumps(n))
    stepped(looped, policy, observations, 90)

    mixed, observations = begun(policy, n, jumps(n))
    stepped(mixed, policy, observations, 20)
    rollout(mixed.simulation, policy, 8)
    rollout(mixed.simulation, policy, 22)
    # The first environment has pending changes, too.
    changes = mixed.simulation._changes
    elapsed = 51 * mixed.simulation.options.control_dt
    assert (changes[changes[:, 0] == 0.0, 1] > elapsed).any()
    stepped(mixed, policy, mixed.simulation.observations.copy(), 40)

    assert_same(looped.simulation, mixed.simulation, range(looped.simulation.world.shape[1]))


@pytest.fixture
def failed():
    """A simulation and its metrics with a policy that pushes until the pendulum lies down."""
    push = np.zeros((1, 5), np.float32), np.full(1, 3.0, np.float32)
    policy = make_policy(layers=(push,), env_kwargs={"torque_limit": 1.5, "randomization": "wide"})
    env, _ = begun(policy, 3)
    return policy, env.simulation, rollout(env.simulation, policy, 500)


def test_the_metrics_have_the_horizon_of_the_rollout(failed):
    _, simulation, metrics = failed
    assert metrics["failed"].all()
    assert (simulation.row(Row.steps) < 100).all()
    distance = simulation.row(Row.x) - simulation.row(Row.start_x)
    np.testing.assert_allclose(metrics["mean_speed"], 100.0 * distance / (500 * 0.02), rtol=1e-12)


def test_a_rollout_does_not_change_episodes_that_have_ended(failed):
    policy, simulation, _ = failed
    before = simulation.world.copy()
    rollout(simulation, policy, 10)
    assert simulation.world.tobytes() == before.tobytes()
