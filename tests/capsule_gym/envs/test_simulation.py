"""A batch of environments: the plants and steps that it accepts, and what its episodes draw."""

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

TOO_STIFF = "^physics_dt must be at most"
FIRST = np.array([0])


def test_the_integrator_is_stable_where_it_is_said_to_be_and_not_much_further():
    stable = STABLE * np.exp(1j * np.linspace(0.5 * np.pi, np.pi, 1001))
    growth = [
        np.abs(1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0) for z in (stable, 1.1 * stable)
    ]
    assert growth[0].max() < 1.0
    assert growth[1].max() > 1.0


STIFF = pytest.mark.parametrize("fields", [{"c": 20.0}, {"k": 40_000.0}, {"m": 1e-4}, {"l": 0.005}])


def step_for(capsule):
    """The longest step in s that the error for a stiff plant accepts, and the advised one."""
    message = TOO_STIFF + r" (\S+) s .* physics_dt=(\S+) would do, got 0\.002 s$"
    with pytest.raises(ValueError, match=message) as caught:
        Simulation(1, EnvConfig(capsule=capsule))
    return map(float, re.search(message, str(caught.value)).groups())


@STIFF
def test_a_plant_too_stiff_for_the_step_is_refused_with_a_step_that_would_do(fields):
    capsule = Capsule(**fields)
    longest, would_do = step_for(capsule)
    assert would_do < 1.001 * longest < 1.25 * would_do
    simulation = Simulation(1, EnvConfig(capsule=capsule, physics_dt=would_do))
    simulation.reset(FIRST)
    for _ in range(50):
        simulation.step_one(0.0)
        if simulation.row(Row.termination)[0] != 0.0:
            break
    assert simulation.row(Row.termination)[0] != Termination.diverged


@STIFF
def test_a_step_a_quarter_longer_than_the_advised_one_is_refused(fields):
    capsule = Capsule(**fields)
    _, would_do = step_for(capsule)
    longer = EnvConfig(capsule=capsule, control_dt=20.0 * would_do, physics_dt=1.25 * would_do)
    with pytest.raises(ValueError, match=TOO_STIFF):
        Simulation(1, longer)


# With a law, 200,000 steps in each of 20 of the law would do, but are too many in one of the agent.
@pytest.mark.parametrize(("controller", "c"), [(None, 1e9), ("baselines:adaptive", 6.6e6)])
def test_no_step_would_do_for_a_plant_that_is_much_too_stiff(controller, c):
    with pytest.raises(ValueError, match=TOO_STIFF + ".*; no step would do"):
        Simulation(1, EnvConfig(controller=controller, capsule=Capsule(c=c)))


VISCOUS = Capsule(c=8.0)


@pytest.mark.parametrize(
    ("ranges", "said"),
    [
        ({"M": (0.02, 0.5)}, r"with M=0\.02 kg and mu=0\.01"),
        ({"mu": (0, 4.0)}, "and mu=4, whose"),
    ],
)
def test_every_plant_that_an_episode_may_draw_must_fit_the_step(ranges, said):
    options = EnvConfig(capsule=VISCOUS, randomization=Randomization(**ranges))
    with pytest.raises(ValueError, match=f"{TOO_STIFF} .* {said}"):
        Simulation(1, options)


HEAVY = {"t": 1.0, "M": 0.02, "mu": 0.01}


@pytest.mark.parametrize("given", [{"M": [0.02]}, {"mu": [4.0]}, {"changes": [[HEAVY]]}])
def test_every_plant_of_a_reset_must_fit_the_step(given):
    simulation = Simulation(1, EnvConfig(capsule=VISCOUS))
    simulation.reset(FIRST, M=[0.4], mu=[0.3])
    with pytest.raises(ValueError, match="physics_dt must be at most"):
        simulation.reset(FIRST, **given)


@pytest.mark.parametrize(
    "given",
    [
        {"capsule": [{"c": 8.0}], "changes": [[HEAVY]]},
        {"disturbances": [{"motor_friction": 100.0}]},
    ],
)
def test_every_constant_of_a_reset_must_fit_the_step(given):
    simulation = Simulation(1, EnvConfig(randomization=Randomization(c=(0.1, 8.0))))
    with pytest.raises(ValueError, match="physics_dt must be at most"):
        simulation.reset(FIRST, **given)


def test_the_largest_batch_takes_some_15_gb():
    assert 1.2e10 < MOST_ENVS / LANES * Simulation(LANES).world.nbytes < 1.8e10


def test_a_batch_for_which_there_is_no_memory_says_so(monkeypatch):
    def zeros(*arguments):
        raise MemoryError("Unable to allocate 7 GiB")

    monkeypatch.setattr(np, "zeros", zeros)
    with pytest.raises(ValueError, match=r"^num_envs must fit into memory, got 99: Unable"):
        Simulation(99)


def test_a_pickle_whose_law_has_another_memory_now_is_refused(monkeypatch):
    # Compiled code would write beyond the rows of its environments.
    packed = pickle.dumps(Simulation(1, EnvConfig(controller=f"{__name__}:picky_controller")))

    def law(theta, theta_dot, x, x_dot, memory, reference):
        return 0.0, memory

    longer = Controller("longer", law, np.zeros((1, 2)), (0.0, 0.0))
    monkeypatch.setitem(globals(), "picky_controller", lambda: longer)
    with pytest.raises(ValueError, match=r"controller='.*:picky_controller' must be as it was"):
        pickle.loads(packed)


