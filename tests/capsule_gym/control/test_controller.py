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
from tests.capsule_gym.fakes import picky_controller


def test_a_law_is_called_at_the_start_and_after_each_interval():
    env = CapsuleEnv(controller=picky_controller)
    env.reset(seed=0)
    env.step(np.zeros(1, np.float32))
    assert env.simulation.world[0, NUM_ROWS, 0] == 21.0


def law_of(gain):
    return lambda theta, theta_dot, x, x_dot, memory, reference: (gain * theta, memory)


COLUMN = np.zeros(3)
compiled = numba.njit(
    lambda theta, theta_dot, x, x_dot, memory, reference: (COLUMN[int(reference[1])], memory)
)
GAINS = [(10**400, ValueError), (1j, TypeError), ([], TypeError)]
TRIAL = r"^the control law of 'bad' must .* trial call"
TABLE = r"^Controller\.reference must be a table of finite numbers"
MEMORY = r"^Controller\.memory must be a tuple of 1 to 256 finite numbers"
HUGE = np.broadcast_to(np.zeros(2), (10**12, 2))
TABLES = [
    np.zeros(3),
    np.zeros((0, 2)),
    np.zeros((4, 1)),
    np.full((2, 2), np.nan),
    np.zeros((2, 257)),
    HUGE,
]
TABLES += [[[0.0, 10**400]], [["a", "b"]], [[1.0], [1.0, 2.0]], None]
MEMORIES = [((), ValueError), ((10**400,), ValueError), (0.0, TypeError), (("a",), TypeError)]
BROKEN = [
    ({"law": "law"}, TypeError, r"^Controller\.law must be a function"),
    ({"law": lambda theta: 0.0}, TypeError, "law"),
    ({"law": lambda *state: (0.0, (1.0, 2.0))}, ValueError, "law"),
    ({"law": lambda *state: (math.nan, state[4])}, ValueError, "law"),
    *(({"law": law_of(gain)}, error, TRIAL) for gain, error in GAINS),
    # The trial call checks the indices of a compiled law.
    ({"law": compiled, "reference": np.array([[0.0, 7.0]])}, TypeError, "index 7 is out of bounds"),
    *(({"reference": table}, ValueError, TABLE) for table in TABLES),
    *(({"memory": memory}, error, MEMORY) for memory, error in MEMORIES),
    ({"dt": 0.0}, ValueError, r"^Controller\.dt must be a finite number > 0 \(s\), got 0\.0"),
]


@pytest.mark.parametrize(("changes", "error", "said"), BROKEN)
def test_what_breaks_the_contract_is_refused(changes, error, said):
    with pytest.raises(error, match=said):
        Controller(
            **{
                "name": "bad",
                "law": lambda *state: (0.0, state[4]),
                "reference": np.zeros((1, 2)),
                **changes,
            }
        )


def importing(theta, theta_dot, x, x_dot, memory, reference):
    import math

    return math.sin(theta), memory


class Squared:
    """A law that is an object."""

    def __call__(self, theta, theta_dot, x, x_dot, memory, reference):
        return 0.3 * theta * abs(theta), memory


SETTINGS = SimpleNamespace(gain=1.0)
ODD = [
    (law_of(np.float16(2.0)), "float16'"),
    (Squared(), ""),
    (importing, r"IMPORT_NAME\) found. Raised from .* \(\d+\)"),
    (
        lambda *state: (SETTINGS.gain * state[0], state[4]),
        r"'SETTINGS': .* \(test_controller\.py, line \d+\)",
    ),
]


@pytest.mark.parametrize(("law", "cause"), ODD)
def test_a_law_that_numba_cannot_compile_is_named_and_called_by_python(law, cause):
    message = rf"^Python calls the control law 'odd', .* cannot compile it: .*{cause}$"
    with pytest.warns(UserWarning, match=message) as said:
        env = CapsuleEnv(controller=Controller("odd", law, np.zeros((1, 2))))
    assert len(said) == 1 and "\n" not in str(said[0].message)
    _, info = env.reset(seed=0)
    assert info["law_torque"] == np.clip(law(*info["state"], (0.0,), (0.0, 0.0))[0], -1.5, 1.5)


def own():
    return Controller("own", lambda *arguments: (0.0, arguments[4]), np.zeros((1, 2)))


def test_a_controller_is_found_in_every_form():
    made, table = own(), np.zeros((1, 256))
    largest = Controller("largest", made.law, table, (0.0,) * 256).reference
    assert (
        table.flags.writeable
        and not largest.flags.writeable
        and not np.shares_memory(table, largest)
    )
    assert (find_controller(None), find_controller(made)) == (None, made)
    assert find_controller(own).name == find_controller(f"{__name__}:own").name == "own"


NONE = [
    ("baselines", TypeError, "module:attribute"),
    ("nowhere.at_all:law", ValueError, "No module named 'nowhere'"),
    ("math:sin", TypeError, "whose call fails: math.sin() takes"),
    (lambda: Controller("odd", print, [[]]), ValueError, "controller must be None, a Controller"),
]


@pytest.mark.parametrize(("given", "error", "said"), NONE)
def test_what_is_no_controller_is_named(given, error, said):
    with pytest.raises(error, match=re.escape(said)):
        find_controller(given)


def test_many_calls_of_a_law_of_the_core_are_single_calls():
    law = oscillator().law
    rng = np.random.default_rng(0)
    states, memories, rows = (
        rng.normal(0.0, 0.3, (5, 4)),
        rng.normal(0.0, 1.0, (5, law.cells)),
        np.zeros((5, 2)),
    )
    torques, renewed = law.evaluate(states, memories, rows)
    single = [
        law(*s, m, r)
        for s, m, r in zip(states.tolist(), memories.tolist(), rows.tolist(), strict=True)
    ]
    assert list(zip(torques.tolist(), map(tuple, renewed.tolist()), strict=True)) == single
    assert len(set(torques.tolist())) == 5
    # The arguments are unchanged, and the order of the constants in the call does not matter.
    assert renewed is not memories
    gains = {**plant_constants(NOMINAL.plant()), "K_p": 400.0, "K_v": 40.0}.items()
    one, other = (
        CoreLaw("feedback_linearising", **dict(order(gains))) for order in (iter, reversed)
    )
    assert one == other and pickle.loads(pickle.dumps(law)) == law


@pytest.mark.parametrize("name", LAWS)
def test_a_zero_residual_gives_the_torques_of_the_law_alone_bit_for_bit(name):
    made = find_controller(f"baselines:{name}")
    env = CapsuleEnv(
        controller=made, task=made.task or "speed", control_dt=1e-3, residual_limit=3.0
    )
    simulation, memory, (_, info) = env.simulation, made.memory, env.reset(seed=0)
    task_memory = simulation.world[0, simulation.layout.task : simulation.layout.task_end, 0]
    own = task_memory.copy()
    for n in range(800):
        torque, memory = made.law(
            *info["state"], memory, (*made.reference[n % len(made.reference)], *own)
        )
        # The law is called before the task's memory changes.
        own = task_memory.copy()
        law_torque, (_, _, terminated, _, info) = info["law_torque"], env.step(np.zeros(1))
        assert law_torque == info["torque"] == np.clip(torque, -1.5, 1.5)
        if terminated:
            break
    assert n > 90
