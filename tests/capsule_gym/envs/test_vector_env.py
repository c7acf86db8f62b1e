"""The native batch: the same episodes as single environments bit for bit, autoreset, infos,
threads."""

import copy
import gc
import hashlib
import itertools
import multiprocessing
import os
import pickle
import threading
import time
import tracemalloc
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import baselines
from capsule_gym import CapsuleEnv, CapsuleVectorEnv
from capsule_gym.core.layout import LANES
from capsule_gym.tasks.registry import TASKS
from capsule_gym.tasks.task import ENV_ID, METRICS, Termination
from tests.capsule_gym.fakes import flatten, picky_controller

GOAL = TASKS["goal"].env_id
VARIANTS = [
    {"initial_range": (1.0, 8.0), "randomization": "wide"},
    {"controller": "baselines:adaptive", "residual_limit": 3.0, "observe_parameters": True},
    {"controller": "baselines:gait", "total_torque": True, "residual_limit": 0.5},
    {"disturbances": "real", "randomization": "real-wide"},
    {"task": "goal", "observe_estimates": True},
    {
        "task": "velocity",
        "controller": "baselines:gait",
        "disturbances": "real",
        "observe_parameters": True,
    },
]


class WithMetrics(gym.Wrapper):
    """Adds an episode's metrics to its last info."""

    def step(self, action):
        *result, terminated, truncated, info = super().step(action)
        if terminated or truncated:
            info["metrics"] = self.unwrapped.episode_metrics(self.spec.max_episode_steps)
        return *result, terminated, truncated, info


# A failed episode's horizon, which a single environment does not know, counts in the last two.
UNKNOWN = {"final_obs", "final_info", "mean_speed", "goal_time"}


def assert_same_infos(ours, theirs, rows=slice(None)):
    """Asserts equal types and bits of the environments, also inside dictionaries."""
    for key in {name for name in ours if name[0] != "_" or rows == slice(None)} - UNKNOWN:
        if isinstance(ours[key], dict):
            assert_same_infos(ours[key], theirs[key], rows)
        else:
            one, other = ours[key][rows], theirs[key][rows]
            assert one.dtype == other.dtype and one.tobytes() == other.tobytes(), key


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("kwargs", VARIANTS)
@pytest.mark.parametrize(("n", "threads"), [(1, 1), (LANES + 2, 2)])
def test_batch_equals_single_environments_across_resets(mode, kwargs, n, threads):
    horizon = 40
    batch = CapsuleVectorEnv(
        n, max_episode_steps=horizon, autoreset_mode=mode.value, threads=threads, **kwargs
    )
    # Gymnasium's own vectorisation of single environments is the reference for every convention.
    single = partial(
        gym.make, ENV_ID, max_episode_steps=horizon, disable_env_checker=True, **kwargs
    )
    reference = SyncVectorEnv([lambda: WithMetrics(single())] * n, autoreset_mode=mode)
    rng = np.random.default_rng(1)
    a, b = batch.reset(seed=11), reference.reset(seed=11)
    assert a[0].tobytes() == b[0].tobytes()
    resets, terms = np.zeros(n, int), batch.simulation.task.reward_terms
    for _ in range(4 * horizon):
        actions = rng.uniform(-1.0, 1.0, (n, 1)).astype(np.float32)
        a, b = batch.step(actions), reference.step(actions)
        for ours, theirs in zip(a[:4], b[:4], strict=True):
            assert np.asarray(ours).tobytes() == np.asarray(theirs).tobytes()
        assert set(a[4]) == set(b[4]) - {"metrics", "_metrics"}
        assert_same_infos(a[4], b[4])
        ended = a[2] | a[3]
        resets += ended
        rows = np.flatnonzero(ended).tolist()
        if rows and mode is AutoresetMode.SAME_STEP:
            assert np.array_equal(a[4]["_final_obs"], b[4]["_final_obs"])
            assert (
                np.stack(a[4]["final_obs"][rows]).tobytes()
                == np.stack(b[4]["final_obs"][rows]).tobytes()
            )
            assert (
                {"state", "termination", "metrics", *terms}
                <= set(a[4]["final_info"])
                <= set(b[4]["final_info"])
            )
            assert_same_infos(a[4]["final_info"], b[4]["final_info"], rows)
        elif rows:
            metrics = batch.episode_metrics()
            assert set(METRICS) <= set(metrics) <= set(b[4]["metrics"])
            assert_same_infos(metrics, b[4]["metrics"], rows)
        # What a caller does with an info does not change later ones.
        for part in (each for each in flatten(a[4]) if each.flags.writeable):
            part.fill(0)
    assert resets.min() >= 3


