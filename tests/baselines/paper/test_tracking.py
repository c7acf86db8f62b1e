"""Both profiles compared with each other and with closed forms; the selection (20) to (31)."""

import numpy as np
import pytest

from baselines.paper import selection
from baselines.paper.tracking import (
    friction_for,
    grid,
    simulate,
    speed_map,
    speed_ratio,
    track,
)
from capsule_gym import Capsule
from capsule_gym.control.laws.feedback_linearisation import feedback_linearising
from capsule_gym.control.laws.profiles import EPC, PROPOSED

# Equation, given and implied value, and whether one follows.
SELECTION = """
    (21)  0.76   2.11   no
    (22)  0.88   2.09   no
    (22)  1.27   2.09   no
    (22)  1.26   2.09   no
    (23)  0.53   1.05   no
    (24)  2.51   0.133  no
    (25)  2.91   0.195  no
    (25)  0.323  0.195  no
    (26)  11.64  11.81  yes
    (27)  0.895  0.9    yes
    (27)  2.113  2.122  yes
    (28)  5.63   1.7    no
    (29)  2.68   0.563  no
    (30)  5.80   5.8    yes
    (31)  6.60   6.6    yes
"""
# Mean speed (cm/s), largest torque (N m), energy per cycle (J), cost of transport.
RUNS = {
    "proposed": (PROPOSED, 1.384, 1.2513, 1.380, 2.412),
    "EPC": (EPC, 1.627, 2.2085, 1.792, 2.664),
}


@pytest.mark.parametrize(
    ("profile", "speed", "torque", "energy", "transport"), RUNS.values(), ids=RUNS
)
def test_law_reproduces_exact_tracking(profile, speed, torque, energy, transport):
    run = track(profile)
    assert run["mean_speed"] == pytest.approx(speed, rel=2e-3)
    assert run["peak_torque"] == pytest.approx(torque, rel=2e-3)
    assert run["energy"] == pytest.approx(energy, rel=4e-3)
    assert run["cost_of_transport"] == pytest.approx(transport, rel=4e-3)
    assert speed_map(profile, h=2e-5)[0, 0] == pytest.approx(speed, abs=0.5e-3)
    forward = run["backward"] / run["backward_ratio"]
    advance = run["mean_speed"] * profile.period
    assert forward - run["backward"] == pytest.approx(advance, rel=1e-9)


@pytest.mark.parametrize("profile", [PROPOSED, EPC])
def test_the_map_follows_a_platform_that_slides_from_cycle_to_cycle(profile):
    slippery = Capsule(mu=0.001)
    law = feedback_linearising(profile, nominal=slippery)
    (run,) = simulate(law, [(slippery.M, slippery.mu)], capsule=slippery)
    found = speed_map(profile, mu=[slippery.mu], h=1e-4)[0, 0]
    assert found == pytest.approx(run.metrics["mean_speed"], rel=1e-3)


@pytest.mark.parametrize("profile", [PROPOSED, EPC])
def test_the_normal_force_has_little_effect(profile):
    ratio = track(profile, "paper")["mean_speed"] / track(profile)["mean_speed"]
    assert 1e-4 < abs(ratio - 1.0) < 0.01


def test_epc_is_faster_wherever_it_moves():
    plants = grid(8, 31)
    epc = speed_map(EPC, *plants)
    ratio = speed_ratio(speed_map(PROPOSED, *plants), epc)
    assert np.nanmax(ratio) == pytest.approx(0.88, abs=0.02)
    assert np.isnan(ratio[epc <= 0.01]).all()


def test_without_friction_the_platform_is_back_after_every_cycle():
    # The centre of mass stays at rest.
    assert speed_map(PROPOSED, [0.3, 1.0], [0.0]) == pytest.approx(0.0, abs=1e-4)


def test_with_very_much_friction_the_platform_stays_at_rest():
    assert (speed_map(PROPOSED, [1.0], [2.0]) == 0.0).all()


@pytest.mark.parametrize(
    ("profile", "published", "friction"), [(PROPOSED, 0.642, 0.104), (EPC, 0.629, 0.189)]
)
def test_friction_of_the_published_speed(profile, published, friction):
    (mu,) = friction_for(profile, published)
    assert mu == pytest.approx(friction, abs=0.001)
    assert speed_map(profile, mu=[mu])[0, 0] == pytest.approx(published, rel=0.01)


def test_no_friction_gives_a_speed_that_is_too_high():
    assert friction_for(PROPOSED, 5.0) == []


def test_what_follows_from_the_selection():
    expected = SELECTION.split("\n")[1:-1]
    for row, line in zip(selection.evaluate_selection(), expected, strict=True):
        equation, gives, implied, follows = line.split()
        assert row["equation"] == equation
        assert row["gives"] == as_printed(gives)
        assert row["implied"] == as_printed(implied)
        assert row["follows"] is (follows == "yes")


def test_the_momentum_of_a_turning_pendulum_is_the_impulse_of_the_forces():
    # Eq. (21) from -0.5 rad to 1 rad at 1 rad/s, where the angle can replace the time.
    t = np.linspace(0.0, 1.5, 3001)
    found = selection._p2_of_momentum(t, t - 0.5)
    p = Capsule()
    # The integrals of theta sin(theta) and sin(theta).
    spring = p.k * (np.sin(1.0) - np.cos(1.0) + np.sin(0.5) - 0.5 * np.cos(0.5))
    damper = p.c * (np.cos(0.5) - np.cos(1.0))
    impulse = p.mu * (1.5 * (p.M + p.m) * 9.81 - spring + damper)
    swing = p.m * p.l * (np.cos(np.pi / 3.0) + p.mu * np.sin(np.pi / 3.0))
    assert found == pytest.approx(impulse / swing, rel=1e-7)


def as_printed(value):
    """A number to half a unit of its last digit."""
    _, _, decimals = value.partition(".")
    return pytest.approx(float(value), abs=0.5001 * 10.0 ** -len(decimals))
