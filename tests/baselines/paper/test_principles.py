"""Principles 1 to 4, both Lemmas and the proof about the torques: by hand and by brute force."""

import math

import numpy as np
import pytest

from baselines.paper import principles, published
from baselines.paper.principles import (
    NEWTON,
    PAPER,
    SLIPS,
    Cycle,
    Demand,
    lemma_1,
    lemma_2,
    principle_3,
    principle_4,
)
from baselines.tables import printed_below
from capsule_gym import Capsule, dynamics
from tests import ROOT

ML = 0.138 * 0.3
WEIGHT = 0.638 * 9.81
START = -math.pi / 3
SWING = math.radians(published.PROPOSED["swing"].value)
PAGE = (ROOT / "docs/paper.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")


def state(theta, theta_dot, theta_ddot=0.0):
    """A single state of the pendulum."""
    theta, theta_dot, theta_ddot = np.array([[theta], [theta_dot], [theta_ddot]])
    return Cycle(np.zeros(1), np.zeros(1, np.int64), theta, theta_dot, theta_ddot)


@pytest.mark.parametrize("form", ["newton", "paper"])
def test_principles_3_and_4_by_hand(form):
    p = Capsule(normal_force=form, backward_ratio=3.0, static_ratio=2.0).plant()
    rng = np.random.default_rng(0)
    states = rng.uniform(-1.0, 1.0, (50, 3)) * [1.5, 10.0, 50.0]
    for theta, theta_dot, theta_ddot in states:
        a = ML * theta_ddot
        if form == "paper":
            # (7) and (8) count the torque of spring and damper as a force.
            a += 0.36 * theta + 0.0923 * theta_dot
        b = ML * theta_dot**2
        lift = b * math.cos(theta) + a * math.sin(theta)
        force = a * math.cos(theta) - b * math.sin(theta)
        mu = 0.01 * 2.0 * (3.0 if force < 0.0 else 1.0)
        cycle = state(theta, theta_dot, theta_ddot)

        contact = principle_3(cycle, p)
        assert contact.load[0] == pytest.approx(lift, rel=1e-9)
        assert contact.limit == pytest.approx(WEIGHT, rel=1e-9)

        standstill = principle_4(cycle, p)
        assert standstill.load[0] == pytest.approx(abs(force), rel=1e-9)
        assert standstill.limit[0] == pytest.approx(mu * (WEIGHT - lift), rel=1e-9)


def test_a_limit_that_is_not_positive_is_never_met():
    demand = Demand(np.array([1.0, 1.0, -1.0, 1.0]), np.array([4.0, 0.0, 0.0, -2.0]))
    assert demand.ratio.tolist() == [0.25, math.inf, math.inf, math.inf]


def test_lemma_1_is_not_sufficient():
    # Upright at 15 rad/s with a = 0, the platform lifts.
    flying = state(0.0, 15.0, -0.0923 * 15.0 / ML)
    assert lemma_1(flying, PAPER).load[0] == pytest.approx(0.0, abs=1e-9)
    assert lemma_1(flying, PAPER).limit == pytest.approx(WEIGHT**2 / (2 * ML))
    assert principle_3(flying, PAPER).ratio[0] == pytest.approx(ML * 225.0 / WEIGHT)


def test_lemma_1_is_not_necessary():
    # Upright, the acceleration does not enter (7).
    standing = state(0.0, 10.0, 400.0)
    assert lemma_1(standing, NEWTON).ratio[0] > 1.0
    assert principle_3(standing, NEWTON).ratio[0] < 1.0


def test_lemma_2_by_hand():
    printed = lemma_2(state(-0.5, 0.2, 0.7), PAPER)
    assert printed.load[0] == pytest.approx(0.7 + 0.04 - 0.18 + 0.01846)
    assert printed.limit == pytest.approx(WEIGHT / ML * 0.01 / math.sqrt(1.0001))


def test_corrected_lemma_2_by_hand():
    corrected = lemma_2(state(-0.5, 0.2, 0.7), PAPER, sufficient=True)
    acceleration = 0.7 + (-0.18 + 0.01846) / ML
    assert corrected.load[0] == pytest.approx(abs(acceleration) + 0.04)


def test_only_lemmas_as_printed_are_violated():
    rows = principles.check_lemmas(20_000)
    assert len(rows) == 6
    for row in rows:
        printed = "as printed" in row["lemma"]
        assert row["states"] > 500
        assert (row["violations"] > 0) == printed, row
        assert (row["worst"] > 1.0) == printed, row
        # A state in 20,000 comes within a few percent of the corrected bounds.
        assert row["worst"] > 0.9


