"""From a hidden plant to a program in C that drives it: `python -m benchmarks.rig`.

Every hidden plant, drawn from `real-wide` with the disturbances `real`, is recorded for 20 s. Then
each link is one command: identify the plant from the log, train an agent on the identified ranges,
export it as C99, compile. The program reads the sensors of the hidden plant for one episode.
"""

import ctypes
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from tqdm import tqdm

from baselines.tables import text_table
from benchmarks.identification import CONTROL_DT, WHOLE
from capsule_gym import CapsuleEnv, Excitation, record
from capsule_gym.command_line import PositiveCount, command
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.evaluation.episodes import evaluate, validation_set
from capsule_gym.tasks.registry import TASKS
from capsule_gym.tasks.task import TORQUE_LIMIT

ROOT = Path(__file__).resolve().parents[1]
HIDDEN: dict[str, Any] = {"randomization": "real-wide", "disturbances": "real"}
AGENT = ("--task", "direct", "--stack-size", "4")
# Seed of the first hidden plant.
SEED = 7000
# Amplitudes, N m, of which smaller ones follow where the excitation ends the episode.
AMPLITUDES = (0.45, 0.35, 0.25)
# Policies that drive the same plants without having been trained for them.
OTHERS = ("dp-distilled", "pd")
# Names of the exported functions begin with the name of the run's folder.
LOOP = """
#include "run.h"
static run_memory memory;
static run_reading reading;
static float observation[run_ENTRIES];
double step(int begins, double theta, double theta_dot, double x, double x_dot) {
  reading.theta = theta;
  reading.theta_dot = theta_dot;
  reading.x = x;
  reading.x_dot = x_dot;
  if (begins) {
    reading.action = 0.0;
    run_start(&memory, &reading);
  }
  run_observe(&memory, &reading, observation);
  reading.action = run_act(observation);
  return run_torque(&reading, reading.action);
}
"""


def record_log(seed: int, path: Path) -> None:
    """Records a hidden plant, with the largest excitation that it withstands."""
    env = CapsuleEnv(**HIDDEN, control_dt=CONTROL_DT)
    for amplitude in AMPLITUDES:
        log = record(env, Excitation(seed=seed, amplitude=amplitude), path, seed=seed)
        if len(log["t"]) * CONTROL_DT > WHOLE:
            break


def link(*words: str | Path) -> None:
    """Runs the command of a link.

    Raises:
        CalledProcessError: if it fails; its output is printed.
    """
    try:
        subprocess.run(words, check=True, capture_output=True, text=True, cwd=ROOT)
    except subprocess.CalledProcessError as error:
        print(error.stdout, error.stderr, file=sys.stderr)
        raise


def make_program(folder: Path, training: Sequence[str]) -> Path:
    """Goes from `log.csv` in a folder to a compiled program, a shared library.

    Args:
        folder: a folder with `log.csv`, which gets the files of all links.
        training: options of train.py.
    """
    python = sys.executable
    fit = folder / "fit.json"
    run = folder / "run"
    loop = folder / "loop.c"
    library = folder / "loop.so"
    link(python, "-m", "capsule_gym.identification", folder / "log.csv", "--save", fit)
    link(python, "train.py", *AGENT, "--rig", fit, "--run", run, "--no-comparison", *training)
    link(python, "-m", "capsule_gym.export", run, "--c", folder / "run.h")
    loop.write_text(LOOP, encoding="utf-8")
    link("gcc", "-std=c99", "-O2", "-shared", "-fPIC", loop, "-o", library, "-lm")
    return library


class Program:
    """A compiled program, which turns readings into torques."""

    def __init__(self, library: Path) -> None:
        self._step = ctypes.CDLL(str(library)).step
        self._step.restype = ctypes.c_double
        self._step.argtypes = [ctypes.c_int] + [ctypes.c_double] * 4

    def torque(self, reading: np.ndarray, *, begins: bool) -> float:
        """The torque, N m, at theta, theta_dot, x and x_dot."""
        return float(self._step(begins, *reading))


def drive(program: Program, seed: int) -> tuple[float, float]:
    """The mean speed of an episode on a hidden plant, cm/s, and 1 if the episode fails."""
    steps = TASKS["speed"].episode_steps
    env = CapsuleEnv(**HIDDEN)
    _, info = env.reset(seed=seed)
    for n in range(steps):
        torque = program.torque(info["reading"], begins=n == 0)
        action = np.array([torque / TORQUE_LIMIT], np.float32)
        _, _, terminated, _, info = env.step(action)
        if terminated:
            break
    metrics = env.episode_metrics(steps)
    return metrics["mean_speed"], metrics["failed"]


def drive_other(name: str, seed: int) -> tuple[float, float]:
    """As `drive`, for a policy by name."""
    hidden = validation_set("real-wide", "hidden", seed, 1, disturbances="real")
    (episode,) = evaluate(find_candidate(name).policies[0], hidden)
    return episode["mean_speed"], episode["failed"]


@command("python -m benchmarks.rig")
def main(plants: PositiveCount = 20, total_steps: PositiveCount = 1_000_000) -> None:
    """Goes from the logs of hidden plants to programs in C, and compares their speeds.

    Examples:
      python -m benchmarks.rig --plants 2 --total-steps 100000

    Args:
        plants: Number of hidden plants.
        total_steps: Environment steps of a training.
    """
    names = ("identified, in C", *OTHERS)
    found = []
    for seed in tqdm(range(SEED, SEED + plants), "plants", file=sys.stderr, disable=None):
        with TemporaryDirectory() as name:
            folder = Path(name)
            record_log(seed, folder / "log.csv")
            library = make_program(folder, ["--total-steps", str(total_steps)])
            episodes = [drive(Program(library), seed)]
        episodes += [drive_other(other, seed) for other in OTHERS]
        found.append(episodes)
    # Axes after these: plant, policy.
    speeds, failed = np.moveaxis(np.array(found), -1, 0)
    lines = [["plant", *names]]
    for n, row in enumerate(speeds):
        lines.append([str(SEED + n), *(f"{speed:.2f}" for speed in row)])
    lines.append(["mean", *(f"{speed:.2f}" for speed in speeds.mean(axis=0))])
    lines.append(["failed", *(f"{count:.0f}" for count in failed.sum(axis=0))])
    print("Mean speed, cm/s")
    print(text_table(lines, left=1))


if __name__ == "__main__":
    main()
