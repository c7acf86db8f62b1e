"""Laws that users write in Python: torques, threads and exceptions, compiled or not."""

import math
import os
import signal
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import numba
import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, Controller, load_policy
from capsule_gym.control import user_law
from capsule_gym.core.layout import NUM_ROWS, Row
from capsule_gym.parameters import REAL
from capsule_gym.policies.rollout import rollout
from tests.capsule_gym.fakes import picky


def controller(law):
    return Controller(getattr(law, "__name__", "own"), law, np.zeros((1, 2)))


def zeros(n):
    """Actions of a batch."""
    return np.zeros((n, 1), np.float32)


def whole(theta, theta_dot, x, x_dot, memory, reference):
    """A law that reads its whole input, with functions of numba's."""
    count, mean = memory
    mean = 0.9 * mean + 0.1 * (math.gamma(2.0 + 0.1 * theta) + math.sin(theta))
    feedback = 0.05 * mean - 0.02 * theta_dot + 0.01 * x + 0.1 * x_dot
    torque = feedback + reference[0] + 0.1 * reference[2] + 0.01 * math.cos(count)
    return torque, (count + 1.0, mean)


def torques(n, disturbances):
    """The torques of the law in an episode, alone or in a batch, shape (70, n)."""
    table = 0.05 * np.sin(np.arange(21.0).reshape(7, 3))
    made = Controller("own", whole, table, (0.0, 1.0))
    env = CapsuleVectorEnv(n, controller=made, disturbances=disturbances, residual_limit=0.5)
    env.reset(seed=3)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (70, n, 1)).astype(np.float32)
    rows = []
    for action in actions:
        env.step(action)
        rows.append(env.simulation.row(Row.law_torque))
    return np.array(rows)


@pytest.fixture
def without_numba(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)


@pytest.fixture(params=["numba", "Python"])
def either_way(request):
    """The test runs with compiled laws, and with laws that Python calls."""
    if request.param == "Python":
        request.getfixturevalue("without_numba")
    return request.param


@pytest.mark.parametrize("disturbances", ["none", "real"])
@pytest.mark.parametrize("n", [1, 70])
def test_python_gives_the_torques_of_numba_up_to_rounding(n, disturbances, monkeypatch):
    compiled = torques(n, disturbances)
    monkeypatch.setitem(sys.modules, "numba", None)
    called = torques(n, disturbances)
    # The motion amplifies the rounding.
    np.testing.assert_allclose(called, compiled, rtol=0.0, atol=1e-7)
    assert np.ptp(compiled) > 0.1


def test_an_edited_helper_is_noticed_by_the_next_controller(either_way):
    scope = {"wrapped": numba.njit if either_way == "numba" else lambda function: function}

    def law(theta, theta_dot, x, x_dot, memory, reference):
        return helper(theta), memory

    for number in (2.0, 3.0):
        exec(f"@wrapped\ndef helper(value):\n    return {number} * value", scope)
        helper = scope["helper"]
        env = CapsuleEnv(controller=controller(law), torque_limit=9.0)
        _, info = env.reset(seed=0)
        assert info["law_torque"] == number * info["state"][0]


def test_threads_that_compile_laws_and_functions_at_once_get_right_results():
    def law_of(gain):
        return lambda theta, theta_dot, x, x_dot, memory, reference: (gain * theta + x_dot, memory)

    done = threading.Event()

    def make_environments(first):
        for gain in range(first, first + 6):
            env = CapsuleEnv(controller=controller(law_of(0.1 * gain)))
            _, info = env.reset(seed=0)
            assert info["law_torque"] == 0.1 * gain * info["state"][0]

    def compile_functions():
        n = 0
        while not done.is_set():
            n += 1
            function = numba.njit(lambda value, factor=float(n): factor * value + 1.0)
            assert function(3.0) == 3.0 * n + 1.0

    with ThreadPoolExecutor(3) as pool:
        compiling = pool.submit(compile_functions)
        try:
            list(pool.map(make_environments, (0, 6)))
        finally:
            done.set()
    assert compiling.result() is None


class OwnError(Exception):
    """An exception of a law."""


def failing(theta, theta_dot, x, x_dot, memory, reference):
    (count,) = memory
    if x < -5.0 or (x > 5.0 and count >= 30.0):
        raise OwnError("too far")
    return 0.1, (count + 1.0,)


