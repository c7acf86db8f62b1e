"""The start of an episode: draws equal numpy's, and every environment has its own."""

from __future__ import annotations

import numpy as np
import pytest

from capsule_gym import Capsule, Randomization
from capsule_gym.config import EnvConfig
from capsule_gym.layout import Row
from capsule_gym.resets import Stream, draw_plant, plant_at, plant_ranges, random_stream
from capsule_gym.simulation import Simulation
from capsule_gym.task import START_THETA

SEEDS = (0, 1, 12345, 2**63, 2**64 - 1, 2**64, 2**100 + 7, 2**128 - 1, 2**128 + 1)
RANDOMIZATIONS = ("none", "paper", "wide", Randomization(mu=(0.01, 0.2), log_mu=True), Randomization(M=(0.4, 0.5)))


@pytest.mark.parametrize("start", [{"initial_noise": 0.05}, {"initial_range": (1.0, 8.0)}], ids=str)
@pytest.mark.parametrize("randomization", RANDOMIZATIONS, ids=str)
def test_what_is_drawn_are_the_numbers_of_numpys_philox_bit_for_bit(randomization, start):
    simulation = Simulation(len(SEEDS), EnvConfig(randomization=randomization, capsule=Capsule(M=0.6), **start))
    rows = np.arange(len(SEEDS))
    for i, seed in enumerate(SEEDS):
        simulation.seed(i, seed)
    for episode in range(10):
        simulation.reset(rows)
        for i, seed in enumerate(SEEDS):
            plant = draw_plant(
                simulation.randomization, simulation.capsule, random_stream(seed, episode, Stream.parameters)
            )
            noise = random_stream(seed, episode, Stream.initial_state).uniform(-1.0, 1.0, 2)
            column = simulation.columns(rows)[:, i]
            assert (column[Row.M], column[Row.mu]) == plant
            if "initial_range" in start:
                assert (column[Row.theta], column[Row.theta_dot]) == (noise[0], 8.0 * noise[1])
            else:
                assert (column[Row.theta], column[Row.theta_dot]) == (START_THETA + 0.05 * noise[0], 0.0)
            assert column[Row.largest_theta] == abs(column[Row.theta])
    # A constant that is not drawn is the present capsule's.
    if simulation.randomization.M is None:
        assert (simulation.row(Row.M) == 0.6).all()


def test_a_range_is_drawn_as_its_formula_says():
    wide, uniform = Randomization.named("wide"), Randomization(mu=(0.1, 0.4))
    for seed in range(100):
        shares = random_stream(seed, 0, Stream.parameters).random(2).tolist()
        M, mu = draw_plant(wide, Capsule(), random_stream(seed, 0, Stream.parameters))
        assert M == 0.35 + (0.75 - 0.35) * shares[0]
        assert mu == pytest.approx(0.005 * (0.3 / 0.005) ** shares[1], rel=1e-15)
        # Ranges do not shift the stream, and a constant without a range is the capsule's own.
        assert draw_plant(uniform, Capsule(M=0.7), random_stream(seed, 0, Stream.parameters)) == (
            0.7,
            0.1 + (0.4 - 0.1) * shares[1],
        )
    assert plant_at(plant_ranges(wide, Capsule()), 0.0, 0.0) == (0.35, 0.005)
    same = Randomization(mu=(0.1, 0.1), log_mu=True)
    assert plant_at(plant_ranges(same, Capsule(M=0.7)), 0.5, 0.5) == (0.7, 0.1)


def test_rows_may_be_any_integers_that_name_environments():
    simulation = Simulation(130)
    for rows in (np.array([129, 3]), np.array([129, 3], np.int32), np.arange(130)[::-126]):
        for i in range(130):
            simulation.seed(i, i)
        simulation.reset(np.arange(130))
        first = simulation.row(Row.M)
        simulation.reset(rows)
        assert np.flatnonzero(simulation.row(Row.M) != first).tolist() == [3, 129]
    for wrong in (-1, 130, 2**40):
        before = simulation.world.copy()
        with pytest.raises(IndexError, match="rows must be indices of environments"):
            simulation.reset(np.array([0, wrong]))
        assert simulation.world.tobytes() == before.tobytes()
