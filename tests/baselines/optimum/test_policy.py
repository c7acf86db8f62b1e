import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from baselines.gaits.archive import PLANTS
from baselines.optimum.policy import surrounding
from baselines.policies import SCRIPTED
from capsule_gym import CapsuleVectorEnv


def perform(name, M, mu, steps):
    """Observations and metrics of a policy on some plants, from rest."""
    policy = SCRIPTED[name]
    env = CapsuleVectorEnv(
        len(M),
        max_episode_steps=steps,
        autoreset_mode=AutoresetMode.DISABLED,
        randomization="none",
        **policy.env_kwargs,
    )
    observations, _ = env.reset(seed=0, options={"M": np.array(M), "mu": np.array(mu)})
    act = policy.start(range(len(M)))
    shown = []
    for _ in range(steps):
        observations, _, _, _, _ = env.step(act(observations))
        shown.append(observations.copy())
    metrics = env.episode_metrics()
    env.close()
    return np.array(shown), metrics


@pytest.mark.parametrize("name", ["optimum-nominal", "optimum-oracle"])
def test_alone_and_in_a_batch_bit_for_bit(name):
    M, mu = [0.5, 0.42, 0.7], [0.01, 0.2, 0.02]
    together, _ = perform(name, M, mu, 60)
    for i in range(3):
        alone, _ = perform(name, M[i : i + 1], mu[i : i + 1], 60)
        assert (alone[:, 0] == together[:, i]).all()


def test_the_oracle_is_fast_on_any_plant_of_the_grid_and_between():
    M, mu = [0.35, 0.5, 0.42, 0.62], [0.3, 0.01, 0.07, 0.015]
    _, metrics = perform("optimum-oracle", M, mu, 500)
    assert not metrics["failed"].any()
    assert (metrics["mean_speed"] > [30.0, 15.0, 20.0, 12.0]).all()


def test_the_nominal_optimum_bears_a_lighter_platform():
    _, metrics = perform("optimum-nominal", [0.5, 0.45, 0.55], [0.01, 0.009, 0.011], 500)
    assert not metrics["failed"].any()
    assert (metrics["mean_speed"] > 14.0).all()
    assert metrics["smallest_normal_ratio"][0] > 0.2


def test_the_plants_around_a_plant():
    for M, mu in ((0.35, 0.005), (0.6, 0.07), (1.0, 0.5)):
        corners, weights = surrounding(M, mu)
        assert sum(weights) == pytest.approx(1.0)
        assert sum(w * PLANTS[c][0] for c, w in zip(corners, weights, strict=True)) == pytest.approx(M)
        assert sum(w * np.log(PLANTS[c][1]) for c, w in zip(corners, weights, strict=True)) == pytest.approx(np.log(mu))
    # What the observation rounds, and what lies outside, is the edge's.
    assert surrounding(float(np.float32(0.35)), 0.6) == surrounding(0.35, 0.5)
    assert surrounding(2.0, 1e-4) == surrounding(1.0, 0.005)
