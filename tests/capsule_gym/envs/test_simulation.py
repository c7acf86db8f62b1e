"""A batch of environments: the plants and steps that it accepts, and the draws at the start of an
episode."""

import pickle
import re
from types import SimpleNamespace

import numpy as np
import pytest

from capsule_gym import Capsule, Controller, Randomization
from capsule_gym.core.layout import LANES, Row
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.contract import STABLE, draw_plant
from capsule_gym.envs.resets import random_stream
from capsule_gym.envs.simulation import MOST_ENVS, Simulation
from capsule_gym.tasks.task import START_THETA, Termination
from tests.capsule_gym.fakes import picky_controller  # noqa: F401 (named by a pickle)


def test_the_integrator_is_stable_where_it_is_said_to_be_and_not_much_further():
    z = STABLE * np.exp(1j * np.linspace(0.5 * np.pi, np.pi, 1001))
    stable, beyond = (np.abs(1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0) for z in (z, 1.1 * z))
    assert stable.max() < 1.0 < beyond.max()


@pytest.mark.parametrize("fields", [{"c": 20.0}, {"k": 40_000.0}, {"m": 1e-4}, {"l": 0.005}])
def test_a_plant_too_stiff_for_the_step_is_refused_with_a_step_that_would_do(fields):
    capsule = Capsule(**fields)
    with pytest.raises(
        ValueError, match=r"^physics_dt must be at most \S+ s .* would do, got 0\.002 s$"
    ) as caught:
        Simulation(1, EnvConfig(capsule=capsule))
    longest, would_do = map(float, re.findall(r"(?:most |dt=)(\S+) ", str(caught.value)))
    assert would_do < 1.001 * longest < 1.25 * would_do
    simulation = Simulation(1, EnvConfig(capsule=capsule, physics_dt=would_do))
    # The simulation runs with this step, and refuses a step a quarter longer.
    simulation.reset(np.array([0]))
    for _ in range(50):
        simulation.step_one(0.0)
        if simulation.row(Row.termination)[0] != 0.0:
            break
    assert simulation.row(Row.termination)[0] != Termination.diverged
    with pytest.raises(ValueError, match=r"^physics_dt must be at most"):
        Simulation(
            1, EnvConfig(capsule=capsule, control_dt=20.0 * would_do, physics_dt=1.25 * would_do)
        )
    with pytest.raises(ValueError, match=r"^physics_dt must be at most .*; no step would do"):
        Simulation(1, EnvConfig(capsule=Capsule(c=1e9)))


def test_every_plant_of_an_episode_must_fit_the_step():
    capsule = Capsule(c=8.0)
    for each, said in (
        ({"M": (0.02, 0.5)}, r"with M=0\.02 kg and mu=0\.01"),
        ({"mu": (0, 4.0)}, "and mu=4, whose"),
    ):
        with pytest.raises(ValueError, match=f"^physics_dt must be at most .* {said}"):
            Simulation(1, EnvConfig(capsule=capsule, randomization=Randomization(**each)))
    simulation = Simulation(1, EnvConfig(capsule=capsule))
    for given in ({"M": [0.02]}, {"mu": [4.0]}, {"changes": [[{"t": 1.0, "M": 0.02, "mu": 0.01}]]}):
        with pytest.raises(ValueError, match="physics_dt must be at most"):
            simulation.reset(np.array([0]), **given)
    simulation.reset(np.array([0]), M=[0.4], mu=[0.3])
    varied, heavy = (
        EnvConfig(randomization=Randomization(c=(0.1, 8.0))),
        {"t": 1.0, "M": 0.02, "mu": 0.01},
    )
    for given in (
        {"capsule": [{"c": 8.0}], "changes": [[heavy]]},
        {"disturbances": [{"motor_friction": 100.0}]},
    ):
        with pytest.raises(ValueError, match="physics_dt must be at most"):
            Simulation(1, varied).reset(np.array([0]), **given)


def test_a_batch_for_which_there_is_no_memory_says_so(monkeypatch):
    def zeros(*arguments):
        raise MemoryError("Unable to allocate 7 GiB")

    # The largest number of environments takes some 15 GB.
    assert 1.2e10 < MOST_ENVS / LANES * Simulation(LANES).world.nbytes < 1.8e10
    monkeypatch.setattr(np, "zeros", zeros)
    with pytest.raises(ValueError, match=r"^num_envs must fit into memory, got 99: Unable"):
        Simulation(99)


