"""One core: the same bits at every level of instructions, in batches of every size, and on any
number of threads."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from capsule_gym import CapsuleVectorEnv
from capsule_gym.core import _core
from capsule_gym.core.layout import LANES, NUM_ROWS
from capsule_gym.parameters import REAL
from capsule_gym.tasks.registry import TASKS
from tests.capsule_gym.fakes import EPISODE_ROWS

SIZES = (1, 3, LANES, LANES + 1, 2 * LANES + 2)
STEPS = 30
ROUGH = replace(REAL, push=(0.0, 0.5), theta_resolution=0.001, torque_resolution=0.01)
CASES = {
    **{f"{name}, direct": {"task": name} for name in TASKS},
    **{f"{name}, law and disturbances": {
        "task": name, "controller": "baselines:gait", "disturbances": ROUGH, "randomization": "real-wide"
    } for name in TASKS},
    "adaptive": {"controller": "baselines:adaptive", "residual_limit": 3.0, "observe_parameters": True},
    "stack": {"stack_size": 3, "initial_range": (1.0, 8.0), "observe_estimates": True},
}  # fmt: skip


def episode(n, threads, **kwargs):
    """Everything that the environments of a batch have shown, one entry per environment."""
    env = CapsuleVectorEnv(
        n, threads=threads, max_episode_steps=12, autoreset_mode="SAME_STEP", **kwargs
    )
    env.reset(seed=7)
    actions = (
        np.random.default_rng(0).uniform(-1.0, 1.0, (max(SIZES), STEPS)).astype(np.float32)[:n]
    )
    shown = []
    for t in range(STEPS):
        observations, rewards, terminated, _, _ = env.step(actions[:, t : t + 1])
        world = env.simulation.columns(np.arange(n))[
            [*EPISODE_ROWS, *range(NUM_ROWS, env.simulation.layout.task_end)]
        ].T
        shown.append(
            np.concatenate([observations, rewards[:, None], terminated[:, None], world], axis=1)
        )
    return [np.array(shown)[:, i].tobytes() for i in range(n)]


@pytest.mark.parametrize("kwargs", CASES.values(), ids=CASES)
def test_bits_do_not_depend_on_level_batch_and_threads(kwargs, select_level):
    expected = episode(max(SIZES), 1, **kwargs)
    assert len(set(expected)) == len(expected)
    for level in _core.LEVELS:
        select_level(level)
        # The slowest level, without fused instructions, in a small and a large batch.
        for n in SIZES if level == _core.LEVELS[0] else (3, LANES + 1):
            assert episode(n, 1 + n % 2, **kwargs) == expected[:n], (level, n)


def test_an_unknown_level_is_named():
    command = [sys.executable, "-c", "import capsule_gym.core.native"]
    for level in ("v9", ""):
        environment = {**os.environ, "CAPSULE_GYM_LEVEL": level}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        said = f"ImportError: CAPSULE_GYM_LEVEL must be one of {_core.LEVELS} on this processor, got {level!r}"
        assert done.stderr.splitlines()[-1] == said


@pytest.mark.parametrize("n", [1, 65])
def test_the_world_begins_a_cache_line(n):
    assert CapsuleVectorEnv(n).simulation.world.ctypes.data % 64 == 0