def test_a_jump_that_a_reset_cancels_never_comes():
    simulation = Simulation(2)
    change = {"M": 0.6, "mu": 0.02}
    simulation.reset(np.arange(2), changes=[[{"t": 0.2, **change}], [{"t": 0.1, **change}]])
    simulation.reset(np.array([1]))
    _, M = simulation.row(Row.M)
    for _ in range(12):
        simulation.step(np.zeros(2))
    assert simulation.row(Row.M).tolist() == [0.6, M]


SEEDS = (0, 1, 12345, 2**63, 2**64 - 1, 2**64, 2**100 + 7, 2**128 - 1, 2**128 + 1)
EPISODES = range(10)


def episodes(**options):
    """Yields the seed, the number and the rows of episodes of several seeds, and the simulation."""
    simulation = Simulation(len(SEEDS), EnvConfig(capsule=Capsule(M=0.6), **options))
    for i, seed in enumerate(SEEDS):
        simulation.seed(i, seed)
    every = np.arange(len(SEEDS))
    for episode in EPISODES:
        simulation.reset(every)
        for seed, rows in zip(SEEDS, simulation.columns(every).T, strict=True):
            yield seed, episode, rows, simulation


@pytest.mark.parametrize(
    "randomization",
    [
        "none",
        "paper",
        "wide",
        Randomization(mu=(0.01, 0.2), log_mu=True),
        Randomization(M=(0.4, 0.5)),
    ],
    ids=str,
)
@pytest.mark.parametrize("start", [{"initial_noise": 0.05}, {"initial_range": (1.0, 8.0)}], ids=str)
def test_plants_are_the_numbers_of_numpys_philox_bit_for_bit(start, randomization):
    for seed, episode, rows, simulation in episodes(randomization=randomization, **start):
        stream = random_stream(seed, episode, "parameters")
        plant = draw_plant(simulation.randomization, simulation.capsule, stream)
        assert (rows[Row.M], rows[Row.mu]) == plant
        # A constant that is not drawn is the present capsule's.
        if simulation.randomization.M is None:
            assert rows[Row.M] == 0.6


@pytest.mark.parametrize(
    ("options", "start", "widths"),
    [
        ({"initial_noise": 0.05}, START_THETA, (0.05, 0.0)),
        ({"initial_range": (1.0, 8.0)}, 0.0, (1.0, 8.0)),
    ],
    ids=["noise", "range"],
)
def test_starts_are_the_numbers_of_numpys_philox_bit_for_bit(options, start, widths):
    for seed, episode, rows, _ in episodes(randomization="wide", **options):
        noise = random_stream(seed, episode, "initial_state").uniform(-1.0, 1.0, 2)
        theta = start + widths[0] * noise[0]
        theta_dot = widths[1] * noise[1]
        assert (rows[Row.theta], rows[Row.theta_dot]) == (theta, theta_dot)
        assert rows[Row.largest_theta] == abs(theta)
        assert rows[Row.largest_theta_dot] == abs(theta_dot)


def parameters(seed):
    return random_stream(seed, 0, "parameters")


@pytest.mark.parametrize("seed", range(100))
def test_a_range_is_drawn_as_its_formula_says(seed):
    M_share, mu_share = parameters(seed).random(2).tolist()
    M, mu = draw_plant(Randomization.named("wide"), Capsule(), parameters(seed))
    assert M == 0.35 + (0.75 - 0.35) * M_share
    assert mu == pytest.approx(0.005 * (0.3 / 0.005) ** mu_share, rel=1e-15)
    # Ranges do not shift the stream, and a constant without a range is the capsule's own.
    found = draw_plant(Randomization(mu=(0.1, 0.4)), Capsule(M=0.7), parameters(seed))
    assert found == (0.7, 0.1 + (0.4 - 0.1) * mu_share)


def test_the_ends_of_a_range_are_drawn_exactly():
    lowest = SimpleNamespace(random=np.zeros)
    assert draw_plant(Randomization.named("wide"), Capsule(), lowest) == (0.35, 0.005)
    middle = SimpleNamespace(random=lambda count: np.full(count, 0.5))
    point = Randomization(mu=(0.1, 0.1), log_mu=True)
    assert draw_plant(point, Capsule(M=0.7), middle) == (0.7, 0.1)


@pytest.mark.parametrize("width", [1e-6, 0.25, 0.5, 1.0])
def test_a_range_of_any_width_is_drawn(width):
    simulation = Simulation(8, EnvConfig(randomization=Randomization(M=(0.5, 0.5 + width))))
    for i in range(8):
        simulation.seed(i, i)
    simulation.reset(np.arange(8))
    assert len({*simulation.row(Row.M)}) == 8


@pytest.mark.parametrize("wrong", [[0, -1], [130], [2**40, 0]])
def test_rows_must_name_environments(wrong):
    simulation = Simulation(130)
    simulation.reset(np.arange(130)[::-1])
    before = simulation.world.copy()
    with pytest.raises(IndexError, match="rows must be indices of environments"):
        simulation.reset(np.array(wrong))
    assert simulation.world.tobytes() == before.tobytes()
