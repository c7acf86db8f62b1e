"""The native batch: the episodes of single environments bit for bit, autoreset, infos, threads."""

import copy
import gc
import hashlib
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
from numpy.testing import assert_array_equal

import baselines
from capsule_gym import CapsuleEnv, CapsuleVectorEnv
from capsule_gym.core.layout import LANES
from capsule_gym.envs.threads import Threads
from capsule_gym.tasks.registry import TASKS
from capsule_gym.tasks.task import ENV_ID, METRICS, Termination
from tests.capsule_gym.envs.actions import random_actions
from tests.capsule_gym.fakes import flatten, picky_controller

GOAL = TASKS["goal"].env_id
RANGES = {"initial_range": (1.0, 8.0), "randomization": "wide"}
ADAPTIVE = {"controller": "baselines:adaptive", "residual_limit": 3.0, "observe_parameters": True}
GAIT = {"controller": "baselines:gait", "total_torque": True, "residual_limit": 0.5}
VARIED = {"disturbances": "real", "randomization": "real-wide"}
ESTIMATES = {"task": "goal", "observe_estimates": True}
VELOCITY = {
    "task": "velocity",
    "controller": "baselines:gait",
    "disturbances": "real",
    "observe_parameters": True,
}
HORIZON = 20
IDLE = np.zeros((3, 1), np.float32)
# A law is compiled once per controller.
PICKY = picky_controller()


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
    for key in ours.keys() - UNKNOWN:
        if key.startswith("_") and rows != slice(None):
            continue
        if isinstance(ours[key], dict):
            assert_same_infos(ours[key], theirs[key], rows)
        else:
            one = ours[key][rows]
            other = theirs[key][rows]
            assert one.dtype == other.dtype, key
            assert one.tobytes() == other.tobytes(), key


def assert_same_ends(batch, mode, info, expected, rows):
    """Asserts that the last infos of episodes, and their metrics, are those of gymnasium."""
    if mode is not AutoresetMode.SAME_STEP:
        metrics = batch.episode_metrics()
        assert set(METRICS) <= set(metrics) <= set(expected["metrics"])
        assert_same_infos(metrics, expected["metrics"], rows)
        return
    assert_array_equal(info["_final_obs"], expected["_final_obs"])
    last = np.stack(info["final_obs"][rows])
    assert last.tobytes() == np.stack(expected["final_obs"][rows]).tobytes()
    final = info["final_info"]
    required = {"state", "termination", "metrics", *batch.simulation.task.reward_terms}
    assert required <= set(final) <= set(expected["final_info"])
    assert_same_infos(final, expected["final_info"], rows)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("kwargs", [RANGES, ADAPTIVE, GAIT, VARIED, ESTIMATES, VELOCITY])
@pytest.mark.parametrize(("n", "threads"), [(1, 1), (LANES + 2, 2)])
def test_batch_equals_single_environments_across_resets(mode, kwargs, n, threads):
    kwargs = {**kwargs, "max_episode_steps": HORIZON}
    batch = CapsuleVectorEnv(n, autoreset_mode=mode.value, threads=threads, **kwargs)
    # Gymnasium's own vectorisation of single environments is the reference for every convention.
    single = partial(gym.make, ENV_ID, disable_env_checker=True, **kwargs)
    reference = SyncVectorEnv([lambda: WithMetrics(single())] * n, autoreset_mode=mode)
    first, _ = batch.reset(seed=11)
    assert first.tobytes() == reference.reset(seed=11)[0].tobytes()
    ends = np.zeros(n, int)
    for actions in random_actions(1, 4 * HORIZON, n):
        *ours, info = batch.step(actions)
        *theirs, expected = reference.step(actions)
        for one, other in zip(ours, theirs, strict=True):
            assert one.tobytes() == other.tobytes()
        assert set(info) == set(expected) - {"metrics", "_metrics"}
        assert_same_infos(info, expected)
        _, _, terminated, truncated = ours
        ended = terminated | truncated
        ends += ended
        if ended.any():
            assert_same_ends(batch, mode, info, expected, np.flatnonzero(ended).tolist())
        # What a caller does with an info does not change later ones.
        for part in flatten(info):
            if part.flags.writeable:
                part.fill(0)
    assert ends.min() >= 3


