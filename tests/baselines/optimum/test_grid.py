import numpy as np
import pytest

from baselines.optimum.grid import DEAD, Grid
from baselines.optimum.solver import values_at
from capsule_gym import Capsule


def grid(shape=(11, 12, 9)):
    return Grid(shape, (-6.0, 20.0), (-2.0, 5.0), 0.5)


def test_nodes_lie_at_their_own_positions():
    own = grid()
    states = own.nodes()
    expected = np.stack(np.meshgrid(*(np.arange(n) for n in own.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    # Rounding may put the outermost off the grid; beyond the clip of theta_dot others are meant.
    inner = ((expected > 0) & (expected < np.array(own.shape) - 1)).all(axis=1)
    reached = inner & (np.abs(states[1]) < 39.0)
    # What the clip at the last cell moves is far less than this.
    np.testing.assert_allclose(own.positions(states)[reached], expected[reached], atol=2e-4)
    assert reached.mean() > 0.4


def test_sticking_lies_on_nodes():
    states = grid().nodes()
    assert (states[2] == 0.0).sum() == 11 * 9
    position = grid().positions(np.array([[0.3], [2.0], [0.0]]))[0, 1]
    assert position == pytest.approx(round(position), abs=1e-5)


def test_off_the_grid_is_dead():
    states = np.array([[0.0, 0.0, 1.6, 0.0], [0.0, 0.0, 0.0, 30.0], [0.0, 2.0, 0.0, 0.0]])
    positions = grid().positions(states)
    assert (positions[0] >= 0.0).all()
    assert (positions[1:, 0] == DEAD).all()


def test_interpolation_is_exact_for_what_is_linear_and_bends_as_said():
    own = grid()
    rng = np.random.default_rng(0)
    places = (rng.random((50, 3)) * (np.array(own.shape) - 1.01)).astype(np.float32)
    a, b, c = np.meshgrid(*(np.arange(n) for n in own.shape), indexing="ij")
    values = (2.0 * a - 3.0 * b + 0.7 * c + 0.5 * c * c).astype(np.float32)
    found = values_at(values, places, 0.5)
    x, y, z = places.astype(np.float64).T
    np.testing.assert_allclose(found, 2.0 * x - 3.0 * y + 0.7 * z + 0.5 * z * z, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(
    ("shape", "y", "w", "named"),
    [
        ((3, 9, 9), (-1.0, 1.0), (-1.0, 1.0), "shape"),
        ((9, 9), (-1.0, 1.0), (-1.0, 1.0), "shape"),
        ((9, 9, 9), (1.0, 2.0), (-1.0, 1.0), "y must be"),
        ((9, 9, 9), (-1.0, 1.0), (1.0, 1.0), "w must be"),
    ],
)
def test_no_grid_is_named(shape, y, w, named):
    with pytest.raises(ValueError, match=named):
        Grid(shape, y, w, 0.5, Capsule())