# The same controllers in all tests: a law is compiled once per controller.
FAULTY = pytest.mark.parametrize(
    ("law", "error"), [(controller(picky), ValueError), (controller(failing), OwnError)]
)
BATCHES = pytest.mark.parametrize(("n", "threads"), [(1, 1), (70, 1), (130, 2)])


def start(law, n, threads, x):
    """A batch at rest at 0, but for the environment in its middle at x (m); the latter's number."""
    lost = n // 2
    states = np.tile([-1.0, 0.0, 0.0, 0.0], (n, 1))
    states[lost, 2] = x
    env = CapsuleVectorEnv(n, controller=law, threads=threads)
    env.reset(seed=0, options={"state": states})
    return env, lost


def message(error, lost, place):
    """The message of a law that fails in an environment."""
    if error is OwnError:
        return "^too far$"
    not_finite = "^the control law 'picky' returned a torque that is not finite in environment"
    return rf"{not_finite} {lost} \({place}"


@FAULTY
@BATCHES
def test_an_exception_and_a_torque_that_is_not_finite_reach_the_caller(
    law, error, n, threads, either_way
):
    env, lost = start(law, n, threads, 5.5)
    env.step(zeros(n))
    for step in ("2", r"\d"):
        said = message(error, lost, rf"step {step}, state .*'x': 5\.\d+")
        with pytest.raises(error, match=said) as caught:
            env.step(zeros(n))
        assert "nan" not in str(caught.value)


def fail_twice(law, error, n, threads):
    """A batch in which the law of one environment has failed, a sound one, and the others."""
    env, lost = start(law, n, threads, 5.5)
    sound, _ = start(law, n, threads, 0.0)
    env.step(zeros(n))
    sound.step(zeros(n))
    for _ in range(2):
        with pytest.raises(error):
            env.step(zeros(n))
        sound.step(zeros(n))
    return env, sound, np.arange(n) != lost


@FAULTY
@BATCHES
def test_a_law_that_fails_in_one_environment_leaves_the_others_as_they_are(
    law, error, n, threads, either_way
):
    env, sound, others = fail_twice(law, error, n, threads)
    found, expected = env.simulation.rows(0, 4), sound.simulation.rows(0, 4)
    assert found[:, others].tobytes() == expected[:, others].tobytes()


@FAULTY
@BATCHES
def test_a_failed_environment_goes_on_after_a_reset_that_leaves_the_others_as_they_are(
    law, error, n, threads, either_way
):
    env, sound, others = fail_twice(law, error, n, threads)
    memory = env.simulation.row(NUM_ROWS)[others]
    observations, _ = env.reset(options={"reset_mask": ~others})
    assert np.array_equal(env.simulation.row(NUM_ROWS)[others], memory)
    assert env.observation_space.contains(observations)
    *_, info = env.step(zeros(n))
    *_, expected = sound.step(zeros(n))
    assert np.array_equal(info["state"][others], expected["state"][others])
    for name, value in info.items():
        assert name.startswith("_") or np.isfinite(value).all(), name


@FAULTY
@BATCHES
def test_a_law_that_fails_at_a_reset_gives_no_torque_until_the_next_one(
    law, error, n, threads, either_way
):
    env, lost = start(law, n, threads, 0.0)
    states = np.zeros((n, 4))
    states[lost, 2] = -5.5
    with pytest.raises(error, match=message(error, lost, r"step 0, state .*'x': -5\.5")):
        env.reset(options={"state": states})
    law_torques = env.simulation.row(Row.law_torque)
    assert np.isfinite(law_torques).all()
    assert law_torques[lost] == 0.0
    _, info = env.reset()
    assert (info["law_torque"] == 0.1).all()


@FAULTY
def test_a_single_environment_reports_them_and_goes_on_after_a_reset(law, error, either_way):
    env = CapsuleEnv(controller=law)
    action = np.zeros(1, np.float32)
    env.reset(seed=0, options={"state": [-1.0, 0.0, 5.5, 0.0]})
    env.step(action)
    for _ in range(2):
        with pytest.raises(error, match=message(error, 0, "")):
            env.step(action)
    env.reset(seed=0)
    *_, info = env.step(action)
    assert info["law_torque"] == 0.1


