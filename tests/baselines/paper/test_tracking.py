"""Both profiles on the platform: exact tracking and the law (35), compared with each other and with closed forms."""

import numpy as np
import pytest

from baselines.laws.profiles import EPC, PROPOSED
from baselines.paper.tracking import friction_for, grid, speed_map, speed_ratio, track


@pytest.fixture(scope="module")
def maps():
    M, mu = grid(8, 31)
    return [speed_map(profile, M, mu) for profile in (PROPOSED, EPC)]


@pytest.mark.parametrize(
    ("profile", "speed", "torque", "energy", "transport"),
    [(PROPOSED, 1.384, 1.2513, 1.380, 2.412), (EPC, 1.627, 2.2085, 1.792, 2.664)],
    ids=["proposed", "EPC"],
)
def test_law_reproduces_exact_tracking(profile, speed, torque, energy, transport):
    run = track(profile)
    assert (run["mean_speed"], run["peak_torque"]) == pytest.approx((speed, torque), rel=2e-3)
    assert (run["energy"], run["cost_of_transport"]) == pytest.approx((energy, transport), rel=4e-3)
    assert speed_map(profile, h=2e-5)[0, 0] == pytest.approx(speed, abs=0.5e-3)
    # The contact option has little effect.
    assert 1e-4 < abs(track(profile, "paper")["mean_speed"] / run["mean_speed"] - 1.0) < 0.01


def test_epc_is_faster_wherever_it_moves(maps):
    ratio = speed_ratio(*maps)
    assert np.nanmax(ratio) == pytest.approx(0.88, abs=0.02)
    assert np.isnan(ratio[maps[1] <= 0.01]).all()


def test_speed_without_friction_and_with_very_much():
    # Without friction, the centre of mass stays at rest, and the platform is back after every closed cycle.
    assert speed_map(PROPOSED, [0.3, 1.0], [0.0]) == pytest.approx(0.0, abs=1e-4)
    assert (speed_map(PROPOSED, [1.0], [2.0]) == 0.0).all()


def test_no_friction_gives_both_published_speeds():
    frictions = []
    for profile, published in ((PROPOSED, 0.642), (EPC, 0.629)):
        (mu,) = friction_for(profile, published)
        frictions.append(mu)
        assert speed_map(profile, mu=[mu])[0, 0] == pytest.approx(published, rel=0.01)
    assert frictions == pytest.approx([0.104, 0.189], abs=0.001)
    assert friction_for(PROPOSED, 5.0) == []
