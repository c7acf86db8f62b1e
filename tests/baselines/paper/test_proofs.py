"""Both proofs: bounds compared with brute force and closed forms, and the pages that print them."""

import math
from pathlib import Path

import numpy as np
import pytest

from baselines.paper import proofs, published
from baselines.tables import printed_above, printed_below
from capsule_gym import Capsule, dynamics

ROOT = Path(__file__).resolve().parents[3]
START = -math.pi / 3
SWINGS = {name: math.radians(numbers["swing"].value) for name, numbers in published.RUNS.items()}


def test_proof_1():
    proposed, epc = proofs.check_proof_1()
    found = (proposed["bound"], proposed["sticking"], epc["bound"])
    assert found == pytest.approx((0.622, 0.695, 0.8477), abs=5e-4)
    for row in (proposed, epc):
        assert row["published"] < row["bound"] <= row["sticking"]


@pytest.mark.parametrize("option", ["newton", "paper"])
@pytest.mark.parametrize("slip", [0.0, 1.0, -1.0])
def test_torque_of_proof_1_does_not_accelerate_the_pendulum(option, slip):
    p = Capsule(normal_force=option).plant()
    for theta in np.linspace(-1.0, 1.2, 7):
        torque = proofs.torque_without_acceleration(np.array([theta]), 7.8, slip, p)[0]
        assert dynamics.accelerations(theta, 7.8, 0.0, slip, torque, p)[0] == pytest.approx(0.0, abs=1e-9)


def test_bound_of_proof_1_lies_below_every_sample_and_close():
    theta = np.random.default_rng(0).uniform(START, SWINGS["proposed"], 20_000)
    bound = proofs.torque_at_peak(7.8, START, SWINGS["proposed"])
    smallest = min(
        proofs.torque_without_acceleration(theta, 7.8, slip, Capsule(normal_force=option).plant()).min()
        for slip in (0.0, 1.0, -1.0)
        for option in ("newton", "paper")
    )
    assert bound <= smallest < bound + 1e-3


def test_proof_2(rates):
    found = [[row[name] for name in ("bound", "undamped", "torque_needed", "torque_enough")] for row in rates]
    assert found[0] == pytest.approx((5.803, 14.911, 0.7478, 0.7893), abs=1e-3)
    assert found[1] == pytest.approx((6.778, 16.866, 1.1024, 1.1839), abs=1e-3)
    for row in rates:
        assert row["torque"] < row["torque_needed"] < row["torque_enough"]
        assert row["from_start"] < row["bound"] < row["published"]
        swing = START, SWINGS[row["name"]]
        # With 0.1 % more than the required torque, the envelope reaches the rate.
        assert proofs.swing_envelope(row["torque_needed"], *swing).fastest < row["published"]
        assert proofs.swing_envelope(1.001 * row["torque_needed"], *swing).fastest > row["published"]


def test_pages_print_the_bounds_rounded_outwards(rates):
    page, readme = ((ROOT / name).read_text(encoding="utf-8") for name in ("docs/paper.md", "README.md"))
    for peak, rate in zip(proofs.check_proof_1(), rates, strict=True):
        first = [f"**{printed_below(peak['bound'], 3)} N m**", f"{printed_below(peak['sticking'], 3)} N m"]
        second = [f"**{printed_above(rate['bound'], 3)} rad/s**", f"{rate['published']:g} rad/s"]
        second += [f"{printed_below(rate['torque_needed'], 3)} N m", f"{printed_above(rate['torque_enough'], 3)} N m"]
        assert "|".join(first) in page and "|".join(second) in page
        assert printed_above(rate["undamped"], 2) in page and printed_above(rate["bound"], 3) in readme


def test_envelope_of_a_free_pendulum_is_known():
    # A fixed platform, no spring, no damper and negligible gravity: w = 2 u (theta - low) / (m l^2).
    free = Capsule(M=1e9, g=1e-9, k=0.0, c=0.0, mu=0.0)
    envelope = proofs.upper_envelope(0.5, -1.0, 1.0, free.plant())
    exact = np.sqrt(2.0 * 0.5 * (envelope.theta + 1.0) / (free.m * free.l**2))
    np.testing.assert_allclose(envelope.theta_dot, exact, rtol=2e-3, atol=1e-9)
    assert (envelope.theta_dot >= exact * (1.0 - 1e-9)).all()
    assert envelope.fastest == envelope.theta_dot[-1]
    assert (np.diff(envelope.theta_dot) >= 0.0).all()


def test_several_plants_have_the_envelope_of_their_worst():
    newton, paper = (Capsule(mu=0.4, normal_force=force).plant() for force in ("newton", "paper"))
    both = proofs.upper_envelope(1.5, -1.0, 1.0, newton, paper).theta_dot
    alone = [proofs.upper_envelope(1.5, -1.0, 1.0, p).theta_dot for p in (newton, paper)]
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
    envelope = proofs.upper_envelope(limit, -math.pi / 2.0, math.pi / 2.0, p)
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
            if abs(theta) >= math.pi / 2.0:
                break
            mirrored = theta if theta_dot >= 0.0 else -theta
            bound = float(np.interp(mirrored, envelope.theta, envelope.theta_dot))
            assert abs(theta_dot) <= bound
            closest = max(closest, abs(theta_dot) / max(bound, 1.0))
    # The bound is not trivial.
    assert closest > 0.7


def test_a_damper_that_could_accelerate_the_pendulum_is_refused():
    with pytest.raises(ValueError, match=r"mu m l < 2 \(M \+ m\)"):
        proofs.upper_envelope(1.0, -1.0, 1.0, Capsule().plant()._replace(l=30.0, mu=5.0, pivot_torque_on_contact=1.0))