@pytest.mark.parametrize("env_id", [task.env_id for task in TASKS.values()])
@pytest.mark.parametrize("kwargs", [{}, {"max_episode_steps": 10}], ids=["default", "short"])
def test_make_vec_gives_the_native_batch_whose_spec_says_its_time_limit(kwargs, env_id):
    env = gym.make_vec(env_id, num_envs=4, autoreset_mode="SAME_STEP", **kwargs)
    assert isinstance(env.unwrapped, CapsuleVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    steps = kwargs.get("max_episode_steps", gym.spec(env_id).max_episode_steps)
    again = gym.make_vec(EnvSpec.from_json(env.spec.to_json()))
    assert again.num_envs == 4
    for each in (env, again):
        assert each.spec.max_episode_steps == steps
        assert each.unwrapped.max_episode_steps == steps


def test_a_batch_that_make_vec_did_not_make_has_no_spec():
    assert CapsuleVectorEnv(2).spec is None


@pytest.mark.parametrize(("steps", "limit"), [(200, 200), (-1, None)])
def test_metrics_are_over_the_limit_that_acts(steps, limit):
    single = gym.make(GOAL, max_episode_steps=steps)
    batch = gym.make_vec(GOAL, num_envs=1, max_episode_steps=steps, autoreset_mode="DISABLED")
    again = gym.make_vec(EnvSpec.from_json(batch.spec.to_json()))
    for each in (single.spec, batch.spec, batch.unwrapped, again.unwrapped):
        assert each.max_episode_steps == limit
    for env in (single, batch):
        env.reset(seed=0, options={"state": [1.5, 0.0, 0.0, 0.1]})
        while not env.step(np.ones(env.action_space.shape))[2]:
            pass
    metrics = single.unwrapped.episode_metrics(limit)
    assert {name: [value] for name, value in metrics.items()} == batch.unwrapped.episode_metrics()
    assert metrics["goal_time"] == (metrics["duration"] if limit is None else 4.0)


def test_a_mask_holds_for_the_seeds():
    # Given: environment 0 gets several seeds, the last one 9, and the others keep those of 7.
    env = CapsuleVectorEnv(3, randomization="wide")
    mask = np.array([True, False, False])
    env.reset(seed=7, options={"reset_mask": mask})
    env.reset(options={"reset_mask": ~mask})
    for seed in (9, [9, 10, 11], np.array([9, 10, 11])):
        env.reset(seed=seed, options={"reset_mask": mask})
    seeded = [CapsuleVectorEnv(3, randomization="wide") for _ in range(2)]
    for each, seed in zip(seeded, (9, 7), strict=True):
        each.reset(seed=seed)
    # When all begin the second episode of their seeds.
    found, nine, seven = (each.reset()[1]["M"] for each in (env, *seeded))
    assert found[0] == nine[0]
    assert_array_equal(found[1:], seven[1:])


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_reading_the_generator_before_the_first_reset_leaves_the_draws_different(make):
    masses = set()
    for _ in range(2):
        env = make(ENV_ID)
        assert env.np_random is not None
        _, info = env.reset()
        masses.add(np.ravel(info["M"])[0])
    assert len(masses) == 2


@pytest.fixture
def half_ended():
    """A batch without autoreset, of which the second environment has ended, and its last info."""
    env = CapsuleVectorEnv(3, max_episode_steps=50, autoreset_mode=AutoresetMode.DISABLED)
    states = np.array([[0.0, 0, 0, 0], [1.5, 5.0, 0, 0], [0.5, 0, 0, 0]])
    changes = [{"t": 0.02, "M": 0.6, "mu": 0.01}]
    env.reset(seed=0, options={"state": states, "changes": [changes] * 3})
    _, _, terminated, _, info = env.step(IDLE)
    assert terminated.tolist() == [False, True, False]
    none = Termination.none
    assert info["termination"].tolist() == [none, Termination.pendulum, none]
    assert info["_reward_progress"].all()
    return env, info


def test_disabled_autoreset_stands_still(half_ended):
    env, last = half_ended
    state = last["state"][1].copy()
    metrics = env.episode_metrics()
    _, rewards, terminated, _, info = env.step(np.ones((3, 1), np.float32))
    assert terminated.tolist() == [False, True, False]
    assert rewards[1] == 0.0
    assert all(last[name][1] for name in ("cost", "normal_force", "reward_termination"))
    for name in ("cost", "energy", "normal_force", "reward_progress", "reward_termination"):
        assert info[name][1] == 0.0
        assert info[f"_{name}"].tolist() == [True, False, True]
    assert (info["normal_force"] > 0.0).tolist() == [True, False, True]
    assert info["_torque"].all()
    assert_array_equal(info["state"][1], state)
    assert (info["M"] == 0.6).tolist() == [True, False, True]
    for name, values in env.episode_metrics().items():
        assert values[1] == metrics[name][1]


def test_disabled_autoreset_goes_on_when_the_mask_names_it(half_ended):
    env, last = half_ended
    states = last["state"].copy()
    mask = np.array([False, True, False])
    _, info = env.reset(options={"reset_mask": mask})
    assert info["state"][1, 0] == pytest.approx(-np.pi / 3)
    assert_array_equal(info["state"][~mask], states[~mask])
    assert_array_equal(info["_state"], mask)
    _, _, terminated, _, _ = env.step(IDLE)
    assert not terminated.any()


def flat(value):
    """All values of nested infos, in bytes."""
    if isinstance(value, dict):
        return [entry for key in value for entry in (key, *flat(value[key]))]
    objects = isinstance(value, np.ndarray) and value.dtype == object
    if objects or isinstance(value, (tuple, list)):
        return [entry for each in value if each is not None for entry in flat(each)]
    return [np.asarray(value).tobytes()]


def play(env, seed, steps):
    """The results of steps, of the resets between them, and the metrics, in bytes."""
    rng = np.random.default_rng(seed)
    single = isinstance(env, gym.Env)
    seen = []
    for _ in range(steps):
        result = env.step(rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32))
        seen += flat(result)
        if single and (result[2] or result[3]):
            seen += flat(env.reset())
    core = env.unwrapped
    seen += flat(core.episode_metrics(60) if single else core.episode_metrics())
    return [*seen, core.np_random.random()]


