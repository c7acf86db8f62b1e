"""How a law gets into the kernels: fingerprints, the disk cache across processes, packing."""

from __future__ import annotations

import numba
import numpy as np

from capsule_gym import Capsule, kernels
from capsule_gym.kernels import LANES, Row, Settings, pack, unpack
from tests.capsule_gym.fakes import helper, make_law

PLANT = Capsule().plant()


def test_kernels_of_the_same_law_are_built_once():
    assert kernels.build(make_law(0.5, numba.njit(helper)), 1, 2, 0.0) is kernels.build(
        make_law(0.5, numba.njit(helper)), 1, 2, 0.0
    )
    assert kernels.build(make_law(0.5, numba.njit(helper)), 1, 2, 0.0) is not kernels.build(
        make_law(0.6, numba.njit(helper)), 1, 2, 0.0
    )
    assert kernels.build(make_law(0.5, numba.njit(helper)), 1, 2, 0.0) is not kernels.build(
        make_law(0.5, numba.njit(helper)), 2, 2, 0.0
    )
    assert kernels.build(make_law(0.5, numba.njit(helper)), 1, 2, 0.0) is not kernels.build(
        make_law(0.5, numba.njit(helper)), 1, 2, 1.0
    )


def test_laws_of_one_factory_never_share_a_symbol():
    # numba's symbols hold the name and a counter of the process: equal names, compiled in different processes and
    # loaded from the disk cache into one, would be the same symbol to the linker, and one law would run as the other.
    def names(gain):
        kernel = kernels.build(make_law(gain, numba.njit(helper)), 1, 2, 0.0).py_func
        bound = kernel.__globals__["consult"].__globals__["law"].py_func
        inner = next(c.cell_contents for c in bound.__closure__ if hasattr(c.cell_contents, "py_func"))
        return {bound.__name__, bound.__qualname__, inner.py_func.__name__, inner.py_func.__qualname__}

    assert not names(0.71) & names(0.72)


def test_plant_and_settings_survive_packing():
    settings = Settings(1.5, 3.0, 1e-3, 7, 20, 0.1, 10.0, True, False)
    fixed = pack(PLANT, settings, np.zeros((3, 2)))
    plant, again = numba.njit(unpack)(fixed, PLANT.pivot_torque_on_contact)
    assert plant == PLANT
    assert again == settings
    assert all(isinstance(value, (int, np.integer)) for value in (again.physics_steps, again.law_steps))


def test_rows_lie_in_order():
    assert kernels.ROWS == len(Row)
    assert list(Row) == list(range(len(Row)))
    assert {name: row * LANES for name, row in Row._asdict().items()} == kernels.AT._asdict()
    # The two blocks of rows that others read as a whole.
    assert Row._fields[Row.theta : Row.M] == ("theta", "theta_dot", "x", "x_dot")
    assert Row._fields[Row.reward_progress : Row.reward] == ("reward_progress", "reward_energy", "reward_termination")
