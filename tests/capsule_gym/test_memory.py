"""An allocation that fails raises an error, leaves no file, and the next call works."""

from functools import partial

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, Controller, identify
from tests.capsule_gym.policies.test_policy import make_policy

testcapi = pytest.importorskip("_testcapi")

# Which allocation fails: every one of the first, then fewer of the later.
COUNTS = np.unique(np.geomspace(1, 30_000, 150).astype(int)).tolist()


def fails(call, count):
    """Whether a call in which this allocation fails raises an error.

    Functions of Python itself raise a TypeError, SystemError or RuntimeError, too.
    """
    testcapi.set_nomemory(count, count + 1)
    try:
        call()
    except Exception:
        return True
    finally:
        testcapi.remove_mem_hooks()
    return False


def push(theta, theta_dot, x, x_dot, memory, row):
    return 0.1 * theta, (memory[0] + 1.0,)


def plain_law():
    """A law that Python calls."""
    return Controller("plain", push, np.zeros((1, 2)))


def make():
    return CapsuleEnv(task="goal", disturbances="real", observe_estimates=True)


def make_batch():
    return CapsuleVectorEnv(130, controller="baselines:adaptive")


def reset(env):
    return lambda: env.reset(seed=0)


def step(env):
    actions = np.zeros(env.action_space.shape, np.float32)
    env.reset(seed=0)
    return lambda: env.step(actions)


# Not `load_policy`: the reader of safetensors, in Rust, panics.
CALLS = {
    "make": lambda: make,
    "make a batch": lambda: make_batch,
    "reset": lambda: reset(make()),
    "reset a batch": lambda: reset(make_batch()),
    "step": lambda: step(make()),
    "step a batch": lambda: step(make_batch()),
    "step with a law in Python": lambda: step(CapsuleEnv(controller=plain_law())),
}


@pytest.fixture
def without_numba(monkeypatch):
    """Python calls the laws of users."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)


@pytest.mark.usefixtures("without_numba")
@pytest.mark.parametrize("name", CALLS)
def test_an_allocation_that_fails_raises_an_error(name):
    call = CALLS[name]()
    call()
    failed = 0
    for count in COUNTS:
        failed += fails(call, count)
        call()
    assert failed > 5


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_identification_whose_allocation_fails_raises_an_error():
    t = 0.01 * np.arange(300)
    call = partial(identify, {"t": t, "torque": np.sin(t), "theta": np.sin(9.0 * t)})
    expected = call().estimates
    assert sum(fails(call, count) for count in COUNTS[::10]) > 5
    assert call().estimates == expected


def test_a_file_whose_writing_fails_stays_as_it_was(tmp_path):
    policy = make_policy()
    path = tmp_path / "policy.safetensors"
    policy.save(path)
    before = path.read_bytes()
    failed = sum(fails(partial(policy.save, path), count) for count in COUNTS)
    assert failed > 10
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
