"""Both proofs: the bounds compared with brute force, and the pages that print them."""

from __future__ import annotations

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
        assert row["holds"] and row["published"] < row["bound"] <= row["sticking"]


@pytest.mark.parametrize("option", ["newton", "paper"])
@pytest.mark.parametrize("slip", [0.0, 1.0, -1.0])
def test_torque_of_proof_1_does_not_accelerate_the_pendulum(option, slip):
    p = Capsule(normal_force=option).plant()
    for theta in np.linspace(-1.0, 1.2, 7):
        torque = proofs.torque_without_acceleration(np.array([theta]), 7.8, slip, p)[0]
        assert dynamics.accelerations(theta, 7.8, 0.0, slip, torque, p)[0] == pytest.approx(0.0, abs=1e-9)


def test_bound_of_proof_1_lies_below_every_sample_and_close():
    theta = np.random.default_rng(0).uniform(START, SWINGS["proposed"], 20_000)
    bound, _, _ = proofs.torque_at_peak(7.8, START, SWINGS["proposed"])
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
        assert row["holds"] and row["torque"] < row["torque_needed"] < row["torque_enough"]
        assert row["from_start"] < row["bound"]
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
        assert " | ".join(first) in page and " | ".join(second) in page
        assert printed_above(rate["undamped"], 2) in page and printed_above(rate["bound"], 3) in readme