@pytest.mark.parametrize("env_id", [task.env_id for task in TASKS.values()])
@pytest.mark.parametrize("kwargs", [{}, {"max_episode_steps": 10}], ids=["default", "short"])
def test_make_vec_gives_the_native_batch_whose_spec_says_its_time_limit(kwargs, env_id):
    env = gym.make_vec(env_id, num_envs=4, autoreset_mode="SAME_STEP", **kwargs)
    assert isinstance(env.unwrapped, CapsuleVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    steps = kwargs.get("max_episode_steps", gym.spec(env_id).max_episode_steps)
    assert env.spec.max_episode_steps == env.unwrapped.max_episode_steps == steps
    again = gym.make_vec(type(env.spec).from_json(env.spec.to_json()))
    assert (again.num_envs, again.unwrapped.max_episode_steps, again.spec.max_episode_steps) == (
        4,
        steps,
        steps,
    )
    assert CapsuleVectorEnv(2, **kwargs).spec is None


@pytest.mark.parametrize(("steps", "limit"), [(200, 200), (-1, None)])
def test_metrics_are_over_the_limit_that_acts(steps, limit):
    single = gym.make(GOAL, max_episode_steps=steps)
    batch = gym.make_vec(GOAL, num_envs=1, max_episode_steps=steps, autoreset_mode="DISABLED")
    assert (
        single.spec.max_episode_steps
        == batch.spec.max_episode_steps
        == batch.unwrapped.max_episode_steps
        == limit
    )
    for env, action in ((single, np.ones(1)), (batch, np.ones((1, 1)))):
        env.reset(seed=0, options={"state": [1.5, 0.0, 0.0, 0.1]})
        while not env.step(action)[2]:
            pass
    metrics = single.unwrapped.episode_metrics(limit)
    assert {name: [value] for name, value in metrics.items()} == batch.unwrapped.episode_metrics()
    assert metrics["goal_time"] == (metrics["duration"] if limit is None else 4.0)
    again = gym.make_vec(EnvSpec.from_json(batch.spec.to_json()))
    assert again.unwrapped.max_episode_steps == limit


def test_a_mask_holds_for_the_seeds():
    env, other = (CapsuleVectorEnv(3, randomization="wide") for _ in range(2))
    mask = np.array([True, False, False])
    for each, kwargs in ((env, {"options": {"reset_mask": mask}}), (other, {})):
        each.reset(seed=7, **kwargs)
    env.reset(options={"reset_mask": ~mask})
    for seed in (9, [9, 10, 11], np.array([9, 10, 11])):
        env.reset(seed=seed, options={"reset_mask": mask})
    expected = CapsuleVectorEnv(1, randomization="wide")
    expected.reset(seed=9)
    found = env.reset()[1]["M"]
    assert found[0] == expected.reset()[1]["M"] and np.array_equal(
        found[1:], other.reset()[1]["M"][1:]
    )


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_reading_the_generator_before_the_first_reset_leaves_the_draws_different(make):
    envs = [make(ENV_ID) for _ in range(2)]
    assert len({(env.np_random, float(np.ravel(env.reset()[1]["M"])[0]))[1] for env in envs}) == 2


def test_disabled_autoreset_stands_still_until_the_mask_names_it():
    env = CapsuleVectorEnv(3, max_episode_steps=50, autoreset_mode=AutoresetMode.DISABLED)
    states = np.array([[0.0, 0, 0, 0], [1.5, 5.0, 0, 0], [0.5, 0, 0, 0]])
    env.reset(
        seed=0, options={"state": states, "changes": [[{"t": 0.02, "M": 0.6, "mu": 0.01}]] * 3}
    )
    _, _, terminated, _, info = env.step(np.zeros((3, 1), np.float32))
    assert terminated.tolist() == [False, True, False]
    assert info["termination"].tolist() == [
        Termination.none,
        Termination.pendulum,
        Termination.none,
    ]
    assert info["_reward_progress"].all()
    metrics = env.episode_metrics()
    frozen = info["state"][1].copy()
    _, rewards, terminated, _, info = env.step(np.ones((3, 1), np.float32))
    assert terminated.tolist() == [False, True, False] and rewards[1] == 0.0
    assert info["_reward_progress"].tolist() == [True, False, True]
    assert np.array_equal(info["state"][1], frozen) and (info["M"] == 0.6).tolist() == [
        True,
        False,
        True,
    ]
    assert all(values[1] == metrics[name][1] for name, values in env.episode_metrics().items())
    before = info["state"][[0, 2]].copy()
    mask = np.array([False, True, False])
    _, info = env.reset(options={"reset_mask": mask})
    assert info["state"][1, 0] == pytest.approx(-np.pi / 3)
    assert np.array_equal(info["state"][[0, 2]], before) and np.array_equal(info["_state"], mask)
    assert not env.step(np.zeros((3, 1), np.float32))[2].any()


def flat(value):
    """All values of nested infos, in bytes."""
    if isinstance(value, dict):
        return [entry for key in value for entry in (key, *flat(value[key]))]
    if isinstance(value, (tuple, list)) or (
        isinstance(value, np.ndarray) and value.dtype == object
    ):
        return [entry for each in value if each is not None for entry in flat(each)]
    return [np.asarray(value).tobytes()]


def play(env, seed, steps):
    """The results of steps, and of the resets of a single environment between them, and the
    metrics, in bytes."""
    rng, seen = np.random.default_rng(seed), []
    for _ in range(steps):
        result = env.step(rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32))
        seen.append(flat(result))
        if isinstance(env, gym.Env) and (result[2] or result[3]):
            seen.append(flat(env.reset()))
    limit = (60,) if isinstance(env, gym.Env) else ()
    return [*seen, flat(env.unwrapped.episode_metrics(*limit)), env.unwrapped.np_random.random()]


