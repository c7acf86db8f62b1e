"""The same bits at every level of instructions, in every batch and on any number of threads."""

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
LARGEST = max(SIZES)
STEPS = 30
ROUGH = replace(REAL, push=(0.0, 0.5), theta_resolution=0.001, torque_resolution=0.01)


def episode(n, threads, **kwargs):
    """Everything that the environments of a batch have shown, one entry per environment."""
    env = CapsuleVectorEnv(
        n, threads=threads, max_episode_steps=12, autoreset_mode="SAME_STEP", **kwargs
    )
    env.reset(seed=7)
    task_rows = range(NUM_ROWS, env.simulation.layout.task_end)
    rows = [*EPISODE_ROWS, *task_rows]
    draws = np.random.default_rng(0).uniform(-1.0, 1.0, (LARGEST, STEPS))
    actions = draws[:n].astype(np.float32)
    shown = []
    for t in range(STEPS):
        observations, rewards, terminated, _, _ = env.step(actions[:, t : t + 1])
        world = env.simulation.columns(np.arange(n))[rows].T
        shown.append(np.column_stack([observations, rewards, terminated, world]))
    return [environment.tobytes() for environment in np.stack(shown, axis=1)]


@pytest.fixture(
    scope="module",
    params=[
        *({"task": name} for name in TASKS),
        *(
            {
                "task": name,
                "controller": "baselines:gait",
                "disturbances": ROUGH,
                "randomization": "real-wide",
            }
            for name in TASKS
        ),
        {"controller": "baselines:adaptive", "residual_limit": 3.0, "observe_parameters": True},
        {"stack_size": 3, "initial_range": (1.0, 8.0), "observe_estimates": True},
    ],
    ids=lambda kwargs: f"{kwargs.get('task', '')} {kwargs.get('controller', 'direct')}".strip(),
)
def kwargs(request):
    """The arguments of an environment."""
    return request.param


@pytest.fixture(scope="module")
def expected(kwargs):
    """The episodes of the largest batch with the best instructions, on one thread."""
    return episode(LARGEST, threads=1, **kwargs)


def test_the_environments_of_a_batch_differ(expected):
    assert len(set(expected)) == LARGEST


def test_bits_do_not_depend_on_batch_and_threads(kwargs, expected, select_level):
    best_level = _core.LEVELS[0]
    select_level(best_level)
    for n in SIZES:
        threads = 1 + n % 2
        assert episode(n, threads, **kwargs) == expected[:n], n


def test_bits_do_not_depend_on_the_level(kwargs, expected, select_level):
    # In a small and a large batch: the slowest level has no fused instructions.
    for level in _core.LEVELS[1:]:
        select_level(level)
        for n in (3, LANES + 1):
            threads = 1 + n % 2
            assert episode(n, threads, **kwargs) == expected[:n], (level, n)


@pytest.mark.parametrize("level", ["v9", ""])
def test_an_unknown_level_is_named(level):
    command = [sys.executable, "-c", "import capsule_gym.core.native"]
    environment = {**os.environ, "CAPSULE_GYM_LEVEL": level}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    accepted = f"CAPSULE_GYM_LEVEL must be one of {_core.LEVELS} on this processor"
    assert done.stderr.splitlines()[-1] == f"ImportError: {accepted}, got {level!r}"


@pytest.mark.parametrize("n", [1, 65])
def test_the_world_begins_a_cache_line(n):
    assert CapsuleVectorEnv(n).simulation.world.ctypes.data % 64 == 0
