"""The kernel in C."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import native
from capsule_gym.kernels import Row
from capsule_gym.options import Options
from capsule_gym.simulation import Simulation


@pytest.mark.skipif(not native.available(), reason="no gcc")
def test_the_kernel_in_c_does_the_same_work():
    # Twenty steps of hard torques with events and ended episodes; then rounding is no longer all that differs.
    n = 100
    simulations = [Simulation(n, Options(randomization="wide")) for _ in range(2)]
    for simulation in simulations:
        for i in range(n):
            simulation.seed(i, i)
        simulation.reset(np.arange(n))
    ours, theirs = simulations
    kernel = native.Native(theirs, native.STRICT)
    rng = np.random.default_rng(0)
    for _ in range(20):
        actions = rng.uniform(-1.0, 1.0, n)
        for simulation in simulations:
            simulation.write(Row.action, actions)
            simulation.write(Row.active, simulation.row(Row.termination) == 0.0)
        ours._run(begin=False)
        kernel()
        np.testing.assert_allclose(theirs.rows(0, Row.slip), ours.rows(0, Row.slip), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(theirs.observations, ours.observations, rtol=1e-6)
    assert ours.row(Row.termination).any()
    assert (ours.row(Row.stuck) > 0.0).any()
    assert (ours.row(Row.backward) > 0.0).any()


def test_the_kernel_in_c_refuses_what_it_does_not_know():
    with pytest.raises(ValueError, match="direct-torque task"):
        native.Native(Simulation(1, Options(observe_parameters=True)), native.STRICT)
