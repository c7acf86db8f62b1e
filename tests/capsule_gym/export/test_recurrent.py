"""Recurrent policies in C and ONNX, on the observations of 10,000 calls."""

import ctypes
import json

import numpy as np
import pytest
import torch
from torch import nn

from capsule_gym import CapsuleVectorEnv, Policy, load_policy
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.contract import entries_of
from capsule_gym.export.exported import Exported
from tests.capsule_gym.export.test_export import C99, measure_on_cortex_m4, needs_qemu, run
from tests.capsule_gym.policies.test_policy import POLICY
from tests.capsule_gym.policies.test_recurrent import (
    TRAINED,
    Network,
    converted,
    recurrent_policy,
)

EPISODES = 100
STEPS = 100
HARNESS = """
#include "policy.h"
static NAME_memory memories[EPISODES];
void begin(void) {
  NAME_reading reading;
  memset(&reading, 0, sizeof reading);
  for (int i = 0; i < EPISODES; i++) NAME_start(&memories[i], &reading);
}
void act(const float *o, float *a) {
  for (int i = 0; i < EPISODES; i++, o += NAME_ENTRIES) a[i] = NAME_act(&memories[i], o);
}
"""


@pytest.fixture(
    scope="module",
    params=[
        ("gru", 64, True, "tanh"),
        ("lstm", 33, False, "clip"),
        ("gru", 5, False, "clip"),
        None,
    ],
    ids=["gru", "lstm", "small", "trained"],
)
def path(request, tmp_path_factory):
    """The file of a policy."""
    if request.param is None:
        return TRAINED
    kind, units, skip, squashing = request.param
    path = tmp_path_factory.mktemp("policy") / POLICY
    recurrent_policy(kind, units, skip=skip, squashing=squashing).save(path)
    return path


@pytest.fixture(scope="module")
def episodes(path):
    """The observations and actions of `EPISODES` plants over `STEPS` control intervals."""
    policy = load_policy(path)
    env = CapsuleVectorEnv(EPISODES, autoreset_mode="DISABLED", **policy.env_kwargs)
    observation, _ = env.reset(seed=7_000)
    act = policy.start(range(EPISODES))
    observations = []
    actions = []
    for _ in range(STEPS):
        action = act(observation)
        observations.append(observation.copy())
        actions.append(action)
        observation, *_ = env.step(action)
    return observations, np.array(actions)


@pytest.mark.parametrize(
    ("single", "tolerance", "flags"),
    [(False, 0.0, ["-march=native"]), (False, 0.0, []), (True, 1e-5, [])],
    ids=["fused", "not fused", "float"],
)
def test_c_computes_the_same_actions(path, episodes, single, tolerance, flags, tmp_path):
    exported = Exported(str(path))
    (tmp_path / "policy.h").write_text(exported.c(single=single))
    source = HARNESS.replace("NAME", exported.name).replace("EPISODES", str(EPISODES))
    (tmp_path / "harness.c").write_text(source)
    library = tmp_path / "library.so"
    options = [*C99, "-O2", *flags, "-fPIC", "-shared"]
    run("gcc", *options, tmp_path / "harness.c", "-o", library, "-lm")
    compiled = ctypes.CDLL(str(library))
    observations, actions = episodes
    # A second episode begins with a cleared memory.
    for _ in range(2):
        compiled.begin()
        for observation, expected in zip(observations, actions, strict=True):
            found = np.empty((EPISODES, 1), np.float32)
            pointers = [each.ctypes.data_as(ctypes.c_void_p) for each in (observation, found)]
            compiled.act(*pointers)
            assert np.abs(found - expected).max() <= tolerance


@pytest.mark.parametrize("single", [False, True])
def test_the_test_program_of_a_policy_passes(path, single, tmp_path):
    exported = Exported(str(path))
    (tmp_path / "policy.h").write_text(exported.c(single=single))
    (tmp_path / "test.c").write_text(exported.c_test("policy.h", single=single))
    program = tmp_path / "program"
    run("gcc", *C99, "-O2", tmp_path / "test.c", "-o", program, "-lm")
    assert ": 0 of " in run(program)


def test_the_widest_input_of_a_layer_may_be_that_of_the_cell(tmp_path):
    recurrent_policy(units=3, skip=False).save(tmp_path / POLICY)
    # The layers have 5, 7, 3 and 6 inputs.
    assert Exported(str(tmp_path / POLICY)).widest == 7


