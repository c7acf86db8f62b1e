"""Laws that users write in Python: compiled by numba or called by Python, the same torques, and
their exceptions."""

import math
import os
import signal
import sys
import threading
from concurrent.futures import ThreadPoolExecutor, wait
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


def whole(theta, theta_dot, x, x_dot, memory, reference):
    """A law that reads its whole input, with functions of numba's."""
    count, mean = memory
    mean = 0.9 * mean + 0.1 * (math.gamma(2.0 + 0.1 * theta) + math.sin(theta))
    torque = (
        0.05 * mean - 0.02 * theta_dot + 0.01 * x + 0.1 * x_dot + reference[0] + 0.1 * reference[2]
    )
    return torque + 0.01 * math.cos(count), (count + 1.0, mean)


def torques(n, disturbances):
    """The torques of the law in an episode, alone or in a batch, shape (steps, n)."""
    made = Controller("own", whole, 0.05 * np.sin(np.arange(21.0).reshape(7, 3)), (0.0, 1.0))
    env = CapsuleVectorEnv(n, controller=made, disturbances=disturbances, residual_limit=0.5)
    env.reset(seed=3)
    rows = []
    for actions in np.random.default_rng(0).uniform(-1.0, 1.0, (70, 60)).astype(np.float32)[:n].T:
        env.step(actions[:, None])
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
    compiled = sys.modules["numba"] is not None
    scope = {"wrapped": numba.njit if compiled else lambda function: function}

    def law(theta, theta_dot, x, x_dot, memory, reference):
        return helper(theta), memory

    for number in (2.0, 3.0):
        exec(f"@wrapped\ndef helper(value):\n    return {number} * value", scope)
        helper = scope["helper"]
        env = CapsuleEnv(controller=Controller("own", law, np.zeros((1, 2))), torque_limit=9.0)
        _, info = env.reset(seed=0)
        assert info["law_torque"] == number * info["state"][0]


def test_threads_that_compile_laws_and_functions_at_once_get_right_results():
    def law_of(gain):
        return lambda theta, theta_dot, x, x_dot, memory, reference: (gain * theta + x_dot, memory)

    wrong, done = [], threading.Event()

    def make_environments(first):
        for gain in range(first, first + 6):
            env = CapsuleEnv(controller=Controller("own", law_of(0.1 * gain), np.zeros((1, 2))))
            _, info = env.reset(seed=0)
            if info["law_torque"] != 0.1 * gain * info["state"][0]:
                wrong.append(gain)

    def compile_functions():
        n = 0
        while not done.is_set():
            n += 1
            function = numba.njit(lambda value, factor=float(n): factor * value + 1.0)
            if function(3.0) != 3.0 * n + 1.0:
                wrong.append(f"function {n}")

    with ThreadPoolExecutor(3) as pool:
        last = pool.submit(compile_functions)
        made = wait([pool.submit(make_environments, first) for first in (0, 6)]).done
        done.set()
    assert not wrong and [each.result() for each in (last, *made)] == [None] * 3


class OwnError(Exception):
    """An exception of a law."""


def failing(theta, theta_dot, x, x_dot, memory, reference):
    (count,) = memory
    if x < -5.0 or (x > 5.0 and count >= 30.0):
        raise OwnError("too far")
    return 0.1, (count + 1.0,)


NOT_FINITE = r"^the control law 'picky' returned a torque that is not finite in environment"


@pytest.mark.parametrize(("law", "error"), [(picky, ValueError), (failing, OwnError)])
@pytest.mark.parametrize(("n", "threads"), [(1, 1), (70, 1), (130, 2)])
def test_an_exception_and_a_torque_that_is_not_finite_reach_the_caller(
    law, error, n, threads, either_way
):
    made = Controller(law.__name__, law, np.zeros((1, 2)))
    env, sound = (CapsuleVectorEnv(n, controller=made, threads=threads) for _ in range(2))
    lost, zeros, states = (
        n // 2,
        np.zeros((n, 1), np.float32),
        np.tile([-1.0, 0.0, 0.0, 0.0], (n, 1)),
    )
    others = np.arange(n) != lost
    sound.reset(seed=0, options={"state": states})
    states[lost, 2] = 5.5
    env.reset(seed=0, options={"state": states})
    env.step(zeros)
    sound.step(zeros)
    for step in ("2", r"\d"):
        said = (
            rf"{NOT_FINITE} {lost} \(step {step}, state .*'x': 5\.\d+"
            if error is ValueError
            else "^too far$"
        )
        with pytest.raises(error, match=said) as caught:
            env.step(zeros)
        sound.step(zeros)
        assert "nan" not in str(caught.value)
    assert (
        env.simulation.rows(0, 4)[:, others].tobytes()
        == sound.simulation.rows(0, 4)[:, others].tobytes()
    )
    # The failed environment continues after a reset, which leaves the memory of the others as it
    # is.
    memory = env.simulation.row(NUM_ROWS)[others]
    observations, _ = env.reset(options={"reset_mask": ~others})
    assert np.array_equal(env.simulation.row(NUM_ROWS)[others], memory)
    assert env.observation_space.contains(observations)
    info = env.step(zeros)[4]
    assert all(np.isfinite(value).all() for name, value in info.items() if name[0] != "_")
    assert np.array_equal(info["state"][others], sound.step(zeros)[4]["state"][others])
    states[lost, 2] = -5.5
    said = (
        rf"{NOT_FINITE} {lost} \(step 0, state .*'x': -5\.5" if error is ValueError else "^too far$"
    )
    with pytest.raises(error, match=said):
        env.reset(options={"state": states})
    assert (
        np.isfinite(env.simulation.row(Row.law_torque)).all()
        and env.simulation.row(Row.law_torque)[lost] == 0.0
    )
    assert (env.reset()[1]["law_torque"] == 0.1).all()


