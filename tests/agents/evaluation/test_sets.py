from collections import Counter

import numpy as np
import pytest

from agents.evaluation import sets
from capsule_gym.evaluation_sets import SET_NAMES, load_set
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS
from capsule_gym.task import START_THETA

# The sets are frozen: a changed hash makes every published result incomparable. Add a set under a new name instead.
HASHES = {
    "nominal": "175e0d05f0d7",
    "paper": "b735055ceff1",
    "wide": "4eb52be12a6e",
    "extrapolation": "37f72254b16c",
    "drift": "a64a8c831746",
}


def within(value, bounds):
    return bounds[0] <= value <= bounds[1]


@pytest.mark.parametrize("name", SET_NAMES)
def test_committed_sets_are_frozen(name):
    frozen = load_set(name)
    assert frozen.name == name
    assert frozen.hash[:12] == HASHES[name]
    assert len(frozen.plants) == 100


def test_committed_sets_are_what_their_seeds_give():
    assert sets.stale_sets() == []


def test_nominal_is_one_plant_from_many_angles():
    plants = load_set("nominal").plants
    assert {(plant.M, plant.mu, plant.changes) for plant in plants} == {(NOMINAL.M, NOMINAL.mu, ())}
    assert plants[0].theta == START_THETA
    starts = np.array([plant.theta for plant in plants])
    assert len(set(starts.tolist())) == 100
    assert np.abs(starts - START_THETA).max() <= 0.1
    assert np.ptp(starts) > 0.18
    # The others start where the environment does.
    assert all(plant.theta == START_THETA for name in SET_NAMES[1:] for plant in load_set(name).plants)


@pytest.mark.parametrize("name", ["paper", "wide"])
def test_draws_fill_their_ranges(name):
    ranges = RANDOMIZATIONS[name]
    M = np.array([plant.M for plant in load_set(name).plants])
    mu = np.array([plant.mu for plant in load_set(name).plants])
    assert ranges.M[0] <= M.min() < M.max() <= ranges.M[1]
    assert ranges.mu[0] <= mu.min() < mu.max() <= ranges.mu[1]
    assert np.ptp(M) > 0.9 * np.subtract(*ranges.M[::-1])
    assert np.ptp(np.log(mu)) > 0.9 * np.log(ranges.mu[1] / ranges.mu[0])


def test_extrapolation_is_outside_wide():
    wide = RANDOMIZATIONS["wide"]
    outside = Counter()
    for plant in load_set("extrapolation").plants:
        assert within(plant.M, (0.25, 1.2))
        assert within(plant.mu, (0.002, 0.6))
        outside[(not within(plant.M, wide.M), not within(plant.mu, wide.mu))] += 1
    assert set(outside) == {(True, False), (False, True), (True, True)}
    assert min(outside.values()) >= 33


def test_drift_jumps_twice_within_wide():
    wide = RANDOMIZATIONS["wide"]
    for plant in load_set("drift").plants:
        first, second = plant.changes
        assert 5.5 <= first.t <= 11.0
        assert 22.0 <= second.t <= 27.5
        for part in (plant, first, second):
            assert within(part.M, wide.M)
            assert within(part.mu, wide.mu)


def test_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sets, "SETS_FOLDER", tmp_path / "sets")
    assert sets.main([]) == 0
    assert sets.stale_sets(tmp_path / "sets") == []
    (tmp_path / "sets" / "wide.json").unlink()
    (tmp_path / "sets" / "paper.json").write_text("{}")
    stale = sets.stale_sets(tmp_path / "sets")
    assert [line.split("/")[-1] for line in stale] == ["paper.json differs from its draw", "wide.json is missing"]
