"""Readings that are not finite: exported code and laws go on, and store nothing of them."""

import ctypes

import numpy as np
import pytest

from capsule_gym.control.laws import LAWS, find_law
from capsule_gym.export.exported import Exported
from tests.capsule_gym.export.test_export import C99, pytestmark, run  # noqa: F401
from tests.capsule_gym.policies.test_policy import POLICY
from tests.capsule_gym.policies.test_recurrent import TRAINED, recurrent_policy

CALLS = 800
DROPPED = 500
HARNESS = """
#include "policy.h"
int drive(int calls, const double *sensors, double *torques) {
  NAME_memory memory;
  NAME_reading reading;
  float observation[NAME_ENTRIES];
  memset(&reading, 0, sizeof reading);
  for (int i = 0; i < calls; i++, sensors += 5) {
    reading.theta = sensors[0];
    reading.theta_dot = sensors[1];
    reading.x = sensors[2];
    reading.x_dot = sensors[3];
    TARGET
    if (i == 0) NAME_start(&memory, &reading);
    LAW
    if (i % PERIODS == 0) {
      NAME_observe(&memory, &reading, observation);
      ACT
    }
    torques[i] = NAME_torque(&reading, reading.action);
  }
  return memory.dropped;
}
"""
SUBJECTS = (
    "direct-ppo",
    "residual-real",
    "goal",
    "velocity",
    str(TRAINED),
    "baselines:adaptive",
    "baselines:gait",
    "baselines:velocity_pulses",
)


@pytest.fixture(scope="module", params=SUBJECTS, ids=lambda name: name.rpartition("/")[2])
def drive(request, tmp_path_factory):
    """The torques on sensor values, and the number of readings that were dropped."""
    name = request.param
    controller = Exported(name).controller
    exported = Exported(name, law=controller is not None)
    folder = tmp_path_factory.mktemp("dropped")
    (folder / "policy.h").write_text(exported.c())
    law_steps = int(exported.settings.law_steps)
    act = "NAME_act(&memory, observation)" if exported.cell else "NAME_act(observation)"
    target = {"goal": "reading.goal = sensors[4];", "velocity": "reading.command = sensors[4];"}
    source = HARNESS.replace("TARGET", target.get(exported.task.name, ""))
    source = source.replace("LAW", "NAME_law(&memory, &reading);" if controller else "")
    source = source.replace("PERIODS", str(law_steps if controller else 1))
    source = source.replace("ACT", f"reading.action = {act};" if exported.policy else "")
    (folder / "drive.c").write_text(source.replace("NAME", exported.name))
    library = folder / "library.so"
    run("gcc", *C99, "-O2", "-fPIC", "-shared", folder / "drive.c", "-o", library, "-lm")
    function = ctypes.CDLL(str(library)).drive

    def call(sensors):
        torques = np.empty(len(sensors))
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (sensors, torques)]
        dropped = function(len(sensors), *pointers)
        return torques, dropped

    return call


def readings():
    """A swing, the platform's motion, and a target."""
    t = np.arange(CALLS) * 1e-3
    columns = (0.6 * np.sin(9.0 * t), 5.4 * np.cos(9.0 * t), 0.05 * t, 0.15 * np.sin(9.0 * t + 1))
    return np.column_stack([*columns, np.full(CALLS, 0.3)])


@pytest.mark.parametrize("value", [np.nan, -np.inf, -1e308, 2e6])
def test_the_last_valid_reading_replaces_a_lost_one(drive, value):
    """As in the environment, whose disturbances lose single readings of each sensor."""
    lost = np.random.default_rng(22).random((CALLS, 4)) < 0.2
    lost[0] = False
    held = readings()
    for call in range(1, CALLS):
        held[call, :4] = np.where(lost[call], held[call - 1, :4], held[call, :4])
    expected, none = drive(held)
    given = readings()
    given[:, :4][lost] = value
    torques, dropped = drive(given)
    assert none == 0
    assert dropped == lost.any(axis=1).sum()
    np.testing.assert_array_equal(torques, expected)


def test_a_first_reading_may_be_lost(drive):
    lost = readings()
    lost[0] = np.nan
    torques, dropped = drive(lost)
    assert np.isfinite(torques).all()
    assert dropped >= 1


@pytest.mark.parametrize("size", [1e6, -1e6])
def test_a_reading_that_overflows_leaves_no_trace(drive, size):
    spike = readings()
    spike[DROPPED, :4] = size
    torques, dropped = drive(spike)
    assert np.isfinite(torques).all()
    # The call of the law, that of the observation, and the next one, of the change.
    assert dropped <= 3


@pytest.mark.parametrize("kind", ["gru", "lstm"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_onnx_model_keeps_its_state(kind, value, tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    recurrent_policy(kind, 8, skip=True).save(tmp_path / POLICY)
    session = runtime.InferenceSession(Exported(str(tmp_path / POLICY)).onnx())
    shape = session.get_inputs()[1].shape
    observation = np.full((2, 5), 0.1, np.float32)
    lost = observation.copy()
    lost[1, 2] = value

    def step(observation, state):
        return session.run(None, {"observation": observation, "state": state})

    _, first = step(observation, np.zeros((2, shape[1])))
    action, state = step(lost, first)
    assert action[1] == 0.0 != action[0]
    np.testing.assert_array_equal(state[1, :-1], first[1, :-1])
    assert state[:, -1].tolist() == [0.0, 1.0]
    again, _ = step(observation, state)
    expected, _ = step(observation, first)
    assert again[1] == expected[1]


def test_an_onnx_model_without_a_memory_gives_no_torque():
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(Exported("direct-ppo").onnx())
    observation = np.full((3, 5), 0.1, np.float32)
    observation[1, 0] = np.nan
    (action,) = session.run(None, {"observation": observation})
    assert action[1] == 0.0
    assert action[0] == action[2] != 0.0


@pytest.mark.parametrize("name", LAWS)
def test_a_law_of_the_core_keeps_its_memory(name):
    controller = find_law(name)()
    law = controller.law
    columns = controller.row_size
    states = np.tile([0.3, 1.0, 0.1, 0.1], (3, 1))
    states[1, 1] = np.nan
    states[2, 3] = np.inf
    memories = np.tile(controller.memory, (3, 1))
    torques, renewed = law.evaluate(states, memories, np.full((3, columns), 0.1))
    assert np.isfinite(torques[0])
    assert torques[1:].tolist() == [0.0, 0.0]
    np.testing.assert_array_equal(renewed[1:], memories[1:])