LAWS = VARIANTS[1], VARIANTS[2], VARIANTS[3], VARIANTS[-1], {"controller": baselines.adaptive}
BATCHES = itertools.product((VARIANTS[1], VARIANTS[-1]), AutoresetMode)
MADE = [
    *(partial(gym.make, max_episode_steps=60, **kwargs) for kwargs in LAWS),
    *(partial(gym.make_vec, num_envs=LANES + 2, max_episode_steps=30, autoreset_mode=mode, threads=2, **kwargs)
      for kwargs, mode in BATCHES),
]  # fmt: skip


@pytest.mark.parametrize("make", MADE)
@pytest.mark.parametrize("make_copy", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_with_the_episodes_bit_for_bit_and_on_its_own(make_copy, make):
    env = make(ENV_ID)
    for each in (env, make_copy(env)):
        with pytest.raises(gym.error.ResetNeeded):
            each.unwrapped.step(np.zeros(env.action_space.shape, np.float32))
    changes = [{"t": 0.05, "M": 0.5, "mu": 0.01}, {"t": 0.9, "M": 0.6, "mu": 0.02}]
    env.reset(
        seed=4,
        options={"changes": changes if isinstance(env, gym.Env) else [changes] * (LANES + 2)},
    )
    # A batch is copied just after its first episodes have ended, an environment in the middle of
    # one, and the reverse.
    for steps in (30, 60, 10):
        play(env, 0, steps)
        twin = make_copy(env)
        assert (twin.spec, twin.metadata, twin.observation_space) == (
            env.spec,
            env.metadata,
            env.observation_space,
        )
        twins, expected = (make_copy(twin), twin), play(env, 1, 70)
        for each in twins:
            assert play(each, 1, 70) == expected
            each.close()
        env.reset(seed=5)


def test_options_per_environment_also_of_a_later_reset_apply_in_every_block():
    env = CapsuleVectorEnv(3)
    changes = [[], [{"t": 0.02, "M": 0.8, "mu": 0.3}], []]
    options = {
        "M": np.array([0.5, 0.6, 0.7]),
        "mu": 0.05,
        "changes": changes,
        "state": [0.1, -0.2, 3.0, 0.0],
    }
    _, info = env.reset(seed=0, options=options)
    assert info["state"].tolist() == [[0.1, -0.2, 3.0, 0.0]] * 3
    assert info["M"].tolist() == [0.5, 0.6, 0.7] and info["mu"].tolist() == [0.05] * 3
    for M in (0.6, 0.8):
        assert env.step(np.zeros((3, 1), np.float32))[4]["M"].tolist() == [0.5, M, 0.7]
    assert (env.reset()[1]["M"] < 0.56).all()
    states, mask = 0.1 * np.arange(12.0).reshape(3, 4), np.array([False, True, True])
    _, info = env.reset(options={"reset_mask": mask, "state": states, "mu": [0.1, 0.2, 0.3]})
    assert (info["state"][1:] == states[1:]).all() and info["mu"][1:].tolist() == [0.2, 0.3]
    n = 2 * LANES
    env, first_block = CapsuleVectorEnv(n), np.arange(n) < LANES
    for mask in (np.ones(n, bool), first_block):
        env.reset(options={"reset_mask": mask, "changes": [[{"t": 0.0, "M": 0.8, "mu": 0.3}]] * n})
    assert (env.step(np.zeros((n, 1), np.float32))[4]["M"] == 0.8).all()


def test_no_step_before_every_environment_has_begun():
    env, first = CapsuleVectorEnv(3, disturbances="real"), np.array([True, False, False])
    _, info = env.reset(seed=0, options={"reset_mask": first})
    assert np.array_equal(info["_capsule"], first) and np.array_equal(info["capsule"]["_m"], first)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros((3, 1), np.float32))
    env.reset(options={"reset_mask": ~first})
    assert np.isfinite(env.step(np.zeros((3, 1), np.float32))[1]).all()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_one_environment_that_diverges_ends_alone(mode):
    n, lost = 130, [3, 64, 129]
    # No step resolves a million N m, which a law may request if the limit allows it.
    kwargs = {"controller": picky_controller, "torque_limit": 1e6, "residual_limit": 0.5}
    calm, env = (CapsuleVectorEnv(n, autoreset_mode=mode, threads=2, **kwargs) for _ in range(2))
    states = np.tile([-1.0, 0.0, 0.0, 0.0], (n, 1))
    calm.reset(seed=0, options={"state": states})
    states[lost, 2] = 55.0
    env.reset(seed=0, options={"state": states})
    others = ~np.isin(np.arange(n), lost)
    for step in range(30):
        actions = np.random.default_rng(step).uniform(-1.0, 1.0, (n, 1)).astype(np.float32)
        expected, found = calm.step(actions), env.step(actions)
        for ours, theirs in zip(found[:4], expected[:4], strict=True):
            assert ours[others].tobytes() == theirs[others].tobytes()
        assert env.observation_space.contains(found[0]) and np.isfinite(found[1]).all()
        if step == 0:
            info = found[4].get("final_info", found[4])
            assert found[2][lost].all() and not found[3].any() and (found[1][lost] == -10.0).all()
            assert (info["termination"][lost] == Termination.diverged).all()
            assert (info["state"][lost] == states[lost]).all() and np.isfinite(
                info["normal_force"]
            ).all()


