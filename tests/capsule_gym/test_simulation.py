"""A batch of environments: every quantity equals that of the environment alone, in any lane, block and thread."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest

from capsule_gym import Capsule, Controller, Randomization, dynamics
from capsule_gym.config import EnvConfig
from capsule_gym.layout import Row
from capsule_gym.settings import STABLE
from capsule_gym.simulation import Simulation
from capsule_gym.task import Termination
from tests.capsule_gym.fakes import picky_controller


def test_a_substep_in_which_contact_is_lost_is_that_of_the_plant():
    capsule = Capsule(mu=0.3)
    simulation = Simulation(1, EnvConfig(capsule=capsule, control_dt=0.002))
    state = (-0.4, 18.0, 0.0, 2.0)
    simulation.reset(np.array([0]), [capsule.M], [capsule.mu], np.array([state]))
    simulation.step_one(0.0)
    motion = dynamics.step(*state, 0.0, capsule.plant(), 0.002)
    assert motion.normal_force == 0.0
    rows = (Row.theta, Row.theta_dot, Row.x, Row.x_dot)
    assert simulation.columns(np.array([0]))[list(rows), 0].tolist() == [float(each) for each in motion[:4]]


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
def test_more_substeps_than_a_step_should_take_are_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        Simulation(1, EnvConfig(**kwargs))


def test_the_integrator_is_stable_where_it_is_said_to_be():
    z = STABLE * np.exp(1j * np.linspace(0.5 * np.pi, np.pi, 1001))
    growth = np.abs(1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0)
    assert growth.max() < 1.0


@pytest.mark.parametrize("fields", [{"c": 20.0}, {"k": 40_000.0}, {"m": 1e-4}, {"l": 0.005}])
def test_a_plant_too_stiff_for_the_step_is_refused_with_a_step_that_would_do(fields):
    capsule = Capsule(**fields)
    with pytest.raises(ValueError, match=r"^physics_dt must be at most \S+ s .* would do, got 0\.002 s$") as caught:
        Simulation(1, EnvConfig(capsule=capsule))
    would_do = float(re.search(r"physics_dt=(\S+) would do", str(caught.value))[1])
    simulation = Simulation(1, EnvConfig(capsule=capsule, physics_dt=would_do))
    # The simulation runs with this step, and refuses a step a quarter longer.
    simulation.reset(np.array([0]))
    for _ in range(50):
        simulation.step_one(0.0)
        if simulation.row(Row.termination)[0] != 0.0:
            break
    assert simulation.row(Row.termination)[0] != Termination.diverged
    with pytest.raises(ValueError, match=r"^physics_dt must be at most"):
        Simulation(1, EnvConfig(capsule=capsule, control_dt=20.0 * would_do, physics_dt=1.25 * would_do))
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
    with pytest.raises(ValueError, match=r"^num_envs must fit into memory, got 99: Unable"):
        Simulation(99)


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