def test_an_exception_ends_a_rollout(either_way):
    env = CapsuleVectorEnv(3, controller=controller(failing), autoreset_mode="DISABLED")
    env.reset(seed=0, options={"state": [[-1.0, 0.0, x, 0.0] for x in (5.5, 0.0, 0.0)]})
    policy = load_policy("residual-ppo")
    with pytest.raises(OwnError, match=r"^too far$"):
        rollout(env.simulation, policy, 30)


@pytest.mark.parametrize("controls", ["both", "agent"])
def test_a_failed_law_is_called_again_with_the_same_arguments(controls, monkeypatch):
    """Compiled code swallows exceptions: the one that reaches the caller is that of a second
    call."""
    seen = []

    def law(theta, theta_dot, x, x_dot, memory, reference):
        if memory[0] >= 30.0:
            raise OwnError
        return 0.1 * theta + 0.01 * reference[3], (memory[0] + 1.0, theta, theta_dot, x, x_dot)

    def recorded(*arguments):
        seen.append(arguments)
        return law(*arguments)

    def failed_calls(function):
        """The arguments of the calls in the second step, the first in which the law fails."""
        made = Controller("own", function, np.arange(14.0).reshape(7, 2), (0.0,) * 5, task="goal")
        disturbances = replace(REAL, controls=controls)
        env = CapsuleVectorEnv(3, task="goal", controller=made, disturbances=disturbances)
        # The second call is one of Python.
        object.__setattr__(made, "law", recorded)
        env.reset(seed=1)
        env.step(zeros(3))
        seen.clear()
        with pytest.raises(OwnError):
            env.step(zeros(3))
        return list(seen)

    (again,) = failed_calls(law)
    monkeypatch.setitem(sys.modules, "numba", None)
    # In Python, the calls that fail, of three environments, are the last ones.
    called = failed_calls(recorded)[-1]
    np.testing.assert_allclose(np.hstack(again), np.hstack(called), rtol=1e-9)


def scaled(gain, theta, theta_dot, x, x_dot, memory, reference, offset=0.0):
    return gain * theta + offset, memory


def test_a_partial_is_a_law_that_numba_compiles():
    law = partial(partial(scaled, 0.5), offset=0.25)
    env = CapsuleEnv(controller=controller(law))
    _, info = env.reset(seed=0)
    assert info["law_torque"] == 0.5 * info["state"][0] + 0.25
    assert None not in user_law._compiled[env.simulation.controller].values()


@pytest.mark.parametrize("n", [1, 130])
def test_ctrl_c_in_a_law_that_python_calls_ends_the_step(n, without_numba):
    calls = []

    def law(theta, theta_dot, x, x_dot, memory, reference):
        calls.append(x)
        if len(calls) == 3 * n:
            os.kill(os.getpid(), signal.SIGINT)
            # Where the signal is handled.
            sum(range(10))
        return 0.1, memory

    env = CapsuleVectorEnv(n, controller=controller(law))
    env.reset(seed=0)
    # A process in the background of a shell ignores Ctrl-C, and so would Python.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            env.step(zeros(n))
    finally:
        signal.signal(signal.SIGINT, before)
    # No further environment is asked.
    assert len(calls) <= 3 * n + 1
    env.reset(seed=0)
    observations, *_ = env.step(zeros(n))
    assert np.isfinite(observations).all()


@pytest.mark.usefixtures("without_numba")
def test_calls_of_a_law_leave_no_objects_behind():
    env = CapsuleEnv(controller=controller(partial(scaled, 0.1)))
    env.reset(seed=0)
    blocks = []
    for _ in range(30):
        # A step calls the law ten times.
        env.step(np.zeros(1, np.float32))
        blocks.append(sys.getallocatedblocks())
    assert blocks[-1] - blocks[9] < 100


@pytest.mark.usefixtures("without_numba")
def test_an_interrupted_step_leaves_no_exception_to_a_later_one():
    law = Mock([], return_value=(0.1, (0.0,)))
    env = CapsuleVectorEnv(2, controller=controller(law))
    env.reset(seed=0)
    not_finite = [(np.nan, (0.0,))] * 9
    law.side_effect = ValueError("an earlier step"), KeyboardInterrupt(), *not_finite
    with pytest.raises(KeyboardInterrupt):
        env.step(zeros(2))
    with pytest.raises(ValueError, match="finite"):
        env.step(zeros(2))
