import re

import numpy as np
import pytest

from benchmarks import accuracy
from benchmarks.mujoco import FRICTIONS, build, hold
from capsule_gym.parameters import Capsule
from tests.project.test_pages import ROOT

PAGE = (ROOT / "docs/error_table.md").read_text(encoding="utf-8")


@pytest.fixture
def rows(monkeypatch, tmp_path):
    """The table of a few short trajectories."""
    monkeypatch.setattr(accuracy, "FRICTION", (0.1,))
    monkeypatch.setattr(accuracy, "AMPLITUDES", (0.5,))
    monkeypatch.setattr(accuracy, "TRAJECTORIES", 2)
    monkeypatch.setattr(accuracy, "PLANTS", 2)
    monkeypatch.setattr(accuracy, "SECONDS", 1.0)
    path = tmp_path / "page.md"
    assert accuracy.main(["--markdown", str(path)]) == 0
    head, _, *rows = path.read_text(encoding="utf-8").splitlines()[2:6]
    return [line.strip("|").split("|") for line in (head, *rows)]


def test_the_table_names_steps_plants_and_durations(rows):
    head, *found = rows
    assert head[2:] == ["0.25 ms", "0.5 ms", "1 ms", "2 ms", "5 ms", "10 ms", "length"]
    names = [[row[0], row[1], row[-1]] for row in found]
    assert names == [["μ = 0.1", "±0.5", "1.0 s"], ["2 random", "±0.7", "1.0 s"]]


def test_errors_of_the_step_grow_with_it(rows):
    for row in rows[1:]:
        cells = [re.findall(r"\d\S*e-\d+", cell) for cell in row[2:-1]]
        largest, median = np.array(cells, float).T
        assert sorted(largest) == largest.tolist()
        assert (median <= largest).all()
        assert largest[2] < 1e-7
        # Of fourth order, from 10 ms to 1 ms.
        assert median[5] / median[2] > 10.0**3.5


def test_the_errors_of_the_documentation_are_those_of_the_step():
    solved = accuracy.expected_trajectories([Capsule(mu=0.3)] * accuracy.TRAJECTORIES, 1.5)
    cells = []
    # Smaller steps are as accurate as the reference.
    for step in accuracy.STEPS[2:]:
        errors = [accuracy.run(torques, plant, step) - state for plant, torques, state in solved]
        cells.append(accuracy.cell([abs(error).max() for error in errors]))
    assert f"|{'|'.join(cells)}|2.4 s|" in PAGE


class AheadByOneMillimetre:
    """Stands for `benchmarks.mujoco`."""

    FRICTIONS = ("1 mm ahead",)

    def build(self, friction, step, capsule):
        return capsule, []

    def creep(self, capsule, torques, load):
        return load

    def hold(self, capsule, torques, torque):
        torques.append(torque)
        theta, theta_dot, x, x_dot = accuracy.run(torques, capsule, 1e-3)
        return np.array([theta, theta_dot, x + 1e-3, x_dot])


def test_mujoco_is_compared_by_its_errors_and_its_creep(monkeypatch):
    monkeypatch.setattr(accuracy, "mujoco", AheadByOneMillimetre())
    monkeypatch.setattr(accuracy, "SECONDS", 0.1)
    head, (name, speed, *errors), ahead = accuracy.compare_mujoco()
    assert f"|{'|'.join(head)}|\n" in PAGE
    assert (name, speed) == ("capsule_gym", "0")
    assert max(float(cell.split()[0]) for cell in errors) < 1e-4
    # Half of the friction's limit.
    load = 0.5 * 0.1 * (Capsule().M + Capsule().m) * Capsule().g
    assert ahead == ["MuJoCo, 1 mm ahead", f"{load:.0e}", *["1.0e+00 (1.0e+00)"] * 4]


TORQUES = np.random.default_rng(0).uniform(-0.5, 0.5, 100)


def mujoco_error(friction, mu, mu_of_mujoco):
    """The largest difference of a state after 2 s, with a Runge-Kutta method in MuJoCo."""
    integrator = pytest.importorskip("mujoco").mjtIntegrator.mjINT_RK4
    model, data = build(friction, 1e-3, Capsule(mu=mu_of_mujoco))
    model.opt.integrator = integrator
    state = [hold(model, data, torque) for torque in TORQUES][-1]
    return np.abs(state - accuracy.run(TORQUES, Capsule(mu=mu), 1e-3)).max()


def test_mujoco_has_the_same_plant():
    assert mujoco_error("frictionloss", 0.0, 0.0) < 1e-8


@pytest.mark.parametrize("friction", FRICTIONS)
def test_mujoco_has_about_the_same_friction(friction):
    error = mujoco_error(friction, 0.1, 0.1)
    assert error < 0.03
    assert mujoco_error(friction, 0.0, 0.1) > 5.0 * error
