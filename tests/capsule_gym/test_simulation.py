"""Environments side by side: every quantity is that of the environment alone, in any lane, block and thread."""

from __future__ import annotations

import copy
import pickle
import re
from typing import Any, NamedTuple

import numpy as np
import pytest

from capsule_gym import Capsule, Controller, Randomization
from capsule_gym.layout import ROWS, Row
from capsule_gym.parameters import EnvConfig
from capsule_gym.simulation import STABLE, Simulation, divide
from capsule_gym.task import METRICS, Termination
from tests.capsule_gym.fakes import EPISODE_ROWS, picky_controller

VARIANTS = [
    {},
    {"controller": "baselines:adaptive", "residual_limit": 3.0, "observe_parameters": True},
]


LANE_STEPS = 60


LARGEST_BATCH = 200


class Alone(NamedTuple):
    """Environments that have each been stepped alone until they failed; one entry or row per step.

    Attributes:
        kwargs: what they were made with.
        actions: shape (steps, environments); the torques differ by a factor of ten between environments.
        running: who took part, shape (steps, environments).
        columns: every row of `world`, shape (steps, rows, environments).
        observations: shape (steps, environments, entries).
        metrics: at the end, each of shape (environments,).
    """

    kwargs: dict[str, Any]
    actions: np.ndarray
    running: np.ndarray
    columns: np.ndarray
    observations: np.ndarray
    metrics: dict[str, np.ndarray]


@pytest.fixture(scope="module", params=VARIANTS, ids=["direct", "adaptive"])
def alone(request) -> Alone:
    kwargs = {"initial_noise": 0.05, "randomization": "wide", **request.param}
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (LANE_STEPS, LARGEST_BATCH)) * rng.uniform(0.1, 1.0, LARGEST_BATCH)
    running = np.zeros(actions.shape, bool)
    columns, observations, metrics = [], [], []
    for i in range(LARGEST_BATCH):
        simulation = Simulation(1, EnvConfig(**kwargs))
        simulation.seed(0, i)
        simulation.reset(np.array([0]))
        trace, seen = [], []
        for n in range(LANE_STEPS):
            running[n, i] = simulation.world[0, Row.termination, 0] == 0.0
            if running[n, i]:
                simulation.step_one(actions[n, i])
            trace.append(simulation.world[0, :, 0].copy())
            seen.append(simulation.observations[0].copy())
        columns.append(trace)
        observations.append(seen)
        metrics.append(simulation.metrics(np.array([0]), LANE_STEPS))
    joined = {name: np.concatenate([one[name] for one in metrics]) for name in METRICS}
    axes = (1, 2, 0)
    return Alone(kwargs, actions, running, np.transpose(columns, axes), np.array(observations).swapaxes(0, 1), joined)


def count_off_grid(times: np.ndarray, step: float) -> int:
    """How many are no whole multiple of the step."""
    return np.count_nonzero(np.abs(times / step - np.round(times / step)) > 1e-6)


def test_the_lanes_meet_everything_that_can_happen(alone):
    # Of the first block, so that every batch below but the smallest has it all side by side.
    columns, running = alone.columns[:, :, :63], alone.running[:, :63]
    directions = np.sign(columns[:, Row.x_dot])
    assert np.count_nonzero(np.diff(directions, axis=0)) > 500
    assert sum({-1.0, 0.0, 1.0} <= set(row) for row in directions) > LANE_STEPS // 2
    failed = columns[-1, Row.termination] != 0.0
    assert 3 <= np.count_nonzero(failed) <= 40
    assert len(set(running.sum(axis=0))) >= 4
    # Phases change within steps of the integrator, and episodes end within steps of the agent.
    simulation = Simulation(1, EnvConfig(**alone.kwargs))
    assert count_off_grid(columns[-1, Row.stuck], simulation.settings.physics_dt) > 30
    assert count_off_grid(columns[-1, Row.duration, failed], simulation.options.control_dt) > 0


@pytest.mark.parametrize(("n", "threads"), [(1, 1), (63, 1), (65, 2), (LARGEST_BATCH, 3)])
def test_every_quantity_is_that_of_the_environment_alone(alone, n, threads):
    simulation = Simulation(n, EnvConfig(threads=threads, **alone.kwargs))
    for i in range(n):
        simulation.seed(i, i)
    simulation.reset(np.arange(n))
    own_rows = [*EPISODE_ROWS, *range(ROWS, simulation.world.shape[1])]
    for step in range(LANE_STEPS):
        running = alone.running[step, :n]
        simulation.step(alone.actions[step, :n], None if running.all() else running)
        columns, expected = simulation.columns(np.arange(n)), alone.columns[step, :, :n].copy()
        # Who stands still earns nothing; all else stays as the last step has left it.
        expected[Row.reward, ~running] = 0.0
        for row in own_rows:
            assert columns[row].tobytes() == expected[row].tobytes(), (step, row)
        assert simulation.observations.tobytes() == alone.observations[step, :n].tobytes(), step
    for name, values in simulation.metrics(np.arange(n), LANE_STEPS).items():
        assert values.tobytes() == alone.metrics[name][:n].tobytes(), name
    simulation.close()


