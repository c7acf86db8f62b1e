"""The parameter selection (20) to (31) by hand; both profiles compared with each other and with
closed forms."""

import numpy as np
import pytest

from baselines.paper import selection
from baselines.paper.tracking import friction_for, grid, speed_map, speed_ratio, track
from capsule_gym.control.laws.profiles import EPC, PROPOSED

# Equation, given and implied value of each row, to half a unit of the last given digit, and whether
# one follows.
EXPECTED = [
    ("(21)", "0.76", "2.11", False), ("(22)", "0.88", "2.09", False), ("(22)", "1.27", "2.09", False),
    ("(22)", "1.26", "2.09", False), ("(23)", "0.53", "1.05", False), ("(24)", "2.51", "0.133", False),
    ("(25)", "2.91", "0.195", False), ("(25)", "0.323", "0.195", False), ("(26)", "11.64", "11.81", True),
    ("(27)", "0.895", "0.9", True), ("(27)", "2.113", "2.122", True), ("(28)", "5.63", "1.7", False),
    ("(29)", "2.68", "0.563", False), ("(30)", "5.80", "5.8", True), ("(31)", "6.60", "6.6", True),
]  # fmt: skip
RUNS = {
    "proposed": (PROPOSED, 1.384, 1.2513, 1.380, 2.412),
    "EPC": (EPC, 1.627, 2.2085, 1.792, 2.664),
}


@pytest.mark.parametrize(
    ("profile", "speed", "torque", "energy", "transport"), RUNS.values(), ids=RUNS
)
def test_law_reproduces_exact_tracking(profile, speed, torque, energy, transport):
    run = track(profile)
    assert (run["mean_speed"], run["peak_torque"]) == pytest.approx((speed, torque), rel=2e-3)
    assert (run["energy"], run["cost_of_transport"]) == pytest.approx((energy, transport), rel=4e-3)
    assert speed_map(profile, h=2e-5)[0, 0] == pytest.approx(speed, abs=0.5e-3)
    # The contact option has little effect.
    assert 1e-4 < abs(track(profile, "paper")["mean_speed"] / run["mean_speed"] - 1.0) < 0.01


def test_epc_is_faster_wherever_it_moves():
    maps = [speed_map(profile, *grid(8, 31)) for profile in (PROPOSED, EPC)]
    ratio = speed_ratio(*maps)
    assert (
        np.nanmax(ratio) == pytest.approx(0.88, abs=0.02) and np.isnan(ratio[maps[1] <= 0.01]).all()
    )


def test_speeds_without_friction_with_very_much_and_as_published():
    # Without friction, the centre of mass stays at rest, and the platform is back after every
    # closed cycle.
    assert speed_map(PROPOSED, [0.3, 1.0], [0.0]) == pytest.approx(0.0, abs=1e-4)
    assert (speed_map(PROPOSED, [1.0], [2.0]) == 0.0).all()
    frictions = []
    for profile, published in ((PROPOSED, 0.642), (EPC, 0.629)):
        (mu,) = friction_for(profile, published)
        frictions.append(mu)
        assert speed_map(profile, mu=[mu])[0, 0] == pytest.approx(published, rel=0.01)
    assert (
        frictions == pytest.approx([0.104, 0.189], abs=0.001) and friction_for(PROPOSED, 5.0) == []
    )


def test_what_follows_from_the_selection():
    for row, (equation, gives, implied, follows) in zip(
        selection.evaluate_selection(), EXPECTED, strict=True
    ):
        assert row["equation"] == equation
        for value, printed in ((row["gives"], gives), (row["implied"], implied)):
            assert value == pytest.approx(
                float(printed), abs=0.5001 * 10.0 ** -len(printed.partition(".")[2])
            )
        assert row["follows"] is follows
