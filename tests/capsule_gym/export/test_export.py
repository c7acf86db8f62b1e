"""Exported policies and laws: the bits of the package in double, small errors in float, on a
Cortex-M4, and in ONNX."""

import ctypes
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from capsule_gym import CapsuleVectorEnv, Disturbances, load_policy
from capsule_gym.control.laws import LAWS
from capsule_gym.evaluation.candidates import wrap_policy
from capsule_gym.evaluation.episodes import evaluate
from capsule_gym.evaluation.sets import load_set
from capsule_gym.export import main
from capsule_gym.export.exported import Exported
from capsule_gym.tasks.registry import find_task
from tests import ROOT

POLICIES = (
    "direct-ppo",
    "direct-sac",
    "goal",
    "residual-real",
    "direct-real",
    "velocity",
    "dp-distilled-wide",
)
ARGUMENTS = (
    "residual-ppo",
    "dp-distilled-wide",
    "goal --float",
    "residual-real --law --float",
    "baselines:gait",
)
C99 = ("-std=c99", "-Wall", "-Wextra", "-Werror")
M4 = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "--specs=rdimon.specs")
START, VECTORS = Path(__file__).with_name("mps2.c"), "-Wl,--section-start=.vectors=0"
QEMU = ("qemu-system-arm", "-M", "mps2-an386", "-nographic", "-semihosting")
# Many calls at a time, those of a law one after another; a state is theta, theta_dot, x, x_dot and
# the goal or command.
HARNESS = """
#include "NAME.h"
#ifdef POLICY
void act(int n, const float *o, float *a) {
  for (int i = 0; i < n; i++, o += NAME_ENTRIES) a[i] = NAME_act(o);
}
#else
void law(int n, const double *s, double *torques) {
  static NAME_memory memory;
  for (int i = 0; i < n; i++, s += 5) {
    NAME_reading r;
    r.theta = s[0], r.theta_dot = s[1], r.x = s[2], r.x_dot = s[3];
    TASK
    if (i == 0) NAME_start(&memory, &r);
    torques[i] = NAME_law(&memory, &r);
  }
}
#endif
"""
# An action and a call of the law on a Cortex-M4 with a clock of 25 MHz, at one instruction per
# nanosecond.
COUNT = """
#include "policy.h"
#include <stdio.h>
#define TIMER ((volatile uint32_t *)0xE000E010)
float act(NAME_memory *memory, NAME_reading *reading, float *observation) {
  if (memory->called) NAME_law(memory, reading);
  else NAME_start(memory, reading);
  NAME_observe(memory, reading, observation);
  return NAME_torque(reading, reading->action = NAME_act(observation));
}
#ifdef COUNT
int main(void) {
  static NAME_memory memory; static NAME_reading reading; static float observation[NAME_ENTRIES];
  uint32_t begin, instructions = 0;
  TIMER[1] = 0xFFFFFF, TIMER[0] = 5;
  for (int i = 0; i < 100; i++) {
    reading.theta = 0.01f * (float)i - 0.5f, reading.theta_dot = 0.1f * (float)i, reading.x_dot = 0.002f * (float)i;
    memory.called = i > 0, begin = TIMER[2];
    act(&memory, &reading, observation);
    instructions += ((begin - TIMER[2]) & 0xFFFFFF) * 40;
  }
  printf("%u instructions\\n", (unsigned)(instructions / 100));
  return 0;
}
#endif
"""
pytestmark = pytest.mark.skipif(
    shutil.which("gcc") is None and "CI" not in os.environ, reason="needs gcc"
)


