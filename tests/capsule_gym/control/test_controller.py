import math
import pickle
import re
from types import SimpleNamespace

import numba
import numpy as np
import pytest

from capsule_gym import CapsuleEnv, Controller
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.laws import LAWS
from capsule_gym.control.laws.gains import plant_constants
from capsule_gym.control.laws.periodic import oscillator
from capsule_gym.control.lookup import find_controller
from capsule_gym.core.layout import NUM_ROWS
from capsule_gym.parameters import NOMINAL
from capsule_gym.tasks.task import TORQUE_LIMIT
from tests.capsule_gym.fakes import picky_controller

NO_REFERENCE = np.zeros((1, 2))


def test_a_law_is_called_at_the_start_and_after_each_interval():
    env = CapsuleEnv(controller=picky_controller)
    env.reset(seed=0)
    env.step(np.zeros(1, np.float32))
    assert env.simulation.world[0, NUM_ROWS, 0] == 21.0


def no_torque(*state):
    return 0.0, state[4]


def law_of(gain):
    return lambda theta, theta_dot, x, x_dot, memory, reference: (gain * theta, memory)


COLUMN = np.zeros(3)


@numba.njit
def law_of_a_column(theta, theta_dot, x, x_dot, memory, reference):
    return COLUMN[int(reference[1])], memory


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"law": "law"}, TypeError, r"^Controller\.law must be a function"),
        ({"law": lambda theta: 0.0}, TypeError, "law"),
        ({"law": lambda *state: (0.0, (1.0, 2.0))}, ValueError, "law"),
        ({"law": lambda *state: (math.nan, state[4])}, ValueError, "law"),
        # The trial call checks the indices of a compiled law.
        (
            {"law": law_of_a_column, "reference": np.array([[0.0, 7.0]])},
            TypeError,
            "index 7 is out of bounds",
        ),
        ({"dt": 0.0}, ValueError, r"^Controller\.dt must be a finite number > 0 \(s\), got 0\.0"),
    ],
)
def test_a_controller_that_breaks_the_contract_is_refused(changes, error, message):
    with pytest.raises(error, match=message):
        Controller(**{"name": "bad", "law": no_torque, "reference": NO_REFERENCE, **changes})


@pytest.mark.parametrize(
    ("gain", "error"), [(10**400, ValueError), (1j, TypeError), ([], TypeError)]
)
def test_a_law_whose_trial_call_fails_is_refused(gain, error):
    with pytest.raises(error, match=r"^the control law of 'bad' must .* trial call"):
        Controller("bad", law_of(gain), NO_REFERENCE)


@pytest.mark.parametrize(
    "table",
    [
        np.zeros(3),
        np.zeros((0, 2)),
        np.zeros((4, 1)),
        np.full((2, 2), np.nan),
        np.zeros((2, 257)),
        np.broadcast_to(np.zeros(2), (10**12, 2)),
        np.broadcast_to(np.zeros(256), (10**5, 256)),
        [[0.0, 10**400]],
        [["a", "b"]],
        [[1.0], [1.0, 2.0]],
        None,
    ],
)
def test_an_invalid_reference_is_refused(table):
    message = r"^Controller\.reference must be a table of finite numbers"
    with pytest.raises(ValueError, match=message):
        Controller("bad", no_torque, table)


@pytest.mark.parametrize(
    ("memory", "error"),
    [((), ValueError), ((10**400,), ValueError), (0.0, TypeError), (("a",), TypeError)],
)
def test_an_invalid_memory_is_refused(memory, error):
    message = r"^Controller\.memory must be a tuple of 1 to 256 finite numbers"
    with pytest.raises(error, match=message):
        Controller("bad", no_torque, NO_REFERENCE, memory)


def importing(theta, theta_dot, x, x_dot, memory, reference):
    import math

    return math.sin(theta), memory


class Squared:
    """A law that is an object."""

    def __call__(self, theta, theta_dot, x, x_dot, memory, reference):
        return 0.3 * theta * abs(theta), memory


SETTINGS = SimpleNamespace(gain=1.0)


