from itertools import pairwise

import numpy as np
import pytest

from capsule_gym.core import native
from capsule_gym.policies.network import pack

# Environments in a batch; the core computes four at once, and those left over one by one.
BATCH = 64


def make_layers(widths, seed=0):
    rng = np.random.default_rng(seed)
    layers = []
    for inputs, outputs in pairwise(widths):
        weights = rng.normal(0.0, 1.0 / np.sqrt(inputs), (outputs, inputs))
        bias = rng.normal(0.0, 0.3, outputs)
        layers.append((weights.astype(np.float32), bias.astype(np.float32)))
    return layers


def act(packed, observations):
    actions = np.empty((len(observations), 1), np.float32)
    native.call("act", packed, observations, 0, len(observations), actions)
    return actions


def compute_in_numpy(layers, values, relu, tanh_squashing):
    """The actions for scaled observations, in numpy's order of operations."""
    *hidden, last = [(weights.astype(np.float64).T, bias) for weights, bias in layers]
    for weights, bias in hidden:
        values = values @ weights + bias
        values = np.maximum(values, 0.0) if relu else np.tanh(values)
    weights, bias = last
    values = values @ weights + bias
    return np.tanh(values) if tanh_squashing else np.clip(values, -1.0, 1.0)


@pytest.fixture(params=[(10, 64, 64, 1), (12, 1), (3, 7, 1), (5, 1, 130, 3, 1)], ids=str)
def widths(request):
    return request.param


@pytest.fixture
def observations(widths):
    rng = np.random.default_rng(1)
    return rng.normal(0.0, 2.0, (2 * BATCH + 5, widths[0])).astype(np.float32)


@pytest.fixture(params=[(relu, squashed) for relu in (False, True) for squashed in (False, True)])
def packed_and_expected(widths, observations, request):
    """A packed network, and the actions of numpy."""
    relu, tanh_squashing = request.param
    rng = np.random.default_rng(2)
    layers = make_layers(widths)
    mean = rng.normal(size=widths[0])
    scale = rng.uniform(0.2, 3.0, widths[0])
    scaled = np.clip((observations.astype(np.float64) - mean) * scale, -2.5, 2.5)
    packed = pack(layers, mean, scale, clip=2.5, relu=relu, tanh_squashing=tanh_squashing)
    return packed, compute_in_numpy(layers, scaled, relu, tanh_squashing)


@pytest.fixture
def packed(packed_and_expected):
    return packed_and_expected[0]


def test_it_computes_what_numpy_does(packed_and_expected, observations):
    packed, expected = packed_and_expected
    actions = act(packed, observations)
    # The errors are one rounding to float32 and those of float64.
    np.testing.assert_allclose(actions, expected, rtol=6.1e-8, atol=1e-13)
    assert np.unique(actions).size > 20
    assert (np.abs(actions) <= 1.0).all()


def test_the_action_of_a_row_is_the_same_alone_and_in_any_batch(packed, observations):
    actions = act(packed, observations)
    for n in (1, 2, 3, 4, 5, 8, 33, BATCH - 1, BATCH, BATCH + 1):
        for first in (0, 1, 37):
            rows = slice(first, first + n)
            assert act(packed, observations[rows]).tobytes() == actions[rows].tobytes()


def test_a_row_that_is_not_a_number_changes_no_other(packed, observations):
    actions = act(packed, observations)
    observations[7, 2] = np.nan
    broken = act(packed, observations)
    assert np.isnan(broken[7])
    assert np.delete(broken, 7).tobytes() == np.delete(actions, 7).tobytes()
