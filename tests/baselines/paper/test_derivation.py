"""What is found of the paper's Sections 2 and 3: Property 3, the printed profile, demands, lemmas, other shapes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from baselines.laws.profiles import EPC, PROPOSED
from baselines.paper.demand_study import implications, keepings
from baselines.paper.linearity import check_linearity
from baselines.paper.printed_profile import printed_phases
from baselines.paper.shapes import ALTERNATIVES, shape_speeds


def test_property_3_holds_and_friction_is_linear_in_products_alone():
    found = check_linearity(200)
    assert found.residual < 1e-14
    assert found.products < 1e-14
    # Half of the sum of (1 - a)(1 - b) and (1 + a)(1 + b) is 1 + a b, with a = 0.05 / 0.638 and b = 0.1.
    assert found.defect == pytest.approx(0.05 / 0.638 * 0.1, rel=1e-9)


def test_printed_profile_by_hand():
    phases = {phase.name: phase for phase in printed_phases()}
    # IV: (t3 - t) / (t3 - t2) P2 falls from 0 to -0.63 / 0.075 P2.
    assert (phases["IV"].begins, phases["IV"].ends) == pytest.approx((0.0, -0.63 / 0.075 * 2.122))
    assert phases["IV"].turns == pytest.approx(-0.5 * 0.63 * 0.63 / 0.075 * 2.122)
    # V: (t3 - t) / (t4 - t3) P3 falls from -P3 to -1.43 / 0.63 P3; VII rises from 0 to 0.8 / 4.1 P3.
    P3 = PROPOSED.restoring_speed
    assert (phases["V"].begins, phases["V"].ends) == pytest.approx((-P3, -1.43 / 0.63 * P3))
    assert phases["VII"].ends == pytest.approx(0.8 / 4.1 * P3)
    # III: sin(omega t - t2) with omega = pi / (2 t1).
    assert phases["III"].begins == pytest.approx(7.8 * math.sin(math.pi / 0.266 * 0.195 - 0.195))
    assert [name for name, phase in phases.items() if phase.deviates] == ["III", "IV", "V", "VII"]
    assert sum(phase.built_turns for phase in phases.values()) == pytest.approx(0.0, abs=1e-12)
    assert math.degrees(sum(phase.turns for phase in phases.values())) < -300.0


def keeping(profile, demand, form):
    return next(k for k in keepings() if (k.profile, k.demand) == (profile, demand) and form in k.form)


def test_demands_of_both_profiles():
    swings = {"proposed": 68.75, "EPC": 85.85}
    for profile, swing in swings.items():
        first = keeping(profile, "Principle 1 (5)", "60 deg")
        assert max(first.restoring) == pytest.approx(swing / 60.0, abs=2e-3)
        assert not first.kept
        assert keeping(profile, "Principle 3 (7)", "Newton").kept
        assert not keeping(profile, "Principle 4 (8)", "Newton").kept
        assert not keeping(profile, "Principle 4 (8)", "as printed").kept
    # Its own largest values are the bounds of the one; the other needs 11 rad/s and 11 pi / 0.2 rad/s^2.
    assert keeping("proposed", "Principle 2 (6), theta'", "bounds").progressive == pytest.approx(1.0)
    assert keeping("EPC", "Principle 2 (6), theta'", "bounds").progressive == pytest.approx(11.0 / 7.8)
    assert keeping("EPC", "Principle 2 (6), theta''", "bounds").progressive == pytest.approx(
        11 * math.pi / 0.2 / 129.627, rel=1e-5
    )


def test_what_the_lemmas_imply():
    found = {(row.lemma.split(",")[0], "printed" in row.lemma, row.form): row for row in implications(20_000)}
    assert len(found) == 6
    for (lemma, printed, _), row in found.items():
        assert row.states > 500
        # As printed neither implies its principle; (12) and the mended (15) do.
        assert (row.violations > 0) == printed, lemma
        assert (row.worst > 1.0) == printed


def test_alternatives_keep_what_is_published():
    for name, make in ALTERNATIVES:
        profile = make()
        original = PROPOSED if profile.name == "proposed" else EPC
        np.testing.assert_allclose(profile.times, original.times, atol=1e-12)
        angle, rate, _ = profile.evaluate(np.linspace(0.0, profile.period, 66_001)[:-1])
        assert rate.max() == pytest.approx(7.8 if original is PROPOSED else 11.0, rel=1e-6), name
        assert math.degrees(angle.max()) == pytest.approx(68.75 if original is PROPOSED else 85.85, abs=0.02), name
        edges = profile.times
        before, after = profile.evaluate(edges - 1e-9), profile.evaluate(edges + 1e-9)
        np.testing.assert_allclose(before[1], after[1], atol=1e-5)
        np.testing.assert_allclose(before[0], after[0], atol=1e-7)


def test_epc_is_faster_in_every_shape():
    speeds = shape_speeds()
    epc, proposed = ([row.mean_speed for row in speeds if row.profile == name] for name in ("EPC", "proposed"))
    assert len(epc) == 5 and len(proposed) == 4
    assert 1.45 < min(epc) and max(epc) < 1.75
    assert 1.25 < min(proposed) and max(proposed) < 1.46
    assert [row.mean_speed for row in speeds if row.assumed] == pytest.approx([1.627, 1.384], abs=1e-3)