LAWS = [ADAPTIVE, GAIT, VARIED, VELOCITY, {"controller": baselines.adaptive}]
BATCH = {"num_envs": LANES + 2, "max_episode_steps": 30, "threads": 2}
MADE = [partial(gym.make, max_episode_steps=60, **kwargs) for kwargs in LAWS]
for autoreset_mode in AutoresetMode:
    make_batch = partial(gym.make_vec, autoreset_mode=autoreset_mode, **BATCH)
    MADE += [partial(make_batch, **kwargs) for kwargs in (ADAPTIVE, VELOCITY)]


def unpickled(env):
    return pickle.loads(pickle.dumps(env))


@pytest.mark.parametrize("make", MADE)
@pytest.mark.parametrize("make_copy", [copy.deepcopy, unpickled])
def test_a_copy_goes_on_with_the_episodes_bit_for_bit_and_on_its_own(make_copy, make):
    env = make(ENV_ID)
    for each in (env, make_copy(env)):
        with pytest.raises(gym.error.ResetNeeded):
            each.unwrapped.step(np.zeros(env.action_space.shape, np.float32))
    changes = [{"t": 0.05, "M": 0.5, "mu": 0.01}, {"t": 0.9, "M": 0.6, "mu": 0.02}]
    if not isinstance(env, gym.Env):
        changes = [changes] * env.num_envs
    env.reset(seed=4, options={"changes": changes})
    # A batch is copied just after its first episodes have ended, an environment in the middle of
    # one, and the reverse.
    for steps in (30, 60, 10):
        play(env, 0, steps)
        twin = make_copy(env)
        assert twin.spec == env.spec
        assert twin.metadata == env.metadata
        assert twin.observation_space == env.observation_space
        twins = (make_copy(twin), twin)
        expected = play(env, 1, 70)
        for each in twins:
            assert play(each, 1, 70) == expected
            each.close()
        env.reset(seed=5)


@pytest.mark.parametrize("make_copy", [copy.deepcopy, unpickled])
def test_a_copy_shows_what_its_next_episodes_draw(make_copy):
    env = CapsuleVectorEnv(3, **VARIED)
    env.reset(seed=0)
    twin = make_copy(env)
    _, expected = env.reset()
    _, info = twin.reset()
    for name in ("capsule", "disturbances"):
        assert_same_infos(info[name], expected[name])


def test_options_per_environment_apply_to_their_episode_only():
    env = CapsuleVectorEnv(3)
    state = [0.1, -0.2, 3.0, 0.0]
    options = {"M": np.array([0.5, 0.6, 0.7]), "mu": 0.05, "state": state}
    options["changes"] = [[], [{"t": 0.02, "M": 0.8, "mu": 0.3}], []]
    _, info = env.reset(seed=0, options=options)
    assert info["state"].tolist() == [state] * 3
    assert info["M"].tolist() == [0.5, 0.6, 0.7]
    assert info["mu"].tolist() == [0.05] * 3
    for M in (0.6, 0.8):
        *_, info = env.step(IDLE)
        assert info["M"].tolist() == [0.5, M, 0.7]
    _, info = env.reset()
    assert (info["M"] < 0.56).all()


def test_options_of_a_later_reset_apply_to_the_environments_of_its_mask():
    env = CapsuleVectorEnv(3)
    env.reset(seed=0)
    states = 0.1 * np.arange(12.0).reshape(3, 4)
    mask = np.array([False, True, True])
    options = {"reset_mask": mask, "state": states, "mu": [0.1, 0.2, 0.3]}
    _, info = env.reset(options=options)
    assert_array_equal(info["state"][1:], states[1:])
    assert info["mu"][1:].tolist() == [0.2, 0.3]


