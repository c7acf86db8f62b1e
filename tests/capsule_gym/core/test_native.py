"""Calls of the core: the number and the types of arguments are those of the C++ function."""

import gc
import importlib.util
import re

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, dynamics
from capsule_gym.control.laws.profiles import platform_motion
from capsule_gym.core import _core, native
from capsule_gym.parameters import Capsule

CAPSULE = Capsule().plant()
PLANT = native.ordered(_core.PLANT, CAPSULE._asdict())
ARRAY = np.zeros((3, 3))


def motion_arguments(**others):
    """The arguments of `platform_motion`; `others` replace some."""
    address = native.address(ARRAY)
    arguments = {
        "angle": address,
        "velocity": address,
        "acceleration": address,
        "n": 3,
        "h": 1e-3,
        "plant": native.address(PLANT),
        "motion": address,
    }
    return (arguments | others).values()


@pytest.fixture(params=["call", "call_locked"])
def call(request):
    return getattr(_core, request.param)


def test_a_function_without_result_returns_minus_one(call):
    assert call("platform_motion", *motion_arguments()) == -1


ADDRESS = "the address of an array (int)"
REAL = "a float or an int"
WHOLE = "an int of 64 bits"


@pytest.mark.parametrize(
    ("name", "given", "place", "due"),
    [
        ("angle", 1.0, 1, ADDRESS),
        ("angle", None, 1, ADDRESS),
        ("velocity", "v", 2, ADDRESS),
        ("acceleration", 2**63, 3, ADDRESS),
        ("n", 3.0, 4, WHOLE),
        ("n", np.int64(3), 4, WHOLE),
        ("n", 2**63, 4, WHOLE),
        ("n", -(2**63) - 1, 4, WHOLE),
        ("n", b"3", 4, WHOLE),
        ("h", "1e-3", 5, REAL),
        ("h", None, 5, REAL),
        ("h", 1j, 5, REAL),
        ("h", np.float32(0.5), 5, REAL),
        ("h", 10**400, 5, REAL),  # the message is shortened
        ("plant", 0.5, 6, ADDRESS),
        ("motion", [0], 7, ADDRESS),
    ],
)
def test_an_argument_of_another_type_names_its_place(call, name, given, place, due):
    with pytest.raises(TypeError) as raised:
        call("platform_motion", *motion_arguments(**{name: given}))
    shown = repr(given)[:100]
    message = f"argument {place} of platform_motion must be {due}, got {shown}"
    assert str(raised.value) == message


@pytest.mark.parametrize("count", [0, 1, 6, 8, 20])
def test_another_number_of_arguments_names_both_numbers(call, count):
    with pytest.raises(TypeError, match=f"^platform_motion takes 7 arguments, got {count}$"):
        call("platform_motion", *[0] * count)


@pytest.mark.parametrize("arguments", [(), (1,), (None, 2), ("\ud800",)])
def test_a_call_needs_the_name_of_a_function(call, arguments):
    message = r"^call takes the name of a function \(str\) and its arguments$"
    with pytest.raises(TypeError, match=message):
        call(*arguments)


@pytest.mark.parametrize("name", ["", "step_on", "step_one ", "find"])
def test_an_unknown_function_is_named(call, name):
    with pytest.raises(ValueError, match=f"^the core has no function '{name}'$"):
        call(name, 1, 2.0)


@pytest.mark.parametrize(
    ("given", "exact"), [(1, 1.0), (0, 0.0), (-3, -3.0), (True, 1.0), (np.float64(0.3), 0.3)]
)
def test_a_real_number_can_be_an_int(given, exact):
    n = 4
    pendulum = [np.linspace(0.0, 1.0, n), np.ones(n), np.full(n, 40.0)]
    found = np.zeros((3, n))
    native.call("platform_motion", *pendulum, n, given, PLANT, found)
    assert np.array_equal(found, platform_motion(*pendulum, exact, CAPSULE))
    assert found[2].any()


def test_a_whole_number_can_be_a_bool():
    angle = native.address(np.zeros(1))
    results = native.address(np.zeros(2))
    assert _core.call("sincos", angle, True, results, True, False) == 2


@pytest.mark.parametrize("numbers", [(), (0.1, 0.2)])
def test_another_number_of_numbers_is_an_error(numbers):
    message = f"^argument 2 of sincos must be 1, the count of its numbers, got {len(numbers)}$"
    with pytest.raises(TypeError, match=message):
        native.evaluate("sincos", *numbers)


STATE = (0.5, 0.1, 0.2, 3.0, 4.0)


def test_a_function_of_the_plant_takes_a_plant():
    (force,) = native.evaluate("normal_force", *STATE, plant=PLANT)
    assert force > 0.0


def test_a_function_of_the_plant_needs_a_plant():
    message = "^argument 5 of normal_force must be the address of a plant, got 0$"
    with pytest.raises(TypeError, match=message):
        native.evaluate("normal_force", *STATE)


def test_another_function_takes_no_plant():
    message = "^argument 5 of exp must be 0, since it needs no plant, got [0-9]+$"
    with pytest.raises(TypeError, match=message):
        native.evaluate("exp", 0.5, plant=PLANT)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_position_does_not_change_the_phase(direction):
    assert dynamics.contact_phase(-1.0, 0.0, 0.3 * direction, 0.2, CAPSULE) == direction


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "trace takes 3 arguments, got 0"),
        (("exp", 0, 0, 0), "trace takes 3 arguments, got 4"),
        ((1, 0, 0), "argument 1 of trace must be a str, got 1"),
        ((b"exp", 0, 0), "argument 1 of trace must be a str, got b'exp'"),
        (("exp", 0.0, 0), "argument 2 of trace must be an int of 64 bits, got 0.0"),
        (("exp", 0, "0"), "argument 3 of trace must be the address of an array (int), got '0'"),
    ],
)
def test_a_recording_checks_its_arguments(arguments, message):
    with pytest.raises(TypeError, match=f"^{re.escape(message)}$"):
        _core.trace(*arguments)


@pytest.mark.parametrize(
    ("function", "number"), [("log", 0), ("law", len(_core.LAWS)), ("begin", len(_core.TASKS))]
)
def test_an_unknown_recording_is_named(function, number):
    constants = np.zeros(1000)
    message = f"^the core records no function '{function}' with the number {number}$"
    with pytest.raises(ValueError, match=message):
        _core.trace(function, number, native.address(constants))


def test_a_recording_ends_with_its_outputs():
    rows = _core.trace("exp", 0, native.address(ARRAY))
    assert rows[0] == ("input",)
    assert rows[-1][0] == "output"


def test_a_module_that_is_loaded_again_and_freed_leaves_the_first_one():
    spec = importlib.util.spec_from_file_location("_core", _core.__file__)
    again = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(again)
    del again
    gc.collect()
    # Types that may lie where those of the freed module were.
    others = [type("Other", (), {}) for _ in range(50)]
    CapsuleEnv().reset(seed=0)
    assert len(others) == 50