def test_steps_divide_each_other_or_say_which_does_not():
    assert divide("control_dt", 0.02, "physics_dt", 0.001) == 20
    assert divide("control_dt", 0.3, "physics_dt", 0.1) == 3
    for part in (0.003, 0.04, 0.02 * (1.0 + 1e-6)):
        with pytest.raises(ValueError, match=r"physics_dt must divide control_dt=0\.02 s"):
            divide("control_dt", 0.02, "physics_dt", part)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"control_dt": 1e300}, r"^control_dt must be .* \(s\), at most 1e\+06, got 1e\+300"),
        ({"physics_dt": 1e-25}, r"^physics_dt must be .*>= 1e-09 \(s\).*, got 1e-25"),
        ({"control_dt": 1e-320, "physics_dt": 1e-320}, "^control_dt must be .*, got 1e-320"),
        ({"control_dt": 1e6}, r"^control_dt must be at most 1000000 times physics_dt=0\.002 s, got 1000000\.0 s"),
        ({"physics_dt": 1e-9}, r"^control_dt must be at most 1000000 times physics_dt=1e-09 s, got 0\.02 s"),
        ({"physics_dt": 1e-9, "controller": "baselines:adaptive"}, "^control_dt must be at most 1000000 times"),
    ],
)
def test_more_substeps_than_a_kernel_should_take_are_refused(kwargs, message):
    # Once counts that fit no integer made an array of objects, and the kernel wrote beyond it.
    with pytest.raises(ValueError, match=message):
        Simulation(1, EnvConfig(**kwargs))


def test_a_million_substeps_are_taken():
    simulation = Simulation(1, EnvConfig(control_dt=1.0, physics_dt=1e-6))
    simulation.reset(np.array([0]))
    simulation.step_one(0.0)
    assert simulation.row(Row.duration)[0] == pytest.approx(1.0)


def test_the_integrator_is_stable_where_it_is_said_to_be():
    z = STABLE * np.exp(1j * np.linspace(0.5 * np.pi, np.pi, 1001))
    growth = np.abs(1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0)
    assert growth.max() < 1.0


STIFF = {"damper": {"c": 20.0}, "spring": {"k": 40_000.0}, "light ball": {"m": 1e-4}, "short": {"l": 0.005}}


@pytest.mark.parametrize("fields", STIFF.values(), ids=STIFF)
def test_a_plant_too_stiff_for_the_step_is_refused_with_a_step_that_would_do(fields):
    capsule = Capsule(**fields)
    with pytest.raises(ValueError, match=r"^physics_dt must be at most \S+ s .* would do, got 0\.002 s$") as caught:
        Simulation(1, EnvConfig(capsule=capsule))
    would_do = float(re.search(r"physics_dt=(\S+) would do", str(caught.value))[1])
    simulation = Simulation(1, EnvConfig(capsule=capsule, physics_dt=would_do))
    # With that it runs, and with a quarter more it is refused.
    simulation.reset(np.array([0]))
    for _ in range(50):
        simulation.step_one(0.0)
        if simulation.row(Row.termination)[0] != 0.0:
            break
    assert simulation.row(Row.termination)[0] != Termination.diverged
    with pytest.raises(ValueError, match=r"^physics_dt must be at most"):
        Simulation(1, EnvConfig(capsule=capsule, control_dt=20.0 * would_do, physics_dt=1.25 * would_do))


def test_a_plant_that_no_step_resolves_is_refused():
    with pytest.raises(ValueError, match=r"^physics_dt must be at most .*; no step would do"):
        Simulation(1, EnvConfig(capsule=Capsule(c=1e9)))