@pytest.mark.parametrize("cell", [nn.GRU, nn.LSTM])
def test_the_test_program_of_a_policy_on_a_law_passes(cell, tmp_path):
    # The memories of policy, law and filter are in one struct.
    env_kwargs = {"controller": "baselines:adaptive", "observe_estimates": True}
    entries = len(entries_of(EnvConfig(**env_kwargs)))
    torch.manual_seed(0)
    network = nn.Sequential(nn.Linear(entries, 7), nn.Tanh(), cell(7, 9), nn.Linear(9, 1))
    Policy.from_torch(network, env_kwargs=env_kwargs).save(tmp_path / POLICY)
    exported = Exported(str(tmp_path / POLICY), law=True)
    (tmp_path / "policy.h").write_text(exported.c())
    (tmp_path / "test.c").write_text(exported.c_test("policy.h"))
    program = tmp_path / "program"
    run("gcc", *C99, "-O2", tmp_path / "test.c", "-o", program, "-lm")
    assert ": 0 of 2000 periods differ" in run(program)


@pytest.mark.parametrize(("single", "tolerance"), [(False, 1e-9), (True, 1e-5)])
def test_onnx_computes_the_same_actions(path, episodes, single, tolerance):
    onnxruntime = pytest.importorskip("onnxruntime")
    model = Exported(str(path)).onnx(single=single)
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    state = session.get_inputs()[1]
    number = np.float64 if state.type == "tensor(double)" else np.float32
    memory = np.zeros((EPISODES, state.shape[1]), number)
    for observation, expected in zip(*episodes, strict=True):
        action, memory = session.run(None, {"observation": observation, "state": memory})
        # Both round to float32.
        rounding = np.spacing(np.abs(expected))
        assert (np.abs(action - expected) <= tolerance + rounding).all()


def test_a_model_says_what_it_takes(path):
    onnx = pytest.importorskip("onnx")
    model = onnx.load_from_string(Exported(str(path)).onnx())
    assert model.graph.doc_string == load_policy(path).description
    # Those of ONNX 1.12, which also older runtimes read.
    assert (model.ir_version, model.opset_import[0].version) == (8, 17)
    action, _ = model.graph.output
    rows, columns = action.type.tensor_type.shape.dim
    assert (rows.dim_param, columns.dim_value) == ("n", 1)
    found = {each.key: json.loads(each.value) for each in model.metadata_props}
    assert found == {
        "control_dt": 0.02,
        "torque_limit": 1.5,
        "residual_limit": 1.5,
        "law": None,
        "observation": ["theta", "theta_dot", "x_dot", "stick", "last_action"],
    }


COUNT_CALLS = """
#include "policy.h"
#include <stdio.h>
#define TIMER ((volatile uint32_t *)0xE000E010)
float act(NAME_memory *memory, const float *observation) { return NAME_act(memory, observation); }
#ifdef COUNT
int main(void) {
  static NAME_memory memory;
  static float observation[NAME_ENTRIES];
  uint32_t instructions = 0;
  TIMER[1] = 0xFFFFFF;
  TIMER[0] = 5;
  for (int i = 0; i < 20; i++) {
    uint32_t begin;
    observation[0] = 0.05f * (float)i - 0.5f;
    begin = TIMER[2];
    act(&memory, observation);
    instructions += ((begin - TIMER[2]) & 0xFFFFFF) * 40;
  }
  printf("%u instructions\\n", (unsigned)(instructions / 20));
  return 0;
}
#endif
"""


@needs_qemu
@pytest.mark.parametrize(
    ("units", "most_bytes", "most_instructions"), [(64, 122_000, 180_000), (96, 256_000, 360_000)]
)
def test_size_and_time_on_a_cortex_m4(units, most_bytes, most_instructions, tmp_path):
    """A layer and a GRU of as many units, and a head of 64 units, in float."""
    options = {"skip": True, "activation": "tanh", "squashing": "tanh"}
    policy = converted(Network("gru", units, [units], [64], **options))
    policy.save(tmp_path / POLICY)
    exported = Exported(str(tmp_path / POLICY))
    size, instructions = measure_on_cortex_m4(tmp_path, exported, COUNT_CALLS)
    assert size <= most_bytes
    assert instructions <= most_instructions