def test_an_interrupted_step_waits_for_its_other_threads():
    simulation, done = CapsuleVectorEnv(130, threads=2).simulation, []
    with pytest.raises(ZeroDivisionError):
        simulation._threads.share(lambda first, last: done.append(time.sleep(0.1)) if first else 1 // first)
    assert len(done) == 1


def digest(env):
    actions = np.full((env.num_envs, 1), 0.5, np.float32)
    return hashlib.sha256(b"".join(env.step(actions)[0].tobytes() for _ in range(20))).hexdigest()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
# From Python 3.12 on, fork warns that other threads may hold locks. The threads of this package are
# idle.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_process_steps_on():
    before = set(threading.enumerate())
    env, context = CapsuleVectorEnv(130, threads=2), multiprocessing.get_context("fork")
    env.reset(seed=0)
    env.step(np.zeros((130, 1), np.float32))
    ours, theirs = context.Pipe()
    child = context.Process(target=lambda: (theirs.send(digest(env)), env.close()))
    child.start()
    child.join(60.0)
    child.kill()
    assert child.exitcode == 0 and ours.recv() == digest(env)
    env.close()
    assert set(threading.enumerate()) <= before


@pytest.mark.parametrize("num_envs", [None, 130])
def test_stepping_does_not_grow_memory(num_envs):
    env = CapsuleVectorEnv(130, max_episode_steps=10**9, threads=2) if num_envs else CapsuleEnv()
    env.reset(seed=0)
    actions = np.zeros((130, 1) if num_envs else 1, np.float32)
    tracemalloc.start()
    held = []
    for steps in (50, 500):
        for _ in range(steps):
            env.step(actions)
        gc.collect()
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    # One reference kept per step would take 4 kB.
    assert held[1] - held[0] < 4_000
