"""Counts that show whether the environment is fast and small. These tests measure no time."""

from __future__ import annotations

import gc
import sys
import tracemalloc
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv

NEVER = sys.maxsize
BATCH = 130
STEPS = 500


def growth(step: Callable[[], object]) -> int:
    """Bytes that Python and numpy hold more after STEPS steps than before; the first steps are not counted."""
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


@pytest.mark.parametrize("num_envs", [None, BATCH])
def test_stepping_does_not_grow_memory(num_envs):
    env = CapsuleVectorEnv(BATCH, max_episode_steps=NEVER, threads=2) if num_envs else CapsuleEnv()
    env.reset(seed=0)
    actions = np.zeros((BATCH, 1) if num_envs else 1, np.float32)
    # One reference kept per step would take 4 kB.
    assert growth(lambda: env.step(actions)) < 4_000
    env.close()


def calls(n: int, *, reset: bool) -> Counter[str]:
    """Counts the functions that a reset calls, or a step in which no episode ends, of n environments with seeds."""
    env, found = CapsuleVectorEnv(n, max_episode_steps=NEVER, initial_noise=0.1), Counter[str]()
    env.reset(seed=0)
    actions = np.zeros((n, 1), np.float32)
    env.step(actions)

    def note(frame, event, argument):
        if event in ("call", "c_call"):
            found[frame.f_code.co_name if event == "call" else argument.__name__] += 1

    sys.setprofile(note)
    try:
        env.reset() if reset else env.step(actions)
    finally:
        sys.setprofile(None)
    env.close()
    return found


@pytest.mark.parametrize("reset", [False, True])
def test_a_step_and_a_reset_do_no_work_per_environment_in_python(reset):
    few, many = calls(64, reset=reset), calls(4096, reset=reset)
    assert few == many
    assert 10 < few.total() < 150
