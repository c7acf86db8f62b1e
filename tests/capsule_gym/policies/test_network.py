from itertools import pairwise

import numpy as np
import pytest

from capsule_gym.core import native
from capsule_gym.policies.network import pack

# Environments in a batch; the core computes four at once, and those left over one by one.
BATCH = 64


def make_layers(widths, seed=0):
    rng = np.random.default_rng(seed)
    return [
        tuple(
            rng.normal(0.0, *size).astype(np.float32)
            for size in ((1.0 / np.sqrt(i), (o, i)), (0.3, o))
        )
        for i, o in pairwise(widths)
    ]


def act(packed, observations):
    actions = np.empty((len(observations), 1), np.float32)
    native.call("act", packed, observations, len(observations), actions)
    return actions


def expected(layers, observations, mean, scale, clip, relu, tanh_squashing):
    """The same network in numpy, in numpy's order of operations."""
    values = np.clip((observations.astype(np.float64) - mean) * scale, -clip, clip)
    for n, (weights, bias) in enumerate(layers):
        values = values @ weights.astype(np.float64).T + bias
        if n < len(layers) - 1:
            values = np.maximum(values, 0.0) if relu else np.tanh(values)
    return np.tanh(values) if tanh_squashing else np.clip(values, -1.0, 1.0)


@pytest.mark.parametrize("relu", [False, True], ids=["tanh", "relu"])
@pytest.mark.parametrize("tanh_squashing", [False, True], ids=["clipped", "squashed"])
@pytest.mark.parametrize(
    "widths", [(10, 64, 64, 1), (12, 1), (3, 7, 1), (5, 1, 130, 3, 1)], ids=str
)
def test_it_computes_what_numpy_does(widths, relu, tanh_squashing):
    rng = np.random.default_rng(1)
    layers, mean, scale = (
        make_layers(widths),
        rng.normal(size=widths[0]),
        rng.uniform(0.2, 3.0, widths[0]),
    )
    packed = pack(layers, mean, scale, clip=2.5, relu=relu, tanh_squashing=tanh_squashing)
    observations = rng.normal(0.0, 2.0, (2 * BATCH + 5, widths[0])).astype(np.float32)
    actions = act(packed, observations)
    exact = expected(layers, observations, mean, scale, 2.5, relu, tanh_squashing)
    # The errors are one rounding to float32 and those of float64.
    np.testing.assert_allclose(actions, exact, rtol=6.1e-8, atol=1e-13)
    assert np.unique(actions).size > 20
    assert (np.abs(actions) <= 1.0).all()
    # The action of a row is the same alone and in any batch, also next to a row that is not a
    # number.
    for n in (1, 2, 3, 4, 5, 8, 33, BATCH - 1, BATCH, BATCH + 1):
        for first in (0, 1, 37):
            assert (
                act(packed, observations[first : first + n]).tobytes()
                == actions[first : first + n].tobytes()
            )
    observations[7, 2] = np.nan
    broken = act(packed, observations)
    assert np.isnan(broken[7]) and np.delete(broken, 7).tobytes() == np.delete(actions, 7).tobytes()
