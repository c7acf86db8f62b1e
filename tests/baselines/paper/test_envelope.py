"""The upper envelope: compared with a closed form where one exists, and never crossed on any kind of plant."""

from __future__ import annotations

import math

import numpy as np
import pytest

from baselines.paper.proofs import upper_envelope
from capsule_gym import Capsule, dynamics

QUARTER = math.pi / 2.0


def test_envelope_of_a_free_pendulum_is_known():
    # A fixed platform, no spring, no damper and negligible gravity: w = 2 u (theta - low) / (m l^2).
    free = Capsule(M=1e9, g=1e-9, k=0.0, c=0.0, mu=0.0)
    envelope = upper_envelope(0.5, -1.0, 1.0, free.plant())
    exact = np.sqrt(2.0 * 0.5 * (envelope.theta + 1.0) / (free.m * free.l**2))
    np.testing.assert_allclose(envelope.theta_dot, exact, rtol=2e-3, atol=1e-9)
    assert (envelope.theta_dot >= exact * (1.0 - 1e-9)).all()
    assert envelope.fastest == envelope.theta_dot[-1]
    assert (np.diff(envelope.theta_dot) >= 0.0).all()


def test_several_plants_have_the_envelope_of_their_worst():
    newton, paper = (Capsule(mu=0.4, normal_force=force).plant() for force in ("newton", "paper"))
    both = upper_envelope(1.5, -1.0, 1.0, newton, paper).theta_dot
    alone = [upper_envelope(1.5, -1.0, 1.0, p).theta_dot for p in (newton, paper)]
    assert (both >= np.maximum(*alone) - 1e-3).all()
    assert np.abs(alone[0] - alone[1]).max() > 0.01


PLANTS = {
    "heavy": Capsule(M=2.0, mu=0.2),
    "light and rough": Capsule(M=0.25, mu=0.6),
    "anisotropic": Capsule(mu=0.1, backward_ratio=4.0, static_ratio=2.0),
    "undamped": Capsule(c=0.0, mu=0.05),
    "paper": Capsule(mu=0.3, normal_force="paper"),
}


@pytest.mark.parametrize("name", PLANTS)
def test_no_motion_crosses_the_envelope(name):
    p = PLANTS[name].plant()
    limit = 1.0
    envelope = upper_envelope(limit, -QUARTER, QUARTER, p)
    rng = np.random.default_rng(2)
    closest = 0.0
    for trial in range(9):
        theta, theta_dot, x, x_dot = rng.uniform(-1.5, 1.5), 0.0, 0.0, rng.choice([0.0, rng.uniform(-0.3, 0.3)])
        torque = -limit
        for n in range(600):
            if trial % 3 == 0:
                # A torque in the direction of the motion adds energy.
                torque = -limit if theta < -1.3 and theta_dot < -2.0 else math.copysign(limit, theta_dot or 1.0)
            elif n % 20 == 0:
                torque = rng.choice([-limit, limit, rng.uniform(-limit, limit)])
            motion = dynamics.step(theta, theta_dot, x, x_dot, torque, p, 1e-3)
            theta, theta_dot, x, x_dot = (float(value) for value in motion[:4])
            if abs(theta) >= QUARTER:
                break
            mirrored = theta if theta_dot >= 0.0 else -theta
            bound = float(np.interp(mirrored, envelope.theta, envelope.theta_dot))
            assert abs(theta_dot) <= bound
            closest = max(closest, abs(theta_dot) / max(bound, 1.0))
    # The bound is not trivial.
    assert closest > 0.7


def test_a_damper_that_could_accelerate_the_pendulum_is_refused():
    with pytest.raises(ValueError, match=r"mu m l < 2 \(M \+ m\)"):
        upper_envelope(1.0, -1.0, 1.0, Capsule().plant()._replace(l=30.0, mu=5.0, pivot_torque_on_contact=1.0))
