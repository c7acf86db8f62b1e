"""From the log of a hidden plant to a program in C that drives it, one command per link."""

import os
import shutil

import numpy as np
import pytest

from benchmarks.rig import HIDDEN, Program, drive, make_program
from capsule_gym import CapsuleEnv, Excitation, evaluate, load_policy, record
from capsule_gym.evaluation.episodes import validation_set

SEED = 7001
STEPS = 300

pytestmark = pytest.mark.skipif(
    shutil.which("gcc") is None and "CI" not in os.environ, reason="needs gcc"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files of all links: log.csv, fit.json, the folder run, run.h, loop.so."""
    folder = tmp_path_factory.mktemp("rig")
    rig = CapsuleEnv(**HIDDEN, control_dt=0.01)
    record(rig, Excitation(amplitude=0.35), folder / "log.csv", seconds=10.0, seed=SEED)
    make_program(folder, ["--total-steps", "20000", "--evaluation-episodes", "2"])
    return folder


def test_the_program_drives_the_hidden_plant_as_the_policy(folder):
    program = Program(folder / "loop.so")
    policy = load_policy(folder / "run")
    env = CapsuleEnv(**HIDDEN, stack_size=4)
    observation, info = env.reset(seed=SEED)
    torques = []
    for n in range(STEPS):
        torque = program.torque(info["reading"], begins=n == 0)
        action = policy(observation)
        assert torque == pytest.approx(1.5 * action.item(), abs=1e-6)
        observation, _, terminated, _, info = env.step(np.float32([torque / 1.5]))
        torques.append(torque)
        assert not terminated
    assert np.ptp(torques) > 0.1


def test_a_program_is_as_fast_as_its_policy_in_an_evaluation(folder):
    speed, failed = drive(Program(folder / "loop.so"), SEED)
    hidden = validation_set("real-wide", "hidden", SEED, 1, disturbances="real")
    (episode,) = evaluate(load_policy(folder / "run"), hidden)
    assert speed == pytest.approx(episode["mean_speed"], abs=0.05)
    assert failed == episode["failed"]
