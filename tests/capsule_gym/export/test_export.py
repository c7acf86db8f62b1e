"""Exported policies and laws in double, in float, on a Cortex-M4, and in ONNX."""

import ctypes
import os
import platform
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
from tests.capsule_gym.policies.test_policy import make_linear_policy, make_policy

C99 = ("-std=c99", "-Wall", "-Wextra", "-Werror")
M4 = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "--specs=rdimon.specs")
CROSS_COMPILER = ("arm-none-eabi-gcc", *C99, "-O2", *M4)
START = (Path(__file__).with_name("mps2.c"), "-Wl,--section-start=.vectors=0")
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
    r.theta = s[0];
    r.theta_dot = s[1];
    r.x = s[2];
    r.x_dot = s[3];
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
  TIMER[1] = 0xFFFFFF;
  TIMER[0] = 5;
  for (int i = 0; i < 100; i++) {
    reading.theta = 0.01f * (float)i - 0.5f;
    reading.theta_dot = 0.1f * (float)i;
    reading.x_dot = 0.002f * (float)i;
    memory.called = i > 0;
    begin = TIMER[2];
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
        exported = Exported(name)
        folder = tmp_path_factory.mktemp("library")
        (folder / f"{exported.name}.h").write_text(exported.c(single=single))
        target = {"goal": "r.goal = s[4];", "velocity": "r.command = s[4];"}
        source = HARNESS.replace("NAME", exported.name)
        source = source.replace("TASK", target.get(exported.task.name, ""))
        defined = ["-DPOLICY"] if exported.policy else []
        (folder / "harness.c").write_text(source)
        # With the processor's fused instruction; `test_program` has none.
        options = ["-O2", "-march=native", "-fPIC", "-shared", *defined]
        path = folder / "library.so"
        run("gcc", *C99, *options, folder / "harness.c", "-o", path, "-lm")
        return ctypes.CDLL(str(path))

    return compile_library


def call(function, given, dtype):
    """The results of a C function for rows of arguments, shape (rows, 1)."""
    given = np.ascontiguousarray(given)
    found = np.empty((len(given), 1), dtype)
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (given, found)]
    function(len(given), *pointers)
    return found


@pytest.fixture(
    scope="module",
    params=[
        "direct-ppo",
        "direct-sac",
        "goal",
        "residual-real",
        "velocity",
        "dp-distilled-wide",
    ],
)
def observed(request):
    """A policy's actions on 10,000 observations of 100 plants.

    A tenth of the actions on the way are random.
    """
    policy = load_policy(request.param)
    rng = np.random.default_rng(20)
    env = CapsuleVectorEnv(100, **policy.env_kwargs)
    observation, _ = env.reset(seed=7_000)
    observations = []
    actions = []
    for _ in range(100):
        action = policy(observation)
        observations.append(observation.copy())
        actions.append(action)
        noise = rng.uniform(-1.0, 1.0, (100, 1)).astype(np.float32)
        random = rng.random((100, 1)) < 0.1
        observation, *_ = env.step(np.where(random, noise, action))
    return SimpleNamespace(policy=policy, observations=observations, actions=np.array(actions))


def largest_error(observed, act, form):
    """The largest error of the actions, which it prints for the documentation."""
    found = [act(observation) for observation in observed.observations]
    error = np.abs(np.array(found) - observed.actions).max()
    print(f"{observed.policy.name}, {form}: {error:.2g}")
    return error


@pytest.mark.parametrize(("single", "tolerance"), [(False, 0.0), (True, 1e-5)])
def test_c_network(observed, library, single, tolerance):
    act = library(observed.policy.name, single).act
    form = f"C99 in {'float' if single else 'double'}"
    error = largest_error(observed, lambda each: call(act, each, np.float32), form)
    assert error <= tolerance


@pytest.mark.parametrize("name", ["direct-ppo", "residual-real"])
def test_float_does_not_change_the_speed(library, name):
    policy = load_policy(name)
    plants = load_set("paper")
    act = library(name, True).act
    single = wrap_policy(lambda seen: call(act, seen, np.float32), env_kwargs=policy.env_kwargs)

    def mean_speed(policy):
        episodes = evaluate(policy, plants, horizon=8.0)
        return np.mean([episode["mean_speed"] for episode in episodes])

    speed = mean_speed(policy)
    assert speed > 10.0
    assert mean_speed(single) == pytest.approx(speed, abs=1e-3)


@pytest.mark.parametrize(("single", "tolerance"), [(False, 1e-9), (True, 2e-6)])
def test_onnx(observed, single, tolerance):
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(Exported(observed.policy.name).onnx(single=single))
    form = f"ONNX in {'float' if single else 'double'}"
    error = largest_error(observed, lambda each: session.run(None, {"observation": each})[0], form)
    assert error <= tolerance


