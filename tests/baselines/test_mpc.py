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
