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
WIDE = RANDOMIZATIONS["wide"]


def within(value, bounds):
    return bounds[0] <= value <= bounds[1]


@pytest.mark.parametrize("name", SET_NAMES)
def test_committed_sets_are_frozen(name):
    frozen = load_set(name)
    assert (frozen.name, frozen.hash[:12], len(frozen.plants)) == (name, HASHES[name], 100)


def test_nominal_is_one_plant_from_many_angles():
    plants = load_set("nominal").plants
    assert {(plant.M, plant.mu, plant.changes) for plant in plants} == {(NOMINAL.M, NOMINAL.mu, ())}
    assert plants[0].theta == START_THETA
    starts = np.array([plant.theta for plant in plants])
    assert len(set(starts.tolist())) == 100
    assert np.ptp(starts) > 0.18 and np.abs(starts - START_THETA).max() <= 0.1
    # The others start where the environment does.
    assert all(plant.theta == START_THETA for name in SET_NAMES[1:] for plant in load_set(name).plants)


@pytest.mark.parametrize("name", ["paper", "wide"])
def test_plants_fill_their_ranges(name):
    ranges = RANDOMIZATIONS[name]
    plants = load_set(name).plants
    for values, bounds in (([p.M for p in plants], ranges.M), (np.log([p.mu for p in plants]), np.log(ranges.mu))):
        assert bounds[0] <= min(values) and max(values) <= bounds[1]
        assert np.ptp(values) > 0.9 * np.ptp(bounds)


def test_extrapolation_is_outside_wide():
    outside = Counter()
    for plant in load_set("extrapolation").plants:
        assert within(plant.M, (0.25, 1.2)) and within(plant.mu, (0.002, 0.6))
        outside[(not within(plant.M, WIDE.M), not within(plant.mu, WIDE.mu))] += 1
    assert set(outside) == {(True, False), (False, True), (True, True)} and min(outside.values()) >= 33


def test_drift_changes_twice_within_wide():
    for plant in load_set("drift").plants:
        first, second = plant.changes
        assert 5.5 <= first.t <= 11.0 and 22.0 <= second.t <= 27.5
        assert all(within(part.M, WIDE.M) and within(part.mu, WIDE.mu) for part in (plant, first, second))


def test_the_command_writes_the_committed_files(tmp_path, monkeypatch):
    committed = sets.SETS_FOLDER
    monkeypatch.setattr(sets, "SETS_FOLDER", tmp_path)
    assert sets.main([]) == 0
    for name in SET_NAMES:
        assert (tmp_path / f"{name}.json").read_bytes() == (committed / f"{name}.json").read_bytes()
