"""How a law gets into the kernels: fingerprints, the disk cache across processes, packing."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from capsule_gym import Capsule, kernels, layout
from capsule_gym.compilation import OPTIONS, compile_cached
from capsule_gym.layout import LANES, Row, StepSettings, pack, unpack
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


def three_from(array: np.ndarray, start: int) -> tuple[float, ...]:
    return layout.load(array, start, 2, 3)


def two_to(array: np.ndarray, start: int) -> None:
    layout.store(array, start, 1, (1.0, 2.0))


def settings_at(array: np.ndarray, start: int) -> StepSettings:
    return layout.record(array, start, StepSettings)


@pytest.mark.parametrize(
    ("function", "last"), [(three_from, 7), (two_to, 10), (settings_at, 12 - len(StepSettings._fields))]
)
def test_numbas_boundscheck_reaches_what_is_read_and_written_by_offset(function, last, monkeypatch):
    monkeypatch.setattr(numba.config, "BOUNDSCHECK", 1)
    compiled = numba.njit(function, **OPTIONS)
    compiled(np.zeros(12), last)
    for start in (last + 1, -1):
        with pytest.raises(IndexError):
            compiled(np.zeros(12), start)


def test_checked_code_is_kept_apart(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    array = np.arange(12.0)
    for boundscheck in (None, 1, None):
        monkeypatch.setattr(numba.config, "BOUNDSCHECK", boundscheck)
        assert compile_cached(three_from)(array, 1) == (1.0, 3.0, 5.0)
    assert len(list(tmp_path.rglob("*.nbc"))) == 2


def test_laws_of_one_factory_never_share_a_symbol():
    # numba's symbols hold the name and a counter of the process: equal names, compiled in different processes and
    # loaded from the disk cache into one, would be the same symbol to the linker, and one law would run as the other.
    def names(gain):
        kernel = kernels.build(make_law(gain, numba.njit(helper)), 1, 2, 0.0).py_func
        bound = kernel.__globals__["call_controller"].__globals__["law"].py_func
        inner = next(c.cell_contents for c in bound.__closure__ if hasattr(c.cell_contents, "py_func"))
        return {bound.__name__, bound.__qualname__, inner.py_func.__name__, inner.py_func.__qualname__}

    assert not names(0.71) & names(0.72)


def test_plant_and_settings_survive_packing():
    settings = StepSettings(1.5, 3.0, 1e-3, 7, 20, 0.1, 10.0, True, False)
    fixed = pack(PLANT, settings, np.zeros((3, 2)))
    plant, again = numba.njit(unpack)(fixed, PLANT.pivot_torque_on_contact)
    assert plant == PLANT
    assert again == settings
    assert all(isinstance(value, (int, np.integer)) for value in (again.physics_steps, again.law_steps))


def test_packed_numbers_are_float64_also_where_an_integer_fits_no_type_of_numpy():
    fixed = pack(PLANT, StepSettings(1, 1, 1, 10**300, 1, 0, 0, False, False), np.zeros((3, 2), np.float32))
    assert fixed.dtype == np.float64 and fixed.shape == (layout.CONSTANTS + 6,)
    with pytest.raises(OverflowError):
        pack(PLANT, StepSettings(1, 1, 1, 10**400, 1, 0, 0, False, False), np.zeros((3, 2)))


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((4, 3), object),
        np.zeros((4, 3), np.float32),
        np.zeros((4, 3), np.dtype(np.float64).newbyteorder()),
        np.zeros((4, 2)),
        np.zeros(12),
        np.zeros((3, 4)).T,
        np.zeros((4, 6))[:, ::2],
        np.zeros(97, np.uint8)[1:].view(np.float64).reshape(4, 3),
        [[0.0] * 3] * 4,
    ],
)
def test_arrays_that_compiled_code_would_misread_are_refused(array):
    layout.check_arrays(world=(np.zeros((4, 3)), np.float64, (None, 3)))
    with pytest.raises(TypeError, match=r"^world must be a contiguous array of float64 of shape \(None, 3\), got "):
        layout.check_arrays(world=(array, np.float64, (None, 3)))


def test_rows_lie_in_order():
    assert layout.ROWS == len(Row)
    assert list(Row) == list(range(len(Row)))
    assert {name: row * LANES for name, row in Row._asdict().items()} == layout.AT._asdict()
    # The two blocks of rows that others read as a whole.
    assert Row._fields[Row.theta : Row.M] == ("theta", "theta_dot", "x", "x_dot")
    assert Row._fields[Row.reward_progress : Row.reward] == ("reward_progress", "reward_energy", "reward_termination")
