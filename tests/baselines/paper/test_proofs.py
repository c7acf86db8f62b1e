"""The proof about the torques: its bounds compared with brute force, and the pages that print them."""

import math
from pathlib import Path

import numpy as np
import pytest

from baselines.paper import principles as proofs
from baselines.paper import published
from baselines.tables import printed_below
from capsule_gym import Capsule, dynamics

ROOT = Path(__file__).resolve().parents[3]
START = -math.pi / 3
SWINGS = {name: math.radians(numbers["swing"].value) for name, numbers in published.RUNS.items()}


def test_the_published_torques_are_below_the_bounds():
    proposed, epc = proofs.check_torques()
    found = (proposed["bound"], proposed["sticking"], epc["bound"])
    assert found == pytest.approx((0.622, 0.695, 0.8477), abs=5e-4)
    for row in (proposed, epc):
        assert row["published"] < row["bound"] <= row["sticking"]


@pytest.mark.parametrize("option", ["newton", "paper"])
@pytest.mark.parametrize("slip", [0.0, 1.0, -1.0])
def test_torque_of_the_proof_does_not_accelerate_the_pendulum(option, slip):
    p = Capsule(normal_force=option).plant()
    for theta in np.linspace(-1.0, 1.2, 7):
        torque = proofs.torque_without_acceleration(np.array([theta]), 7.8, slip, p)[0]
        assert dynamics.accelerations(theta, 7.8, 0.0, slip, torque, p)[0] == pytest.approx(0.0, abs=1e-9)


def test_bound_of_the_proof_lies_below_every_sample_and_close():
    theta = np.random.default_rng(0).uniform(START, SWINGS["proposed"], 20_000)
    bound = proofs.torque_at_peak(7.8, START, SWINGS["proposed"])
    smallest = min(
        proofs.torque_without_acceleration(theta, 7.8, slip, Capsule(normal_force=option).plant()).min()
        for slip in (0.0, 1.0, -1.0)
        for option in ("newton", "paper")
    )
    assert bound <= smallest < bound + 1e-3


def test_pages_print_the_bounds_rounded_outwards():
    page, readme = ((ROOT / name).read_text(encoding="utf-8") for name in ("docs/paper.md", "README.md"))
    for peak in proofs.check_torques():
        bound, sticking = (printed_below(peak[name], 3) for name in ("bound", "sticking"))
        assert f"|**{bound} N m**|{sticking} N m|" in page and bound in readme
