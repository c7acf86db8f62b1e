import math
import os
import subprocess
import sys

import numba
import numpy as np
import pytest

from agents.fast_ppo.update import Numbers, UpdateConfig, exponential, make_steps, pack, tanh, unpack

ACTOR, CRITIC = (5, 9, 6, 1), (7, 3, 1)
SAMPLES = 70


def normal(random: np.random.Generator, *shape: int) -> np.ndarray:
    return random.normal(size=shape).astype(np.float32)


def parameters(random: np.random.Generator) -> Numbers:
    actor, critic = (
        [(normal(random, *shape), normal(random, shape[0])) for shape in zip(widths[1:], widths[:-1], strict=True)]
        for widths in (ACTOR, CRITIC)
    )
    return Numbers(actor, critic, normal(random, 1))


def updated(relu: bool = False, **changes: np.ndarray) -> tuple[list[Numbers], np.ndarray]:
    """Parameters and moments after some steps, and the losses."""
    random = np.random.default_rng(0)
    settings = UpdateConfig(32, True, 0.2, 0.0, 0.5, 0.5, 1e-2, 0.9, 0.999, 1e-5, 0, relu, False, -20.0)
    changed = [parameters(random) for _ in range(3)]
    for moments in changed[1:]:
        unpack(np.zeros_like(pack(moments)), moments)
    samples = {name: normal(random, SAMPLES) for name in ("actions", "old_log_probs", "advantages", "targets")}
    samples |= {"inputs": normal(random, SAMPLES, CRITIC[0])}
    samples |= {"orders": np.stack([random.permutation(SAMPLES) for _ in range(3)])}
    return changed, make_steps(settings, changed, **{**samples, **changes})


def test_what_is_packed_is_unpacked():
    numbers, copy = (parameters(np.random.default_rng(seed)) for seed in (0, 1))
    unpack(pack(numbers), copy)
    assert copy.log_std == numbers.log_std
    for one, other in zip(copy.actor + copy.critic, numbers.actor + numbers.critic, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


@pytest.mark.parametrize("relu", [False, True])
def test_what_fills_up_a_width_stays_zero(relu, monkeypatch):
    # A unit that only fills up would otherwise learn, unseen, and count in the norm of the gradient.
    compared = []

    def compare(packed: np.ndarray, numbers: Numbers) -> None:
        unpack(packed, numbers)
        np.testing.assert_array_equal(pack(numbers), packed)
        compared.append(np.count_nonzero(packed))

    monkeypatch.setattr("agents.fast_ppo.update.unpack", compare)
    _, losses = updated(relu)
    assert np.isfinite(losses).all()
    assert len(compared) == 3 and min(compared) > 10


@pytest.mark.parametrize("outlier", [-1000.0, 1000.0])
def test_probabilities_that_have_become_tiny_or_huge_leave_the_parameters_finite(outlier):
    changed, _ = updated(old_log_probs=np.full(SAMPLES, outlier, np.float32))
    assert all(np.isfinite(pack(numbers)).all() for numbers in changed)


def test_no_number_stays_no_number():
    changed, losses = updated(advantages=np.full(SAMPLES, math.nan, np.float32))
    assert np.isnan(pack(changed[0])).any() and np.isnan(losses[0])


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("inputs", np.zeros((SAMPLES, 5), np.float32)),
        ("inputs", np.zeros((CRITIC[0], SAMPLES), np.float32).T),
        ("actions", np.zeros((SAMPLES, 1), np.float32)),
        ("targets", np.zeros(SAMPLES)),
        ("orders", np.zeros((2, SAMPLES + 1), np.int64)),
    ],
)
def test_other_arrays_are_refused(name, wrong):
    with pytest.raises(TypeError, match=f"{name} must be a contiguous array of"):
        updated(**{name: wrong})


def test_the_compiled_code_is_found_again_by_any_process():
    # What has no representation of its own, or a set, would give every process another name, and all would compile.
    code = "from agents.fast_ppo.update import fingerprint, update; print(fingerprint(update))"
    names = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": seed},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for seed in "12"
    }
    assert len(names) == 1


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
