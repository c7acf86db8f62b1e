"""Stepping does not grow memory."""

import gc
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv

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
    env = CapsuleVectorEnv(BATCH, max_episode_steps=10**9, threads=2) if num_envs else CapsuleEnv()
    env.reset(seed=0)
    actions = np.zeros((BATCH, 1) if num_envs else 1, np.float32)
    # One reference kept per step would take 4 kB.
    assert growth(lambda: env.step(actions)) < 4_000
    env.close()
