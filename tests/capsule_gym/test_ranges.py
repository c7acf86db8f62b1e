"""Where a draw lies in its ranges: at their ends, between them, and nowhere else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from capsule_gym.parameters import RANDOMIZATIONS, Capsule, Randomization
from capsule_gym.resets import plant_at, plant_ranges

LAST = math.nextafter(1.0, 0.0)
NAMES = ("paper", "wide", "broad")


@pytest.mark.parametrize("name", NAMES)
def test_the_shares_go_from_end_to_end_of_the_ranges(name):
    ranges = RANDOMIZATIONS[name]
    lines = plant_ranges(ranges, Capsule())
    assert plant_at(lines, 0.0, 0.0) == (ranges.M[0], ranges.mu[0])
    assert plant_at(lines, LAST, LAST) == pytest.approx((ranges.M[1], ranges.mu[1]), rel=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_half_a_range_is_its_mean_and_of_a_logarithm_the_geometric_one(name):
    ranges = RANDOMIZATIONS[name]
    M, mu = plant_at(plant_ranges(ranges, Capsule()), 0.5, 0.5)
    assert M == pytest.approx(sum(ranges.M) / 2.0, rel=1e-15)
    middle = math.sqrt(math.prod(ranges.mu)) if ranges.log_mu else sum(ranges.mu) / 2.0
    assert mu == pytest.approx(middle, rel=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_each_share_moves_its_own_parameter_and_only_upwards(name):
    lines = plant_ranges(RANDOMIZATIONS[name], Capsule())
    shares = np.linspace(0.0, LAST, 201).tolist()
    along_M = np.array([plant_at(lines, share, 0.3) for share in shares])
    along_mu = np.array([plant_at(lines, 0.3, share) for share in shares])
    assert (np.diff(along_M[:, 0]) > 0.0).all() and (np.diff(along_mu[:, 1]) > 0.0).all()
    assert len(set(along_M[:, 1])) == len(set(along_mu[:, 0])) == 1


@pytest.mark.parametrize("share", [0.0, 0.7, LAST])
def test_what_has_no_range_is_the_capsules_own(share):
    capsule = Capsule(M=0.7, mu=0.2)
    assert plant_at(plant_ranges(Randomization(), capsule), share, share) == (0.7, 0.2)
    assert plant_at(plant_ranges(Randomization(M=(0.4, 0.5)), capsule), share, share)[1] == 0.2
    assert plant_at(plant_ranges(Randomization(mu=(0.1, 0.3), log_mu=True), capsule), share, share)[0] == 0.7


def test_a_logarithmic_range_of_one_value_is_that_value():
    assert plant_at(plant_ranges(Randomization(mu=(0.1, 0.1), log_mu=True), Capsule()), 0.5, 0.5)[1] == 0.1
