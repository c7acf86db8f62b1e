"""Time of a recurrent policy's rollout: `python -m benchmarks.recurrent`.

A GRU between two linear layers controls a batch in the core, in torch and in the C code of
`python -m capsule_gym.export`. Contenders take turns from the same states, so that other processes
affect all alike, and the ratios are taken within each turn.
"""

import ctypes
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measurement import in_turns, machine, report
from benchmarks.throughput import BATCH, COMPILER, compile_c
from capsule_gym import CapsuleVectorEnv, Policy
from capsule_gym.command_line import PositiveCount, check_output, command
from capsule_gym.core import native
from capsule_gym.evaluation.statistics import estimate
from capsule_gym.export.exported import Exported
from capsule_gym.policies.rollout import rollout

COMMAND = "python -m benchmarks.recurrent"
UNITS = 96
ENTRIES = 5
STEPS = 100
CORE = "core"
# Small torques, with which no episode ends.
OUTPUT_SCALE = 0.05
C_OPTIONS = ("-std=c99", "-O2", "-fPIC")
# A batch of policies in C.
BATCH_IN_C = f"""
#include "policy.h"
static gru_memory memories[{BATCH}];
void start(void) {{
  const gru_reading reading = {{0}};
  for (int i = 0; i < {BATCH}; i++) gru_start(memories + i, &reading);
}}
void act(const float *observations, float *actions) {{
  for (int i = 0; i < {BATCH}; i++)
    actions[i] = gru_act(memories + i, observations + i * gru_ENTRIES);
}}
"""

# Steps a batch from its observations.
Drive = Callable[[CapsuleVectorEnv, np.ndarray], None]
Act = Callable[[np.ndarray], np.ndarray]


def make_network() -> Any:
    """The layers of a random network."""
    import torch
    from torch import nn

    torch.manual_seed(0)
    last = nn.Linear(UNITS, 1)
    with torch.no_grad():
        last.weight *= OUTPUT_SCALE
    return nn.ModuleList([nn.Linear(ENTRIES, UNITS), nn.GRU(UNITS, UNITS), last])


def make_policy(network: Any) -> Policy:
    """The network as a policy."""
    return Policy.from_torch(network, activation="tanh", squashing="tanh")


def drive_by_core(policy: Policy, env: CapsuleVectorEnv, observations: np.ndarray) -> None:
    """Steps the environments inside the core."""
    rollout(env.simulation, policy, STEPS)


def drive_by_loop(
    start: Callable[[], Act], env: CapsuleVectorEnv, observations: np.ndarray
) -> None:
    """Steps the environments with actions of a function."""
    act = start()
    for _ in range(STEPS):
        observations, *_ = env.step(act(observations))


def start_torch(network: Any) -> Act:
    """Begins a batch of episodes in torch, in float32."""
    import torch

    first, cell, last = network
    memory = None

    def act(observations: np.ndarray) -> np.ndarray:
        nonlocal memory
        with torch.no_grad():
            inputs = torch.tanh(first(torch.from_numpy(observations)))
            outputs, memory = cell(inputs[None], memory)
            return torch.tanh(last(outputs[0])).numpy()

    return act


def start_c(library: ctypes.CDLL) -> Act:
    """Begins a batch of episodes in C, in double."""
    library.start()
    actions = np.empty((BATCH, 1), np.float32)
    of_actions = ctypes.c_void_p(native.address(actions))

    def act(observations: np.ndarray) -> np.ndarray:
        library.act(ctypes.c_void_p(native.address(observations)), of_actions)
        return actions

    return act


def compile_policy(compiler: str, policy: Policy) -> ctypes.CDLL:
    """Compiles the C code of a policy, for `BATCH` environments."""
    with tempfile.TemporaryDirectory() as name:
        # The prefix of the names in C is that of the folder.
        folder = Path(name) / "gru"
        folder.mkdir()
        policy.save(folder / "policy.safetensors")
        (folder / "policy.h").write_text(Exported(str(folder)).c(), encoding="utf-8")
        source = folder / "batch.c"
        source.write_text(BATCH_IN_C, encoding="utf-8")
        return compile_c(compiler, source, C_OPTIONS)


def contenders() -> dict[str, Drive]:
    """What steps a batch, by name; the first is the core."""
    network = make_network()
    policy = make_policy(network)
    found: dict[str, Drive] = {CORE: partial(drive_by_core, policy)}
    found["torch, float32"] = partial(drive_by_loop, partial(start_torch, network))
    if COMPILER:
        library = compile_policy(COMPILER, policy)
        found["plain C, double"] = partial(drive_by_loop, partial(start_c, library))
    return found


def begin() -> tuple[CapsuleVectorEnv, np.ndarray]:
    """Environments at their start, always the same, and their observations."""
    env = CapsuleVectorEnv(BATCH, autoreset_mode="DISABLED", max_episode_steps=2 * STEPS)
    observations, _ = env.reset(seed=0)
    return env, observations


def seconds_per_step(drive: Drive) -> float:
    """The processor time of a step of one environment."""
    env, observations = begin()
    start = time.process_time()
    drive(env, observations)
    return (time.process_time() - start) / (STEPS * BATCH)


@command(COMMAND, ValueError)
def main(markdown: Path | None = None, turns: PositiveCount = 20) -> None:
    """Processor time of a recurrent policy's rollout in the core, in torch and in plain C.

    Ratios are interquartile means over the turns, with 95 % intervals. Plain C needs a compiler.

    Examples:
      python -m benchmarks.recurrent
      CAPSULE_GYM_LEVEL=v3 CC=clang python -m benchmarks.recurrent --turns 10

    Args:
        markdown: Write the table to this file.
        turns: Measurements of every contender, in turns.
    """
    check_output("--markdown", markdown, overwrite=True)
    import torch

    torch.set_num_threads(1)
    turn = {name: partial(seconds_per_step, drive) for name, drive in contenders().items()}
    seconds = in_turns(turn, turns)
    table = [["", "µs a step", "ratio to the core"]]
    for name, each in seconds.items():
        ratio = estimate([np.divide(each, seconds[CORE])])
        interval = f"{ratio.value:.2f} [{ratio.low:.2f}, {ratio.high:.2f}]"
        table.append([name, f"{1e6 * np.median(each):.2f}", "" if name == CORE else interval])
    note = f"A GRU of {UNITS} units in {BATCH} environments, one thread, torch {torch.__version__}."
    report(COMMAND, markdown, table, note, f"{machine()}.")


if __name__ == "__main__":
    sys.exit(main())
