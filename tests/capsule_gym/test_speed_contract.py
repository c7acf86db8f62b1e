import gc
import tracemalloc

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv

BATCH = 130


@pytest.mark.parametrize("num_envs", [None, BATCH])
def test_stepping_does_not_grow_memory(num_envs):
    env = CapsuleVectorEnv(BATCH, max_episode_steps=10**9, threads=2) if num_envs else CapsuleEnv()
    env.reset(seed=0)
    actions = np.zeros((BATCH, 1) if num_envs else 1, np.float32)
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