def test_every_plant_of_an_episode_must_fit_the_step():
    capsule = Capsule(c=8.0)
    light = Randomization(M=(0.02, 0.5))
    with pytest.raises(ValueError, match=r"^physics_dt must be at most .* with M=0\.02 kg and mu=0\.01"):
        Simulation(1, EnvConfig(capsule=capsule, randomization=light))
    with pytest.raises(ValueError, match=r"^physics_dt must be at most .* and mu=4, whose"):
        Simulation(1, EnvConfig(capsule=capsule, randomization=Randomization(mu=(0.0, 4.0))))
    simulation = Simulation(1, EnvConfig(capsule=capsule))
    for given in ({"M": [0.02]}, {"mu": [4.0]}, {"changes": [[{"t": 1.0, "M": 0.02, "mu": 0.01}]]}):
        with pytest.raises(ValueError, match="physics_dt must be at most"):
            simulation.reset(np.array([0]), **given)
    simulation.reset(np.array([0]), M=[0.4], mu=[0.3])


def test_a_batch_for_which_there_is_no_memory_says_so(monkeypatch):
    def zeros(*arguments):
        raise MemoryError("Unable to allocate 7 GiB")

    monkeypatch.setattr(np, "zeros", zeros)
    with pytest.raises(ValueError, match=r"^num_envs must be as many as there is memory for, got 99: Unable"):
        Simulation(99)


def test_rows_are_read_and_written_by_environments():
    simulation = Simulation(130)
    values = np.arange(130.0)
    simulation.write(Row.x, values)
    assert np.array_equal(simulation.row(Row.x), values)
    assert np.array_equal(simulation.rows(Row.x_dot, Row.M)[0], np.zeros(130))
    assert np.array_equal(simulation.rows(Row.x, Row.M)[0], values)
    assert np.array_equal(simulation.columns(np.array([3, 129, 64]))[Row.x], [3.0, 129.0, 64.0])
    simulation.row(Row.x)[:] = 0.0
    assert simulation.world[2, Row.x, 1] == 129.0


@pytest.mark.parametrize("make_copy", [copy.deepcopy, lambda whole: pickle.loads(pickle.dumps(whole))])
def test_a_copy_goes_on_bit_for_bit(make_copy):
    n = 150
    simulation = Simulation(n, EnvConfig(threads=2, randomization="wide", **VARIANTS[1]))
    rng = np.random.default_rng(0)
    simulation.reset(np.arange(n), changes=[[{"t": 0.1, "M": 0.6, "mu": 0.02}]] * n)
    simulation.step(rng.uniform(-1.0, 1.0, n), np.arange(n) % 3 > 0)
    twin = make_copy(simulation)
    assert not np.shares_memory(twin.world, simulation.world)
    for _ in range(20):
        actions = rng.uniform(-1.0, 1.0, n)
        for each in (simulation, twin):
            each.step(actions)
        assert twin.world.tobytes() == simulation.world.tobytes()
        assert twin.observations.tobytes() == simulation.observations.tobytes()
    before = simulation.world.copy()
    # The next draws, of the copy alone.
    twin.reset(np.arange(n))
    assert simulation.world.tobytes() == before.tobytes()
    simulation.reset(np.arange(n))
    assert twin.world.tobytes() == simulation.world.tobytes()
    for each in (simulation, twin):
        each.close()


short = picky_controller


def longer() -> Controller:
    return Controller("longer", lambda *arguments: (0.0, arguments[4]), np.zeros((1, 2)), (0.0, 0.0))


def test_a_pickle_whose_law_has_another_memory_now_is_refused(monkeypatch):
    # Compiled code would write beyond the rows of its environments.
    packed = pickle.dumps(Simulation(1, EnvConfig(controller=f"{__name__}:short")))
    monkeypatch.setitem(globals(), "short", longer)
    with pytest.raises(ValueError, match=r"controller='.*:short' must be as it was"):
        pickle.loads(packed)


def test_a_jump_that_a_reset_cancels_never_comes():
    simulation = Simulation(2)
    simulation.reset(np.arange(2), changes=[[{"t": t, "M": 0.6, "mu": 0.02}] for t in (0.2, 0.1)])
    simulation.reset(np.array([1]))
    M = simulation.row(Row.M)[1]
    for _ in range(12):
        simulation.step(np.zeros(2))
    assert simulation.row(Row.M).tolist() == [0.6, M]


def test_what_a_law_has_spoilt_is_not_observed():
    simulation = Simulation(2, EnvConfig(controller=picky_controller))
    with pytest.raises(ValueError, match="in environment 1"):
        simulation.reset(np.arange(2), state=np.array([[0.1, 0.0, 0.0, 0.0], [0.1, 0.0, -6.0, 0.0]]))
    assert np.isfinite(simulation.observations).all()
    assert np.isfinite(simulation.world[0, : Row.steps, :2]).all()
