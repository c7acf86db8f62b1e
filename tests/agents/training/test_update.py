"""The parts of the compiled update: packing, padding, ratios of any size, and its own exponential and tangent."""

import math
import os
import subprocess
import sys

import numba
import numpy as np
import pytest
from llvmlite import binding as llvm

from agents.fast_ppo import arithmetic, update
from agents.fast_ppo.arithmetic import TILE, exponential, multiply, span, tanh, vectors
from agents.fast_ppo.update import LANES, pack, unpack
from capsule_gym.compilation import fingerprint
from capsule_gym.network import Layer

ACTOR, CRITIC = np.array([5, 9, 6, 1]), np.array([7, 3, 1])
SAMPLES = 70


def normal(random: np.random.Generator, *shape: int) -> np.ndarray:
    return random.normal(size=shape).astype(np.float32)


def parameters(random: np.random.Generator) -> tuple[list[Layer], np.ndarray]:
    shapes = [shape for widths in (ACTOR, CRITIC) for shape in zip(widths[1:], widths[:-1], strict=True)]
    return [(normal(random, *shape), normal(random, shape[0])) for shape in shapes], normal(random, 1)


def updated(**changes: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Packed parameters and moments after some steps, and the losses."""
    random = np.random.default_rng(0)
    packed = [pack(*parameters(random)), *(np.zeros_like(pack(*parameters(random))) for _ in range(2))]
    samples = {
        "orders": np.stack([random.permutation(SAMPLES) for _ in range(3)]),
        "inputs": normal(random, SAMPLES, CRITIC[0]),
        **{name: normal(random, SAMPLES) for name in ("actions", "old_log_probs", "advantages", "targets")},
    }
    settings = 32, 0.2, 0.0, 0.5, 0.5, 1e-2, 0, False, -20.0
    losses = update.update(*settings, ACTOR, CRITIC, *(samples | changes).values(), *packed)
    return packed, losses


def test_what_is_packed_is_unpacked():
    (layers, log_std), (copies, copied) = (parameters(np.random.default_rng(seed)) for seed in (0, 1))
    unpack(pack(layers, log_std), copies, copied)
    assert copied == log_std
    for one, other in zip(copies, layers, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


def test_padding_stays_zero():
    # A nonzero padding unit would learn, and count in the norm of the gradient.
    packed, losses = updated()
    assert np.isfinite(losses).all()
    for array in packed:
        layers, log_std = parameters(np.random.default_rng(0))
        unpack(array, layers, log_std)
        np.testing.assert_array_equal(pack(layers, log_std), array)
        assert np.count_nonzero(array) > 10


@pytest.mark.parametrize("outlier", [-1000.0, 1000.0])
def test_probabilities_that_have_become_tiny_or_huge_leave_the_parameters_finite(outlier):
    packed, _ = updated(old_log_probs=np.full(SAMPLES, outlier, np.float32))
    assert all(np.isfinite(array).all() for array in packed)


def test_nan_stays_nan():
    packed, losses = updated(advantages=np.full(SAMPLES, math.nan, np.float32))
    assert np.isnan(packed[0]).any() and np.isnan(losses[0])


def test_the_compiled_code_is_found_again_by_any_process():
    # A default representation or the order of a set would change the name in every process, and all would compile.
    code = "from agents.fast_ppo.update import gradients_of; from capsule_gym.compilation import fingerprint as of"
    code += "; print(of(gradients_of))"
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    found = subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True)
    assert found.stdout.strip() == fingerprint(update.gradients_of)


def test_exponential_and_tangent_are_exact_to_the_rounding_of_float32():
    @numba.njit
    def both(x, exponentials, tangents):
        for n in range(len(x)):
            exponentials[n], tangents[n] = exponential(x[n]), tanh(x[n])

    x = np.linspace(-87.0, 87.0, 100_001, dtype=np.float32)
    exponentials, tangents = np.empty_like(x), np.empty_like(x)
    both(x, exponentials, tangents)
    exact = np.exp(x.astype(np.float64))
    assert (abs(exponentials - exact) / exact).max() < 3e-7
    assert abs(tangents - np.tanh(x.astype(np.float64))).max() < 2e-7


def test_the_width_of_a_tile_suits_the_processor_and_gives_the_same_bits(monkeypatch):
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple("x86_64-unknown-linux-gnu")
    machines = [target.create_target_machine(cpu=cpu) for cpu in ("skylake-avx512", "haswell")]
    counts = [vectors(machine) for machine in machines]
    assert counts == [2, 1]
    random = np.random.default_rng(0)
    weights, rows = normal(random, TILE, 7), normal(random, 7, LANES)
    found = []
    for count in counts:
        monkeypatch.setattr(arithmetic, "vectors", lambda machine, count=count: count)

        @numba.njit
        def product(weights, rows, sums):
            for lane in range(0, LANES, span()):
                multiply(weights, 0, 7, 1, 7, rows, lane, LANES, sums, lane, LANES)

        sums = np.zeros((TILE, LANES), np.float32)
        product(*(array.ravel() for array in (weights, rows, sums)))
        np.testing.assert_allclose(sums, weights @ rows, atol=1e-5)
        found.append(sums.tobytes())
    assert found[0] == found[1]