def test_the_page_counts_the_random_states_that_violate_a_principle():
    first, *_, second, _, _ = principles.check_lemmas()
    counts = [f"{row['violations']:,} of {row['states']:,} (Lemma" for row in (first, second)]
    assert all(each in PAGE for each in counts)


def test_lemmas_are_checked_on_all_angles_between_lying_positions(monkeypatch):
    angles = []
    lemma = principles.lemma_1

    def recorded(cycle, plant, **settings):
        angles.extend(np.degrees(cycle.theta))
        return lemma(cycle, plant, **settings)

    monkeypatch.setattr(principles, "lemma_1", recorded)
    principles.check_lemmas(20_000)
    assert -90.0 < min(angles) < -89.9
    assert 89.9 < max(angles) < 90.0


@pytest.mark.parametrize(
    "demand",
    ["Principle 4, Newton", "Principle 4, (8)", "Lemma 2, (15)", "Lemma 2, corrected"],
)
def test_demands_on_the_profiles_are_those_of_the_page(demand):
    rows = principles.evaluate_demands()
    found = [row["restoring"] for row in rows if row["demand"].startswith(demand)]
    printed = [f"{max(0.0, factor):.2f}" for factor in np.ravel(found)]
    assert "|".join(printed) in PAGE


def test_both_profiles_meet_principle_3_in_both_forms():
    rows = principles.evaluate_demands()
    contact = [row["whole_cycle"] for row in rows if row["demand"].startswith("Principle 3")]
    assert len(contact) == 4
    assert min(contact) > 0.4
    assert max(contact) < 1.0


def test_bounds_of_the_torques():
    proposed, epc = principles.check_torques()
    assert proposed["bound"] == pytest.approx(0.622, abs=5e-4)
    assert proposed["sticking"] == pytest.approx(0.695, abs=5e-4)
    assert epc["bound"] == pytest.approx(0.8477, abs=5e-4)


def test_the_published_torques_are_below_the_bounds():
    for row in principles.check_torques():
        assert row["published"] < row["bound"] <= row["sticking"]


def test_the_pages_print_the_bounds_rounded_down():
    for row in principles.check_torques():
        bound = printed_below(row["bound"], 3)
        sticking = printed_below(row["sticking"], 3)
        assert f"|**{bound} N m**|{sticking} N m|" in PAGE
        assert bound in README


@pytest.mark.parametrize("option", ["newton", "paper"])
@pytest.mark.parametrize("slip", SLIPS)
def test_torque_of_the_proof_does_not_accelerate_the_pendulum(option, slip):
    p = Capsule(normal_force=option).plant()
    theta = np.linspace(-1.0, 1.2, 7)
    torque = principles.torque_without_acceleration(theta, 7.8, slip, p)
    theta_ddot = dynamics.accelerations(theta, 7.8, 0.0, slip, torque, p)[0]
    assert theta_ddot == pytest.approx(0.0, abs=1e-9)


# In the second range the torque is smallest in stick.
@pytest.mark.parametrize(("velocity", "low", "high"), [(7.8, START, SWING), (20.0, 0.2, 1.0)])
def test_bound_of_the_proof_lies_closely_below_every_sample(velocity, low, high):
    theta = np.random.default_rng(0).uniform(low, high, 20_000)
    found = []
    for p in (NEWTON, PAPER):
        for slip in (0.0, 1.0, -1.0):
            found.append(principles.torque_without_acceleration(theta, velocity, slip, p).min())
    bound = principles.torque_at_peak(velocity, low, high)
    assert bound <= min(found) < bound + 2e-4


@pytest.mark.parametrize("samples", [2, 3, 10, 100])
@pytest.mark.parametrize(("velocity", "low", "high"), [(7.8, START, SWING), (20.0, 0.2, 1.0)])
def test_bound_of_the_proof_holds_on_coarse_grids(monkeypatch, samples, velocity, low, high):
    fine = principles.torque_at_peak(velocity, low, high)
    monkeypatch.setattr(principles, "SAMPLES", samples)
    coarse = principles.torque_at_peak(velocity, low, high)
    assert coarse < fine


@pytest.mark.parametrize("p", [NEWTON, PAPER], ids=["newton", "paper"])
@pytest.mark.parametrize("velocity", [0.0, 7.8, 20.0])
def test_slope_of_the_proof_bounds_every_slope(p, velocity):
    theta = np.linspace(-1.2, 1.2, 5001)
    bound = principles._slope_of_torque(1.2, velocity, p)
    for slip in SLIPS:
        torque = principles.torque_without_acceleration(theta, velocity, slip, p)
        steepest = np.abs(np.diff(torque) / np.diff(theta)).max()
        assert steepest <= bound