def test_many_changes_of_many_environments_apply_in_the_order_of_time():
    n = 30
    times = 0.02 * np.arange(1, 9)
    schedules = [[{"t": t, "M": 0.4 + t + 0.01 * i, "mu": 0.1} for t in times] for i in range(n)]
    env = CapsuleVectorEnv(n)
    later = np.arange(n) >= n // 2
    for mask in (later, ~later):
        env.reset(options={"reset_mask": mask, "changes": schedules})
    env.step(np.zeros((n, 1), np.float32))
    for t in times:
        *_, info = env.step(np.zeros((n, 1), np.float32))
        assert_array_equal(info["M"], 0.4 + t + 0.01 * np.arange(n))


def test_changes_of_several_resets_apply_in_every_block():
    n = 2 * LANES
    env = CapsuleVectorEnv(n)
    changes = [[{"t": 0.0, "M": 0.8, "mu": 0.3}]] * n
    for mask in (np.ones(n, bool), np.arange(n) < LANES):
        env.reset(options={"reset_mask": mask, "changes": changes})
    *_, info = env.step(np.zeros((n, 1), np.float32))
    assert (info["M"] == 0.8).all()


def test_no_step_before_every_environment_has_begun():
    env = CapsuleVectorEnv(3, disturbances="real")
    first = np.array([True, False, False])
    _, info = env.reset(seed=0, options={"reset_mask": first})
    assert_array_equal(info["_capsule"], first)
    assert_array_equal(info["capsule"]["_m"], first)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(IDLE)
    env.reset(options={"reset_mask": ~first})
    _, rewards, _, _, _ = env.step(IDLE)
    assert np.isfinite(rewards).all()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_one_environment_that_diverges_ends_alone(mode):
    n = 130
    lost = np.isin(np.arange(n), [3, 64, 129])
    # No step resolves a million N m, which a law may request if the limit allows it.
    limits = {"torque_limit": 1e6, "residual_limit": 0.5}
    make = partial(CapsuleVectorEnv, n, autoreset_mode=mode, threads=2, **limits)
    calm = make(controller=PICKY)
    env = make(controller=PICKY)
    states = np.tile([-1.0, 0.0, 0.0, 0.0], (n, 1))
    calm.reset(seed=0, options={"state": states})
    states[lost, 2] = 55.0
    env.reset(seed=0, options={"state": states})
    for step, actions in enumerate(random_actions(0, 30, n)):
        *expected, _ = calm.step(actions)
        *found, info = env.step(actions)
        for ours, theirs in zip(found, expected, strict=True):
            assert ours[~lost].tobytes() == theirs[~lost].tobytes()
        observations, rewards, terminated, truncated = found
        assert env.observation_space.contains(observations)
        assert np.isfinite(rewards).all()
        if step == 0:
            info = info.get("final_info", info)
            assert terminated[lost].all()
            assert not truncated.any()
            assert (rewards[lost] == -10.0).all()
            assert (info["termination"][lost] == Termination.diverged).all()
            assert_array_equal(info["state"][lost], states[lost])
            assert np.isfinite(info["normal_force"]).all()


def test_an_interrupted_step_waits_for_its_other_threads():
    done = []

    def work(first, last):
        if first == 0:
            raise InterruptedError
        time.sleep(0.1)
        done.append(first)

    threads = Threads(130, LANES, 2)
    with pytest.raises(InterruptedError):
        threads.share(work)
    assert len(done) == 1
    threads.close()


def digest(env):
    actions = np.full((env.num_envs, 1), 0.5, np.float32)
    observations = [env.step(actions)[0] for _ in range(20)]
    return hashlib.sha256(np.array(observations)).hexdigest()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
# From Python 3.12 on, fork warns that other threads may hold locks. The threads of this package are
# idle.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_process_steps_on():
    before = set(threading.enumerate())
    env = CapsuleVectorEnv(130, threads=2)
    env.reset(seed=0)
    env.step(np.zeros((130, 1), np.float32))
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    child = context.Process(target=lambda: (theirs.send(digest(env)), env.close()))
    child.start()
    child.join(60.0)
    child.kill()
    assert child.exitcode == 0
    assert ours.recv() == digest(env)
    env.close()
    assert set(threading.enumerate()) <= before


@pytest.mark.parametrize(
    "make", [CapsuleEnv, partial(CapsuleVectorEnv, 130, max_episode_steps=10**9, threads=2)]
)
def test_stepping_does_not_grow_memory(make):
    env = make()
    env.reset(seed=0)
    actions = np.zeros(env.action_space.shape, np.float32)
    tracemalloc.start()
    held = []
    for steps in (50, 500):
        for _ in range(steps):
            env.step(actions)
        gc.collect()
        size, _ = tracemalloc.get_traced_memory()
        held.append(size)
    tracemalloc.stop()
    # One reference kept per step would take 4 kB.
    assert held[1] - held[0] < 4_000