def run(*command):
    """The output of a program that must end without an error."""
    result = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, timeout=300, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Compiles the header of a policy or law, and loads it."""

    def compile_library(name, single):
        exported, folder = Exported(name), tmp_path_factory.mktemp("library")
        (folder / f"{exported.name}.h").write_text(exported.c(single=single))
        task = {"goal": "r.goal = s[4];", "velocity": "r.command = s[4];"}.get(
            exported.task.name, ""
        )
        source = HARNESS.replace("NAME", exported.name).replace("TASK", task)
        (folder / "harness.c").write_text(("#define POLICY\n" if exported.policy else "") + source)
        # With the processor's fused instruction; `test_program` has none.
        words = (
            "-O2",
            "-march=native",
            "-fPIC",
            "-shared",
            folder / "harness.c",
            "-o",
            folder / "library.so",
            "-lm",
        )
        run("gcc", *C99, *words)
        return ctypes.CDLL(str(folder / "library.so"))

    return compile_library


def call(function, given, dtype):
    """The results of a C function for rows of arguments, shape (rows, 1)."""
    given, found = np.ascontiguousarray(given), np.empty((len(given), 1), dtype)
    function(len(given), *(each.ctypes.data_as(ctypes.c_void_p) for each in (given, found)))
    return found


@pytest.fixture(scope="module", params=POLICIES)
def observed(request):
    """A policy's actions on 10,000 observations of 100 plants, on the way of actions of which a
    tenth are random."""
    policy, rng = load_policy(request.param), np.random.default_rng(20)
    env = CapsuleVectorEnv(100, **policy.env_kwargs)
    observation, _ = env.reset(seed=7_000)
    observations, actions = [], []
    for _ in range(100):
        observations.append(observation.copy())
        actions.append(policy(observation))
        noise = rng.uniform(-1.0, 1.0, (100, 1)).astype(np.float32)
        observation, *_ = env.step(np.where(rng.random((100, 1)) < 0.1, noise, actions[-1]))
    return SimpleNamespace(policy=policy, observations=observations, actions=np.array(actions))


@pytest.mark.parametrize("single", [False, True])
def test_c_network(observed, library, single):
    act = library(observed.policy.name, single).act
    errors = np.abs(
        np.array([call(act, each, np.float32) for each in observed.observations]) - observed.actions
    )
    print(f"{observed.policy.name}, C99 in {'float' if single else 'double'}: {errors.max():.2g}")
    assert errors.max() <= (1e-5 if single else 0.0)


@pytest.mark.parametrize("name", ["direct-ppo", "residual-real"])
def test_float_does_not_change_the_speed(library, name):
    policy, plants, act = load_policy(name), load_set("paper"), library(name, True).act
    single = wrap_policy(lambda seen: call(act, seen, np.float32), env_kwargs=policy.env_kwargs)
    speeds = [
        [each["mean_speed"] for each in evaluate(act, plants, horizon=8.0)]
        for act in (policy, single)
    ]
    assert np.mean(speeds[0]) > 10.0 and np.mean(speeds[1]) == pytest.approx(
        np.mean(speeds[0]), abs=1e-3
    )


@pytest.mark.parametrize("single", [False, True])
def test_onnx(observed, single):
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(Exported(observed.policy.name).onnx(single=single))
    found = [session.run(None, {"observation": each})[0] for each in observed.observations]
    worst = np.abs(np.array(found) - observed.actions).max()
    print(f"{observed.policy.name}, ONNX in {'float' if single else 'double'}: {worst:.2g}")
    assert worst <= (2e-6 if single else 1e-9)


@pytest.mark.parametrize("name", LAWS)
def test_c_law(library, name):
    """On 3,000 states, some of them at rest, and with changes that no plant makes."""
    exported, rng, n = Exported(f"baselines:{name}"), np.random.default_rng(21), 3000
    t = np.arange(n) * 1e-3
    swing = (0.6 * np.sin(9.0 * t), 5.4 * np.cos(9.0 * t), 0.05 * t, 0.15 * np.sin(9.0 * t + 1.0))
    states = np.array([*swing, np.full(n, 0.3)])
    states[:4] += rng.normal(size=(4, n)) * [[0.05], [0.5], [0.01], [0.05]]
    states[3, rng.random(n) < 0.3] = 0.0
    states[2, 1000:2000] = 0.3 + 0.02 * rng.normal(size=1000)
    found, controller = (
        call(library(f"baselines:{name}", False).law, states.T, float)[:, 0],
        exported.law,
    )
    start = {"goal": 0.3, "command": 0.3, "target": states[2, 0]}
    own = (
        tuple(start.get(field, 0.0) for field in find_task(controller.task).fields)
        if controller.task
        else ()
    )
    memory = controller.memory
    for i, given in enumerate(states.T):
        row = (*controller.reference[i % len(controller.reference)], *own)
        torque, memory = controller.law(*given[:4].tolist(), memory, row)
        assert found[i] == min(max(torque, -1.5), 1.5), i


@pytest.mark.parametrize("target", ["-O0", "-O2", "-O3", "cortex-m4"])
@pytest.mark.parametrize("arguments", ARGUMENTS)
def test_program(tmp_path, target, arguments):
    """The test vectors of the command, compiled for this machine, and for a Cortex-M4 in QEMU."""
    emulator = "qemu-system-arm" if target == "cortex-m4" else "gcc"
    if shutil.which(emulator) is None and "CI" not in os.environ:
        pytest.skip(f"needs {emulator}")
    assert main([*arguments.split(), "--c", str(tmp_path / "policy.h")]) == 0
    source, program = tmp_path / "policy_test.c", tmp_path / "program"
    if target == "cortex-m4":
        run("arm-none-eabi-gcc", *C99, "-O2", *M4, START, VECTORS, source, "-o", program, "-lm")
        output = run(*QEMU, "-kernel", program)
    else:
        run("gcc", *C99, target, source, "-o", program, "-lm")
        output = run(program)
    assert re.search(r": 0 of \d\d+ periods differ", output), output


def test_program_of_a_law_that_observes_a_moving_target(tmp_path):
    options = {"task": "velocity", "controller": "baselines:velocity_pulses", "control_dt": 0.1}
    parts = {
        "layers": ((np.full((1, 14), 0.01, np.float32), np.zeros(1, np.float32)),),
        "mean": np.zeros(14),
    }
    parts |= {
        "variance": np.ones(14),
        "env_kwargs": {**options, "disturbances": Disturbances(controls="law")},
    }
    replace(load_policy("velocity"), **parts).save(tmp_path / "policy.safetensors")
    assert main([str(tmp_path), "--law", "--c", str(tmp_path / "policy.h")]) == 0
    run("gcc", *C99, tmp_path / "policy_test.c", "-o", tmp_path / "program", "-lm")
    run(tmp_path / "program")


def test_loop_of_the_page(tmp_path):
    """The C of docs/export.md moves the motor."""
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```c\n(.*?)```", page, re.DOTALL)
    main = (
        "int main(void) { float s[4] = {-1}; return !(rig_step(s) > 1 && rig_step(s) <= 1.5f); }\n"
    )
    (tmp_path / "policy.h").write_text(Exported("residual-real", True).c(single=True))
    (tmp_path / "rig.c").write_text(code + main)
    run("gcc", *C99, tmp_path / "rig.c", "-o", tmp_path / "rig", "-lm")
    run(tmp_path / "rig")


@pytest.mark.skipif(
    shutil.which("qemu-system-arm") is None and "CI" not in os.environ,
    reason="needs qemu-system-arm",
)
def test_size_and_time_on_a_cortex_m4(tmp_path):
    """A policy of 64 x 64 units with its law, in float."""
    (tmp_path / "policy.h").write_text(Exported("residual-real", True).c(single=True))
    source, compiler = tmp_path / "count.c", ("arm-none-eabi-gcc", *C99, "-O2", *M4)
    source.write_text(COUNT.replace("NAME", "residual_real"))
    run(*compiler, "-c", source, "-o", tmp_path / "act.o")
    size = int(run("arm-none-eabi-size", tmp_path / "act.o").split()[6])
    run(*compiler, "-DCOUNT", START, VECTORS, source, "-o", tmp_path / "program", "-lm")
    instructions = int(run(*QEMU, "-icount", "shift=0", "-kernel", tmp_path / "program").split()[0])
    print(f"{size} bytes, {instructions} instructions")
    assert size <= 25_000
    assert 10_000 < instructions <= 35_000
