"""From the log of a hidden plant to a program in C that drives it, one command per link."""

import ctypes
import os
import shutil
import subprocess

import numpy as np
import pytest

import train
from capsule_gym import CapsuleEnv, Excitation, load_policy, record
from capsule_gym.export import main as export
from capsule_gym.identification.__main__ import main as identify

HIDDEN = {"randomization": "real-wide", "disturbances": "real"}
SEED = 7001
STEPS = 300
PROGRAM = """
#include "policy.h"
static run_memory memory;
static run_reading reading;
static float observation[run_ENTRIES];
double step(int begins, double theta, double theta_dot, double x, double x_dot) {
  reading.theta = theta, reading.theta_dot = theta_dot, reading.x = x, reading.x_dot = x_dot;
  if (begins) reading.action = 0.0, run_start(&memory, &reading);
  run_observe(&memory, &reading, observation);
  reading.action = run_act(observation);
  return run_torque(&reading, reading.action);
}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files of all links: log.csv, fit.json, the folder run, policy.h."""
    folder = tmp_path_factory.mktemp("rig")
    rig = CapsuleEnv(**HIDDEN, control_dt=0.01)
    record(rig, Excitation(amplitude=0.35), folder / "log.csv", seconds=10.0, seed=SEED)
    assert identify([f"{folder}/log.csv", "--save", f"{folder}/fit.json"]) == 0
    kind = ["--task", "direct", "--stack-size", "4", "--rig", f"{folder}/fit.json"]
    size = ["--total-steps", "20000", "--evaluation-episodes", "2"]
    assert train.main([*kind, *size, "--run", f"{folder}/run", "--no-comparison"]) == 0
    assert export([f"{folder}/run", "--c", f"{folder}/policy.h"]) == 0
    return folder


@pytest.mark.skipif(shutil.which("gcc") is None and "CI" not in os.environ, reason="needs gcc")
def test_the_program_drives_the_hidden_plant_as_the_policy(folder):
    (folder / "loop.c").write_text(PROGRAM)
    library = folder / "loop.so"
    words = ["gcc", "-std=c99", "-O2", "-shared", "-fPIC", folder / "loop.c", "-o", library, "-lm"]
    subprocess.run(words, check=True)
    step = ctypes.CDLL(str(library)).step
    step.restype = ctypes.c_double
    step.argtypes = [ctypes.c_int] + [ctypes.c_double] * 4
    policy = load_policy(folder / "run")
    env = CapsuleEnv(**HIDDEN, stack_size=4)
    observation, info = env.reset(seed=SEED)
    torques = []
    for n in range(STEPS):
        torque = step(n == 0, *info["reading"])
        action = policy(observation)
        assert torque == pytest.approx(1.5 * action.item(), abs=1e-6)
        observation, _, terminated, _, info = env.step(np.float32([torque / 1.5]))
        torques.append(torque)
        assert not terminated
    assert np.ptp(torques) > 0.1