def test_a_pickle_whose_law_has_another_memory_now_is_refused(monkeypatch):
    # Compiled code would write beyond the rows of its environments.
    packed = pickle.dumps(Simulation(1, EnvConfig(controller=f"{__name__}:picky_controller")))
    longer = Controller(
        "longer", lambda *arguments: (0.0, arguments[4]), np.zeros((1, 2)), (0.0, 0.0)
    )
    monkeypatch.setitem(globals(), "picky_controller", lambda: longer)
    with pytest.raises(ValueError, match=r"controller='.*:picky_controller' must be as it was"):
        pickle.loads(packed)


def test_a_jump_that_a_reset_cancels_never_comes():
    simulation = Simulation(2)
    simulation.reset(np.arange(2), changes=[[{"t": t, "M": 0.6, "mu": 0.02}] for t in (0.2, 0.1)])
    simulation.reset(np.array([1]))
    M = simulation.row(Row.M)[1]
    for _ in range(12):
        simulation.step(np.zeros(2))
    assert simulation.row(Row.M).tolist() == [0.6, M]


SEEDS = (0, 1, 12345, 2**63, 2**64 - 1, 2**64, 2**100 + 7, 2**128 - 1, 2**128 + 1)
RANDOMIZATIONS = (
    "none",
    "paper",
    "wide",
    Randomization(mu=(0.01, 0.2), log_mu=True),
    Randomization(M=(0.4, 0.5)),
)


@pytest.mark.parametrize("start", [{"initial_noise": 0.05}, {"initial_range": (1.0, 8.0)}], ids=str)
@pytest.mark.parametrize("randomization", RANDOMIZATIONS, ids=str)
def test_what_is_drawn_are_the_numbers_of_numpys_philox_bit_for_bit(randomization, start):
    simulation = Simulation(
        len(SEEDS), EnvConfig(randomization=randomization, capsule=Capsule(M=0.6), **start)
    )
    rows = np.arange(len(SEEDS))
    for i, seed in enumerate(SEEDS):
        simulation.seed(i, seed)
    for episode in range(10):
        simulation.reset(rows)
        for i, seed in enumerate(SEEDS):
            stream = random_stream(seed, episode, "parameters")
            plant = draw_plant(simulation.randomization, simulation.capsule, stream)
            noise = random_stream(seed, episode, "initial_state").uniform(-1.0, 1.0, 2)
            column = simulation.columns(rows)[:, i]
            assert (column[Row.M], column[Row.mu]) == plant
            ranged = "initial_range" in start
            expected = (
                (noise[0], 8.0 * noise[1]) if ranged else (START_THETA + 0.05 * noise[0], 0.0)
            )
            assert (column[Row.theta], column[Row.theta_dot]) == expected
            assert (column[Row.largest_theta], column[Row.largest_theta_dot]) == tuple(
                map(abs, expected)
            )
    # A constant that is not drawn is the present capsule's.
    if simulation.randomization.M is None:
        assert (simulation.row(Row.M) == 0.6).all()


def test_a_range_is_drawn_as_its_formula_says():
    wide, uniform = Randomization.named("wide"), Randomization(mu=(0.1, 0.4))
    for seed in range(100):
        shares = random_stream(seed, 0, "parameters").random(2).tolist()
        M, mu = draw_plant(wide, Capsule(), random_stream(seed, 0, "parameters"))
        assert M == 0.35 + (0.75 - 0.35) * shares[0]
        assert mu == pytest.approx(0.005 * (0.3 / 0.005) ** shares[1], rel=1e-15)
        # Ranges do not shift the stream, and a constant without a range is the capsule's own.
        found = draw_plant(uniform, Capsule(M=0.7), random_stream(seed, 0, "parameters"))
        assert found == (0.7, 0.1 + (0.4 - 0.1) * shares[1])
    assert draw_plant(wide, Capsule(), SimpleNamespace(random=np.zeros)) == (0.35, 0.005)
    middle = SimpleNamespace(random=lambda count: np.full(count, 0.5))
    assert draw_plant(Randomization(mu=(0.1, 0.1), log_mu=True), Capsule(M=0.7), middle) == (
        0.7,
        0.1,
    )


def test_rows_must_name_environments():
    simulation = Simulation(130)
    simulation.reset(np.arange(130)[::-1])
    for wrong in ([0, -1], [130], [2**40, 0]):
        before = simulation.world.copy()
        with pytest.raises(IndexError, match="rows must be indices of environments"):
            simulation.reset(np.array(wrong))
        assert simulation.world.tobytes() == before.tobytes()
