"""The compiled network: its outputs, and their equality in any batch and on any instruction set."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from capsule_gym import network
from capsule_gym.layout import LANES
from capsule_gym.network import (
    FEW,
    SATURATION,
    TILE,
    Header,
    compiled_act_batch,
    make_workspace,
    pack,
    to_action,
)


def make_layers(widths: tuple[int, ...], seed: int = 0) -> list[network.Layer]:
    rng = np.random.default_rng(seed)
    return [
        (
            rng.normal(0.0, 1.0 / np.sqrt(inputs), (outputs, inputs)).astype(np.float32),
            rng.normal(0.0, 0.3, outputs).astype(np.float32),
        )
        for inputs, outputs in pairwise(widths)
    ]


def make_header(layers: list[network.Layer], clip: float = 10.0, **changes: object) -> Header:
    """The header of a network that takes the observation unchanged."""
    inputs = layers[0][0].shape[1]
    counts = {"layers": len(layers), "clip": clip, "inputs": inputs, "observed": inputs}
    kinds = dict.fromkeys(("relu", "tanh_squashing", "identifies", "observes_energy_weight"), False)
    kinds |= {"outputs_torque": False, "has_law": False, "log_energy_weight": 0.0}
    torques = {"torque_limit": 1.5, "residual_limit": 3.0}
    plant = {"m": 0.138, "l": 0.3, "g": 9.81, "dt": 0.02}
    return Header(**{**counts, **kinds, **torques, **plant, **changes})  # type: ignore[arg-type]


def make_network(
    layers: list[network.Layer], mean=None, scale=None, clip: float = 10.0, **changes: object
) -> np.ndarray:
    header = make_header(layers, clip, **changes)
    mean = np.zeros(header.inputs) if mean is None else mean
    return pack(layers, mean, np.ones(header.inputs) if scale is None else scale, header)


def expected(layers, observations, mean, scale, clip, relu, tanh_squashing) -> np.ndarray:
    """The same network in numpy, in numpy's order of operations."""
    values = np.clip((observations.astype(np.float64) - mean) * scale, -clip, clip)
    for n, (weights, bias) in enumerate(layers):
        values = values @ weights.astype(np.float64).T + bias
        if n < len(layers) - 1:
            values = np.maximum(values, 0.0) if relu else np.tanh(values)
    return np.tanh(values) if tanh_squashing else np.clip(values, -1.0, 1.0)


def run(packed: np.ndarray, observations: np.ndarray) -> np.ndarray:
    actions = np.full((len(observations), 1), np.nan, np.float32)
    inputs, lanes = np.empty_like(observations), make_workspace(packed)
    compiled_act_batch()(packed, observations, np.zeros(0), inputs, lanes, actions)
    return actions


@pytest.mark.parametrize("relu", [False, True], ids=["tanh", "relu"])
@pytest.mark.parametrize("tanh_squashing", [False, True], ids=["clipped", "squashed"])
@pytest.mark.parametrize("widths", [(10, 64, 64, 1), (12, 1), (3, 7, 1), (5, 1, 130, 3, 1)], ids=str)
def test_it_computes_what_numpy_does(widths, relu, tanh_squashing):
    rng = np.random.default_rng(1)
    layers, mean, scale = make_layers(widths), rng.normal(size=widths[0]), rng.uniform(0.2, 3.0, widths[0])
    packed = make_network(layers, mean, scale, 2.5, relu=relu, tanh_squashing=tanh_squashing)
    observations = rng.normal(0.0, 2.0, (2 * LANES + 5, widths[0])).astype(np.float32)
    actions = run(packed, observations)
    exact = expected(layers, observations, mean, scale, 2.5, relu, tanh_squashing)
    # The errors are one rounding to float32 and those of float64.
    np.testing.assert_allclose(actions, exact, rtol=6.1e-8, atol=1e-13)
    assert np.unique(actions).size > 20
    assert (np.abs(actions) <= 1.0).all()


@pytest.mark.parametrize("relu", [False, True], ids=["tanh", "relu"])
def test_a_row_is_the_same_alone_and_in_any_batch(relu):
    layers = make_layers((10, 64, 64, 1))
    packed = make_network(layers, relu=relu, tanh_squashing=relu)
    observations = np.random.default_rng(2).normal(size=(3 * LANES, 10)).astype(np.float32)
    whole = run(packed, observations)
    assert np.unique(whole).size > 2 * LANES
    for n in (1, 2, TILE, FEW, FEW + 1, LANES - 1, LANES, LANES + 1, 2 * LANES + FEW):
        for first in (0, 1, 37):
            assert run(packed, observations[first : first + n]).tobytes() == whole[first : first + n].tobytes()


def test_one_environment_that_is_no_number_leaves_the_others_alone():
    packed = make_network(make_layers((5, 64, 64, 1)), relu=True, tanh_squashing=True)
    observations = np.random.default_rng(4).normal(size=(LANES, 5)).astype(np.float32)
    clean = run(packed, observations)
    observations[7, 2] = np.nan
    broken = run(packed, observations)
    assert np.isnan(broken[7])
    assert np.delete(broken, 7).tobytes() == np.delete(clean, 7).tobytes()


def test_a_wanted_torque_is_reached_within_the_residual_limit():
    header = make_header(make_layers((10, 1)), outputs_torque=True, has_law=True)
    for law_torque in np.linspace(-1.5, 1.5, 25):
        for wanted in np.linspace(-SATURATION, SATURATION, 31):
            action = to_action(header, wanted, law_torque)
            # The environment computes the torque from the action in this way.
            torque = np.clip(law_torque + header.residual_limit * action, -header.torque_limit, header.torque_limit)
            assert abs(action) <= 1.0
            assert torque == pytest.approx(header.torque_limit * wanted, abs=1e-12)
        # The law's torque may change before the next action; only a full action keeps the sum at the limit.
        for wanted in (np.nextafter(SATURATION, 1.0), 1.0, 7.0):
            assert (to_action(header, wanted, law_torque), to_action(header, -wanted, law_torque)) == (1.0, -1.0)
    weak = header._replace(residual_limit=0.5)
    assert (to_action(weak, 0.8, -1.5), to_action(weak, -0.8, 1.5)) == (1.0, -1.0)
    assert to_action(weak, 0.5, 0.7) == pytest.approx(0.1)
    # If the output is an action, it is only clipped.
    for output, action in ((0.3, 0.3), (0.95, 0.95), (1.7, 1.0), (-1e300, -1.0)):
        assert to_action(make_header(make_layers((5, 1))), output, 0.7) == action