@pytest.mark.parametrize("name", LAWS)
def test_c_law(library, name):
    """On 3,000 states, some of them at rest, and with changes that no plant makes."""
    controller = Exported(f"baselines:{name}").law
    rng = np.random.default_rng(21)
    n = 3000
    t = np.arange(n) * 1e-3
    states = np.empty((n, 5))
    theta, theta_dot, x, x_dot, target = states.T
    theta[:] = 0.6 * np.sin(9.0 * t)
    theta_dot[:] = 5.4 * np.cos(9.0 * t)
    x[:] = 0.05 * t
    x_dot[:] = 0.15 * np.sin(9.0 * t + 1.0)
    target[:] = 0.3
    states[:, :4] += rng.normal(size=(n, 4)) * (0.05, 0.5, 0.01, 0.05)
    x_dot[rng.random(n) < 0.3] = 0.0
    x[1000:2000] = 0.3 + 0.02 * rng.normal(size=1000)

    found = call(library(f"baselines:{name}", False).law, states, float)[:, 0]

    fields = find_task(controller.task).fields if controller.task else []
    start = {"goal": 0.3, "command": 0.3, "target": x[0]}
    observed = [start.get(field, 0.0) for field in fields]
    memory = controller.memory
    for i, state in enumerate(states.tolist()):
        row = (*controller.reference[i % len(controller.reference)], *observed)
        torque, memory = controller.law(*state[:4], memory, row)
        assert found[i] == min(max(torque, -1.5), 1.5), i


@pytest.mark.parametrize("target", ["-O0", "-O3", "cortex-m4"])
@pytest.mark.parametrize(
    "arguments",
    [
        ["residual-ppo"],
        ["dp-distilled-wide"],
        ["goal", "--float"],
        ["residual-real", "--law", "--float"],
        ["baselines:gait"],
        ["excitation", "--amplitude", "0.3", "--duration", "2"],
        ["excitation"],
    ],
    ids=" ".join,
)
def test_program(tmp_path, target, arguments):
    """The test vectors of the command, compiled for this machine, and for a Cortex-M4 in QEMU."""
    emulator = "qemu-system-arm" if target == "cortex-m4" else "gcc"
    if shutil.which(emulator) is None and "CI" not in os.environ:
        pytest.skip(f"needs {emulator}")
    assert main([*arguments, "--c", str(tmp_path / "policy.h")]) == 0
    source = tmp_path / "policy_test.c"
    program = tmp_path / "program"
    if target == "cortex-m4":
        run(*CROSS_COMPILER, *START, source, "-o", program, "-lm")
        output = run(*QEMU, "-kernel", program)
    else:
        run("gcc", *C99, target, source, "-o", program, "-lm")
        output = run(program)
    assert re.search(r": 0 of \d\d+ periods differ", output), output


def test_a_policy_that_observes_the_plant_is_given_it(tmp_path):
    policy = make_linear_policy(7, observe_parameters=True)
    policy.save(tmp_path / "told.safetensors")
    assert main([str(tmp_path / "told.safetensors"), "--c", str(tmp_path / "policy.h")]) == 0
    program = tmp_path / "program"
    run("gcc", *C99, tmp_path / "policy_test.c", "-o", program, "-lm")
    assert re.search(r": 0 of \d\d+ periods differ", run(program))


FLAGS = (
    "-ffast-math",
    "-freciprocal-math",
    "-fno-signed-zeros",
    "-funsafe-math-optimizations",
    "-ffinite-math-only",
    "-mfpmath=387",
    "-U__DBL_MANT_DIG__ -D__DBL_MANT_DIG__=24",
)


@pytest.fixture(scope="module")
def header(tmp_path_factory):
    path = tmp_path_factory.mktemp("header") / "law.h"
    path.write_text(Exported("baselines:pd").c())
    return path


