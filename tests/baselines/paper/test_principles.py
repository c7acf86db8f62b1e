"""Principles 1 to 4 and both Lemmas: values computed by hand, and implications between them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from baselines.paper.principles import (
    Cycle,
    check_lemmas,
    evaluate_demands,
    lemma_1,
    lemma_2,
    principle_3,
    principle_4,
)
from capsule_gym import dynamics
from capsule_gym.parameters import Capsule

ROOT = Path(__file__).resolve().parents[3]
NOMINAL = Capsule().plant()
ML = 0.138 * 0.3
WEIGHT = 0.638 * 9.81


def state(theta: float, theta_dot: float, theta_ddot: float = 0.0) -> Cycle:
    """A single state of the pendulum."""
    return Cycle(np.zeros(1), np.zeros(1, np.int64), *(np.array([value]) for value in (theta, theta_dot, theta_ddot)))


@pytest.mark.parametrize("form", ["newton", "paper"])
def test_principles_3_and_4_are_normal_force_and_driving_force(form):
    p = Capsule(normal_force=form, backward_ratio=3.0, static_ratio=2.0).plant()
    rng = np.random.default_rng(0)
    for theta, theta_dot, theta_ddot in rng.uniform(-1.0, 1.0, (50, 3)) * [1.5, 10.0, 50.0]:
        cycle = state(theta, theta_dot, theta_ddot)
        contact, standstill = principle_3(cycle, p, form), principle_4(cycle, p, form)
        normal = dynamics.normal_force(theta, theta_dot, theta_ddot, p)
        assert contact.limit - contact.load[0] == pytest.approx(normal, rel=1e-12)
        force = dynamics.driving_force(theta, theta_dot, theta_ddot, p)
        # The printed form counts the torque of spring and damper as a force.
        force += (form == "paper") * (p.k * theta + p.c * theta_dot) * math.cos(theta)
        assert standstill.load[0] == pytest.approx(abs(force), rel=1e-9)
        assert standstill.limit[0] == pytest.approx(p.mu * 2.0 * (3.0 if force < 0.0 else 1.0) * normal, rel=1e-9)


def test_lemma_1_is_neither_sufficient_nor_necessary():
    # (10) is not sufficient for contact: upright at 15 rad/s with a = 0.
    flying = state(0.0, 15.0, -0.0923 * 15.0 / ML)
    assert lemma_1(flying, NOMINAL, "paper").load[0] == pytest.approx(0.0, abs=1e-9)
    assert lemma_1(flying, NOMINAL, "paper").limit == pytest.approx(WEIGHT**2 / (2 * ML))
    assert principle_3(flying, NOMINAL, "paper").ratio[0] == pytest.approx(ML * 225.0 / WEIGHT)
    # (10) is not necessary for contact: upright, the acceleration does not enter (7).
    standing = state(0.0, 10.0, 400.0)
    assert lemma_1(standing, NOMINAL).ratio[0] > 1.0 > principle_3(standing, NOMINAL).ratio[0]


def test_lemma_2_by_hand():
    printed = lemma_2(state(-0.5, 0.2, 0.7), NOMINAL, "paper")
    assert printed.load[0] == pytest.approx(0.7 + 0.04 - 0.18 + 0.01846)
    assert printed.limit == pytest.approx(WEIGHT / ML * 0.01 / math.sqrt(1.0001))
    corrected = lemma_2(state(-0.5, 0.2, 0.7), NOMINAL, "paper", sufficient=True)
    assert corrected.load[0] == pytest.approx(abs(0.7 + (-0.18 + 0.01846) / ML) + 0.04)


def test_lemmas_as_printed_imply_nothing_and_corrected_imply_their_principles():
    rows = check_lemmas(20_000)
    assert len(rows) == 6
    for row in rows:
        assert row["states"] > 500
        assert (row["violations"] > 0) == (row["worst"] > 1.0) == ("as printed" in row["lemma"]), row
    # The corrected bounds are close: a state in 20,000 comes within a few percent of the limit.
    assert all(row["worst"] > 0.9 for row in rows)


def test_demands_on_the_profiles_are_those_of_the_page():
    rows, page = evaluate_demands(), (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    for demand in ("Principle 4 (8)", "Lemma 2 (15)"):
        for forms in (("as printed",), ("Newton's forces", "corrected, Newton's forces")):
            margins = [row["restoring"] for row in rows if row["demand"] == demand and row["form"] in forms]
            assert "|".join(f"{max(0.0, factor):.2f}" for phases in margins for factor in phases) in page
    met = [row["profile"] for row in rows if row["met"] and row["demand"].startswith("Principle")]
    # The proposed profile defines Principle 2, rate and acceleration; both profiles meet Principle 3 in both forms.
    assert met == ["proposed"] * 4 + ["EPC"] * 2
    largest = [row["progressive"] for row in rows if row["demand"].startswith("Principle 2")]
    assert largest == pytest.approx([1.0, 1.0, 11.0 / 7.8, 11.0 * math.pi / 0.2 / 129.627], rel=1e-5)