@pytest.mark.parametrize(
    ("law", "cause"),
    [
        (law_of(np.float16(2.0)), "float16'"),
        (Squared(), ""),
        (importing, r"IMPORT_NAME\) found. Raised from .* \(\d+\)"),
        (
            lambda *state: (SETTINGS.gain * state[0], state[4]),
            r"'SETTINGS': .* \(test_controller\.py, line \d+\)",
        ),
    ],
)
def test_a_law_that_numba_cannot_compile_is_named_and_called_by_python(law, cause):
    message = rf"^Python calls the control law 'odd', .* cannot compile it: .*{cause}$"
    with pytest.warns(UserWarning, match=message) as warned:
        env = CapsuleEnv(controller=Controller("odd", law, NO_REFERENCE))
    (warning,) = warned
    assert "\n" not in str(warning.message)
    _, info = env.reset(seed=0)
    torque, _ = law(*info["state"], (0.0,), (0.0, 0.0))
    assert info["law_torque"] == np.clip(torque, -TORQUE_LIMIT, TORQUE_LIMIT)


def own():
    return Controller("own", no_torque, NO_REFERENCE)


def test_a_reference_is_a_copy_that_cannot_be_written():
    table = np.zeros((256, 2)).T
    controller = Controller("largest", no_torque, table, (0.0,) * 256)
    assert table.flags.writeable
    assert not controller.reference.flags.writeable
    # Its rows are those that the core reads.
    assert controller.reference.flags.c_contiguous
    assert not np.shares_memory(table, controller.reference)


def test_a_controller_is_found_in_every_form():
    controller = own()
    assert find_controller(None) is None
    assert find_controller(controller) is controller
    assert find_controller(own).name == "own"
    assert find_controller(f"{__name__}:own").name == "own"


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ("baselines", TypeError, "module:attribute"),
        ("nowhere.at_all:law", ValueError, "No module named 'nowhere'"),
        ("math:sin", TypeError, "whose call fails: math.sin() takes"),
        (lambda: Controller("odd", print, [[]]), ValueError, "controller must be None, a Control"),
    ],
)
def test_a_wrong_controller_is_named(given, error, message):
    with pytest.raises(error, match=re.escape(message)):
        find_controller(given)


def test_many_calls_of_a_law_of_the_core_are_single_calls():
    law = oscillator().law
    rng = np.random.default_rng(0)
    states = rng.normal(0.0, 0.3, (5, 4))
    memories = rng.normal(0.0, 1.0, (5, law.cells))
    given = memories.copy()
    torques, renewed = law.evaluate(states, memories, np.zeros((5, 2)))
    for n, state in enumerate(states.tolist()):
        single = law(*state, tuple(given[n].tolist()), (0.0, 0.0))
        assert single == (torques[n], tuple(renewed[n].tolist()))
    assert len(set(torques.tolist())) == 5
    assert np.array_equal(memories, given)


def test_the_order_of_the_constants_does_not_matter():
    constants = {**plant_constants(NOMINAL.plant()), "K_p": 400.0, "K_v": 40.0}
    backwards = dict(reversed(constants.items()))
    law = CoreLaw("feedback_linearising", **constants)
    assert law == CoreLaw("feedback_linearising", **backwards)
    assert law == pickle.loads(pickle.dumps(law))


@pytest.mark.parametrize("name", LAWS)
def test_a_zero_residual_gives_the_torques_of_the_law_alone_bit_for_bit(name):
    controller = find_controller(f"baselines:{name}")
    task = controller.task or "speed"
    env = CapsuleEnv(controller=controller, task=task, control_dt=1e-3, residual_limit=3.0)
    layout = env.simulation.layout
    _, info = env.reset(seed=0)
    memory = controller.memory
    task_memory = env.simulation.world[0, layout.task : layout.task_end, 0]
    seen = task_memory.copy()
    for n in range(800):
        row = controller.reference[n % len(controller.reference)]
        torque, memory = controller.law(*info["state"], memory, (*row, *seen))
        # The law is called before the task's memory changes.
        seen = task_memory.copy()
        law_torque = info["law_torque"]
        _, _, terminated, _, info = env.step(np.zeros(1))
        assert law_torque == np.clip(torque, -TORQUE_LIMIT, TORQUE_LIMIT)
        assert info["torque"] == law_torque
        if terminated:
            break
    assert n > 90