@pytest.mark.parametrize("flags", FLAGS)
def test_a_compiler_that_rounds_otherwise_is_refused(header, flags):
    if "387" in flags and platform.machine() != "x86_64":
        pytest.skip("needs the x87")
    command = ["gcc", "-std=c99", *flags.split(), "-fsyntax-only", str(header)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode != 0
    assert re.search("rounded as it is written|must compute in double", found.stderr)
    run("gcc", "-std=c99", "-fsyntax-only", header)


def test_headers_of_one_name_do_not_skip_each_other(header, tmp_path):
    other = tmp_path / "other.h"
    other.write_text(Exported("baselines:pd").c(single=True))
    program = tmp_path / "both.c"
    program.write_text(f'#include "{header}"\n#include "{header}"\n')
    run("gcc", "-std=c99", "-fsyntax-only", program)
    program.write_text(f'#include "{header}"\n#include "{other}"\n')
    command = ["gcc", "-std=c99", "-fsyntax-only", str(program)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "pd_memory" in found.stderr


def test_a_name_in_c_has_only_letters_of_ascii(tmp_path):
    path = tmp_path / "2-zwölf.safetensors"
    make_policy().save(path)
    exported = Exported(str(path))
    assert exported.name == "_2_zw_lf"
    assert exported.c().endswith("\n")


@pytest.mark.parametrize(
    ("name", "found"), [("direct-ppo", "paper"), ("residual-real", "real"), ("goal", "goal")]
)
def test_the_test_vectors_are_of_a_set_for_the_policy(name, found):
    assert f'of the set "{found}"' in Exported(name).c_test("policy.h")


@pytest.mark.parametrize(
    ("name", "option", "given"),
    [
        ("policy.h", "--c", "policy.h"),
        ("policy_test.c", "--c", "policy.h"),
        ("policy.onnx", "--onnx", "policy.onnx"),
    ],
)
def test_a_file_is_overwritten_only_on_request(name, option, given, tmp_path, refused):
    pytest.importorskip("onnx")
    path = tmp_path / name
    path.write_text("mine")
    words = ["direct-ppo", option, str(tmp_path / given)]
    assert "must name a new file unless --overwrite is given" in refused(main, words)
    assert path.read_text() == "mine"
    assert main([*words, "--overwrite"]) == 0
    assert path.read_bytes() != b"mine"


def test_program_of_an_episode_that_ends_early(tmp_path):
    # The policy pushes in one direction until the pendulum lies down.
    push = np.zeros((1, 5), np.float32), np.full(1, 3.0, np.float32)
    make_policy(layers=(push,)).save(tmp_path / "policy.safetensors")
    assert main([str(tmp_path), "--c", str(tmp_path / "policy.h")]) == 0
    run("gcc", *C99, tmp_path / "policy_test.c", "-o", tmp_path / "program", "-lm")
    (periods,) = re.findall(r": 0 of (\d+) periods differ", run(tmp_path / "program"))
    assert 1 < int(periods) < 100


def test_program_of_a_law_that_observes_a_moving_target(tmp_path):
    layer = np.full((1, 14), 0.01, np.float32), np.zeros(1, np.float32)
    env_kwargs = {
        "task": "velocity",
        "controller": "baselines:velocity_pulses",
        "control_dt": 0.1,
        "disturbances": Disturbances(controls="law", lost=0.2, hold=(1, 3)),
    }
    arrays = {"layers": (layer,), "mean": np.zeros(14), "variance": np.ones(14)}
    policy = replace(load_policy("velocity"), **arrays, env_kwargs=env_kwargs)
    policy.save(tmp_path / "policy.safetensors")
    assert main([str(tmp_path), "--law", "--c", str(tmp_path / "policy.h")]) == 0
    run("gcc", *C99, tmp_path / "policy_test.c", "-o", tmp_path / "program", "-lm")
    run(tmp_path / "program")


def test_loop_of_the_page(tmp_path):
    """The C of docs/export.md moves the motor."""
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```c\n(.*?)```", page, re.DOTALL)
    body = "float s[4] = {-1}; return !(rig_step(s) > 1 && rig_step(s) <= 1.5f);"
    (tmp_path / "residual.h").write_text(Exported("residual-real", True).c(single=True))
    (tmp_path / "rig.c").write_text(f"{code}int main(void) {{ {body} }}\n")
    run("gcc", *C99, tmp_path / "rig.c", "-o", tmp_path / "rig", "-lm")
    run(tmp_path / "rig")


needs_qemu = pytest.mark.skipif(
    shutil.which("qemu-system-arm") is None and "CI" not in os.environ,
    reason="needs qemu-system-arm",
)


def measure_on_cortex_m4(folder, exported, program):
    """The bytes of a program's `act`, and the instructions of a call, with a header in float."""
    (folder / "policy.h").write_text(exported.c(single=True))
    source = folder / "count.c"
    source.write_text(program.replace("NAME", exported.name))
    run(*CROSS_COMPILER, "-c", source, "-o", folder / "act.o")
    size = int(run("arm-none-eabi-size", folder / "act.o").split()[6])
    counting = folder / "program"
    run(*CROSS_COMPILER, "-DCOUNT", *START, source, "-o", counting, "-lm")
    output = run(*QEMU, "-icount", "shift=0", "-kernel", counting)
    instructions = int(output.split()[0])
    print(f"{exported.name}: {size} bytes, {instructions} instructions")
    return size, instructions


@needs_qemu
def test_size_and_time_on_a_cortex_m4(tmp_path):
    """A policy of 64 x 64 units with its law, in float."""
    exported = Exported("residual-real", True)
    size, instructions = measure_on_cortex_m4(tmp_path, exported, COUNT)
    assert size <= 26_000
    assert 10_000 < instructions <= 36_000