@pytest.mark.parametrize(("law", "error"), [(picky, ValueError), (failing, OwnError)])
def test_a_single_environment_reports_them_and_goes_on_after_a_reset(law, error, either_way):
    env, action = (
        CapsuleEnv(controller=Controller(law.__name__, law, np.zeros((1, 2)))),
        np.zeros(1, np.float32),
    )
    env.reset(seed=0, options={"state": [-1.0, 0.0, 5.5, 0.0]})
    env.step(action)
    for _ in range(2):
        with pytest.raises(error, match="too far" if error is OwnError else f"{NOT_FINITE} 0"):
            env.step(action)
    env.reset(seed=0)
    assert env.step(action)[4]["law_torque"] == 0.1


def test_an_exception_ends_a_rollout(either_way):
    env = CapsuleVectorEnv(
        3, controller=Controller("failing", failing, np.zeros((1, 2))), autoreset_mode="DISABLED"
    )
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

    table = np.arange(14.0).reshape(7, 2)
    calls = []
    for function in (law, recorded):
        if function is recorded:
            monkeypatch.setitem(sys.modules, "numba", None)
        made = Controller("own", function, table, (0.0,) * 5, task="goal")
        env = CapsuleVectorEnv(
            3, task="goal", controller=made, disturbances=replace(REAL, controls=controls)
        )
        object.__setattr__(made, "law", recorded)
        env.reset(seed=1)
        env.step(np.zeros((3, 1), np.float32))
        seen.clear()
        with pytest.raises(OwnError):
            env.step(np.zeros((3, 1), np.float32))
        calls.append(list(seen))
    (again,), called = calls
    # In Python, the calls that fail, of three environments, are the last ones.
    np.testing.assert_allclose(np.hstack(again), np.hstack(called[-1]), rtol=1e-9)


def scaled(gain, theta, theta_dot, x, x_dot, memory, reference, offset=0.0):
    return gain * theta + offset, memory


def test_a_partial_is_a_law_that_numba_compiles():
    env = CapsuleEnv(
        controller=Controller(
            "scaled", partial(partial(scaled, 0.5), offset=0.25), np.zeros((1, 2))
        )
    )
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

    env = CapsuleVectorEnv(n, controller=Controller("long", law, np.zeros((1, 2))))
    env.reset(seed=0)
    # A process in the background of a shell ignores Ctrl-C, and so would Python.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            env.step(np.zeros((n, 1), np.float32))
    finally:
        signal.signal(signal.SIGINT, before)
    # No further environment is asked.
    assert len(calls) <= 3 * n + 1
    env.reset(seed=0)
    assert np.isfinite(env.step(np.zeros((n, 1), np.float32))[0]).all()


@pytest.mark.usefixtures("without_numba")
def test_calls_of_a_law_leave_no_objects_behind():
    env = CapsuleEnv(controller=Controller("scaled", partial(scaled, 0.1), np.zeros((1, 2))))
    env.reset(seed=0)
    # A step calls the law ten times.
    blocks = [env.step(np.zeros(1, np.float32)) and sys.getallocatedblocks() for _ in range(30)]
    assert blocks[-1] - blocks[9] < 100


@pytest.mark.usefixtures("without_numba")
def test_an_interrupted_step_leaves_no_exception_to_a_later_one():
    law = Mock([], return_value=(0.1, (0.0,)))
    env = CapsuleVectorEnv(2, controller=Controller("broken", law, np.zeros((1, 2))))
    env.reset(seed=0)
    law.side_effect = ValueError("an earlier step"), KeyboardInterrupt(), *[(np.nan, (0.0,))] * 9
    for error, message in ((KeyboardInterrupt, None), (ValueError, "finite")):
        with pytest.raises(error, match=message):
            env.step(np.zeros((2, 1), np.float32))
