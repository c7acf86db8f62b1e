"""What keeps the environment fast and small, as counts: no times are measured here."""

from __future__ import annotations

import gc
import sys
import tracemalloc
from collections import Counter
from collections.abc import Callable

import gymnasium as gym
import numpy as np
import pytest

from capsule_gym import ENV_ID, CapsuleVectorEnv
from capsule_gym.simulation import Simulation

NEVER = sys.maxsize
BATCH = 130
STEPS = 2000


def growth(step: Callable[[], object]) -> int:
    """Bytes that Python and numpy hold more after STEPS steps than before them, the first steps left out."""
    for _ in range(50):
        step()
    gc.collect()
    tracemalloc.start()
    try:
        step()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(STEPS):
            step()
        gc.collect()
        return tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("threads", [1, 2])
def test_stepping_a_batch_does_not_grow_memory(threads):
    env = CapsuleVectorEnv(BATCH, max_episode_steps=NEVER, threads=threads)
    env.reset(seed=0)
    actions = np.zeros((BATCH, 1), np.float32)
    # A reference kept per step would be 16 kB already.
    assert growth(lambda: env.step(actions)) < 8_000
    assert not env._ended.any()
    env.close()


def test_stepping_one_environment_does_not_grow_memory():
    env = gym.make(ENV_ID, max_episode_steps=NEVER)
    env.reset(seed=0)
    action = np.zeros(1, np.float32)
    assert growth(lambda: env.step(action)) < 8_000
    env.close()


def calls_of(function: Callable[[], object]) -> Counter[str]:
    """Functions that one calls, with how often."""
    found: Counter[str] = Counter()

    def note(frame, event, argument):
        if event == "call":
            found[frame.f_code.co_name] += 1
        elif event == "c_call":
            found[argument.__name__] += 1

    sys.setprofile(note)
    try:
        function()
    finally:
        sys.setprofile(None)
    return found


def calls_in_a_step(n: int, **kwargs: object) -> Counter[str]:
    """The calls of one step of n environments in which no episode ends."""
    env = CapsuleVectorEnv(n, max_episode_steps=NEVER, **kwargs)
    env.reset(seed=0)
    actions = np.zeros((n, 1), np.float32)
    env.step(actions)
    found = calls_of(lambda: env.step(actions))
    assert not env._ended.any()
    env.close()
    return found


def calls_in_a_reset(n: int, **kwargs: object) -> Counter[str]:
    """The calls of one reset of n environments, whose seeds are given."""
    env = CapsuleVectorEnv(n, **kwargs)
    env.reset(seed=0)
    found = calls_of(env.reset)
    env.close()
    return found


@pytest.mark.parametrize("kwargs", [{}, {"controller": "baselines:adaptive"}], ids=["direct", "adaptive"])
def test_a_step_in_which_nothing_ends_does_no_work_per_environment_in_python(kwargs):
    few, many = calls_in_a_step(64, **kwargs), calls_in_a_step(4096, **kwargs)
    assert few == many
    assert 20 < few.total() < 150


@pytest.mark.parametrize("kwargs", [{}, {"controller": "baselines:adaptive"}], ids=["direct", "adaptive"])
def test_a_reset_does_no_work_per_environment_in_python(kwargs):
    few, many = (calls_in_a_reset(n, initial_noise=0.1, **kwargs) for n in (64, 4096))
    assert few == many
    assert 10 < few.total() < 100


def test_a_reset_of_one_environment_calls_little():
    env = gym.make(ENV_ID)
    env.reset(seed=0)
    env.reset()
    assert calls_of(env.reset).total() < 30


def test_an_environment_of_a_large_batch_takes_half_a_kilobyte():
    n = 262_144
    small = Simulation(1)  # whatever is imported or compiled on the way
    tracemalloc.start()
    try:
        simulation = Simulation(n)
        held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert simulation.world.nbytes + simulation.observations.nbytes <= held < 512 * n
    assert simulation.world.shape[1:] == small.world.shape[1:]
