"""Principles 1 to 4, both Lemmas and the proof about the torques: by hand, by brute force, and what
implies what."""

import math

import numpy as np
import pytest

from baselines.paper import principles, published
from baselines.paper.principles import (
    NEWTON,
    PAPER,
    Cycle,
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
SWINGS = {name: math.radians(numbers["swing"].value) for name, numbers in published.RUNS.items()}


def state(theta, theta_dot, theta_ddot=0.0):
    """A single state of the pendulum."""
    return Cycle(
        np.zeros(1),
        np.zeros(1, np.int64),
        *(np.array([value]) for value in (theta, theta_dot, theta_ddot)),
    )


@pytest.mark.parametrize("form", ["newton", "paper"])
def test_principles_3_and_4_by_hand(form):
    p = Capsule(normal_force=form, backward_ratio=3.0, static_ratio=2.0).plant()
    rng = np.random.default_rng(0)
    for theta, theta_dot, theta_ddot in rng.uniform(-1.0, 1.0, (50, 3)) * [1.5, 10.0, 50.0]:
        cycle = state(theta, theta_dot, theta_ddot)
        contact, standstill = principle_3(cycle, p), principle_4(cycle, p)
        # The printed forms (7) and (8) count the torque of spring and damper as a force.
        a = ML * theta_ddot + (form == "paper") * (0.36 * theta + 0.0923 * theta_dot)
        b = ML * theta_dot**2
        lift = b * math.cos(theta) + a * math.sin(theta)
        assert (contact.load[0], contact.limit) == pytest.approx((lift, WEIGHT), rel=1e-9)
        force = a * math.cos(theta) - b * math.sin(theta)
        assert standstill.load[0] == pytest.approx(abs(force), rel=1e-9)
        limit = 0.01 * 2.0 * (3.0 if force < 0.0 else 1.0) * (WEIGHT - lift)
        assert standstill.limit[0] == pytest.approx(limit, rel=1e-9)


def test_lemma_1_is_neither_sufficient_nor_necessary_and_lemma_2_by_hand():
    # (10) is not sufficient for contact: upright at 15 rad/s with a = 0.
    flying = state(0.0, 15.0, -0.0923 * 15.0 / ML)
    assert lemma_1(flying, PAPER).load[0] == pytest.approx(0.0, abs=1e-9)
    assert lemma_1(flying, PAPER).limit == pytest.approx(WEIGHT**2 / (2 * ML))
    assert principle_3(flying, PAPER).ratio[0] == pytest.approx(ML * 225.0 / WEIGHT)
    # (10) is not necessary for contact: upright, the acceleration does not enter (7).
    standing = state(0.0, 10.0, 400.0)
    assert lemma_1(standing, NEWTON).ratio[0] > 1.0 > principle_3(standing, NEWTON).ratio[0]
    printed = lemma_2(state(-0.5, 0.2, 0.7), PAPER)
    assert printed.load[0] == pytest.approx(0.7 + 0.04 - 0.18 + 0.01846)
    assert printed.limit == pytest.approx(WEIGHT / ML * 0.01 / math.sqrt(1.0001))
    corrected = lemma_2(state(-0.5, 0.2, 0.7), PAPER, sufficient=True)
    assert corrected.load[0] == pytest.approx(abs(0.7 + (-0.18 + 0.01846) / ML) + 0.04)


def test_lemmas_as_printed_imply_nothing_and_corrected_imply_their_principles():
    rows = principles.check_lemmas(20_000)
    assert len(rows) == 6
    for row in rows:
        assert row["states"] > 500
        assert (row["violations"] > 0) == (row["worst"] > 1.0) == ("as printed" in row["lemma"]), (
            row
        )
    # The corrected bounds are close: a state in 20,000 comes within a few percent of the limit.
    assert all(row["worst"] > 0.9 for row in rows)


def test_demands_on_the_profiles_are_those_of_the_page():
    rows, page = (
        principles.evaluate_demands(),
        (ROOT / "docs" / "paper.md").read_text(encoding="utf-8"),
    )
    for demand in (
        "Principle 4, Newton",
        "Principle 4, (8)",
        "Lemma 2, (15)",
        "Lemma 2, corrected",
    ):
        found = [row["restoring"] for row in rows if row["demand"].startswith(demand)]
        assert "|".join(f"{max(0.0, factor):.2f}" for phases in found for factor in phases) in page
    # Both profiles meet Principle 3 in both forms.
    contact = [row["whole_cycle"] for row in rows if row["demand"].startswith("Principle 3")]
    assert len(contact) == 4 and 0.4 < min(contact) and max(contact) < 1.0


def test_the_published_torques_are_below_the_bounds_which_pages_print_rounded_outwards():
    page, readme = (
        (ROOT / name).read_text(encoding="utf-8") for name in ("docs/paper.md", "README.md")
    )
    proposed, epc = principles.check_torques()
    assert (proposed["bound"], proposed["sticking"], epc["bound"]) == pytest.approx(
        (0.622, 0.695, 0.8477), abs=5e-4
    )
    for row in (proposed, epc):
        assert row["published"] < row["bound"] <= row["sticking"]
        bound, sticking = (printed_below(row[name], 3) for name in ("bound", "sticking"))
        assert f"|**{bound} N m**|{sticking} N m|" in page and bound in readme


@pytest.mark.parametrize("option", ["newton", "paper"])
@pytest.mark.parametrize("slip", [0.0, 1.0, -1.0])
def test_torque_of_the_proof_does_not_accelerate_the_pendulum(option, slip):
    p = Capsule(normal_force=option).plant()
    for theta in np.linspace(-1.0, 1.2, 7):
        torque = principles.torque_without_acceleration(np.array([theta]), 7.8, slip, p)[0]
        assert dynamics.accelerations(theta, 7.8, 0.0, slip, torque, p)[0] == pytest.approx(
            0.0, abs=1e-9
        )


def test_bound_of_the_proof_lies_below_every_sample_and_close():
    theta = np.random.default_rng(0).uniform(START, SWINGS["proposed"], 20_000)
    bound = principles.torque_at_peak(7.8, START, SWINGS["proposed"])
    plants = [Capsule(normal_force=option).plant() for option in ("newton", "paper")]
    found = [
        principles.torque_without_acceleration(theta, 7.8, slip, p)
        for slip in (0.0, 1.0, -1.0)
        for p in plants
    ]
    assert bound <= np.min(found) < bound + 1e-4
