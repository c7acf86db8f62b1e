import re

import numpy as np

from baselines import mpc
from capsule_gym import CapsuleVectorEnv


def run(count, steps=150):
    env = CapsuleVectorEnv(count, randomization="none", autoreset_mode="DISABLED")
    observations, _ = env.reset(seed=0)
    act, taken = mpc.start(range(count)), []
    for _ in range(steps):
        taken.append(act(observations))
        observations, *_ = env.step(taken[-1])
    metrics = env.episode_metrics()
    return np.array(taken), metrics


def test_it_moves_and_an_episode_does_not_depend_on_others():
    (alone, metrics), (among, _) = run(1), run(3)
    assert metrics["distance"][0] > 0.2 and metrics["failed"][0] == 0.0
    assert alone.dtype == np.float32 and (np.abs(alone) <= 1.0).all()
    assert np.array_equal(alone[:, 0], among[:, 0])


def test_its_speed_and_the_time_of_a_decision_are_printed(monkeypatch, capsys):
    monkeypatch.setattr(mpc, "EPISODE_STEPS", 150)
    mpc.main(2, 0)
    said = re.fullmatch(r"(\S+) cm/s, 0 failures, (\d+) us per decision\n", capsys.readouterr().out)
    assert said is not None and float(said[1]) > 1.0 and int(said[2]) < 100_000
