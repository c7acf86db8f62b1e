import json
from collections import Counter

import numpy as np
import pytest

from agents.evaluation import sets
from agents.evaluation.sets import SET_NAMES, load_set, parse_set
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


def test_hash_ignores_layout_and_integers_for_floats(tmp_path):
    content = load_set("drift").to_dict()
    reordered = {"plants": [dict(reversed(plant.items())) for plant in content["plants"]], "name": content["name"]}
    path = tmp_path / "same.json"
    path.write_text(json.dumps(reordered))
    assert load_set(path).hash == load_set("drift").hash
    one = parse_set({"name": "x", "plants": [{"M": 1, "mu": 0.1, "seed": 0}]})
    assert one.hash == parse_set({"name": "x", "plants": [{"M": 1.0, "mu": 0.1, "seed": 0, "changes": []}]}).hash
    assert one.hash != parse_set({"name": "x", "plants": [{"M": 1.0, "mu": 0.1, "seed": 1}]}).hash


def plant(**fields):
    return {"name": "x", "plants": [{"M": 0.5, "mu": 0.01, "seed": 0} | fields]}


def change(*changes):
    return plant(changes=[dict(zip(("t", "M", "mu"), entry, strict=True)) for entry in changes])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], r"set must be an object with the fields name, plants, got \[\]"),
        ({"name": "x"}, "plants is missing"),
        ({"name": "", "plants": []}, "set.name must be a string that is not empty, got ''"),
        ({"name": "x", "plants": []}, r"at least one plant, got \[\]"),
        ({"name": "x", "plants": {"M": 1}}, "set.plants must be a list"),
        (plant(M="heavy"), r"set.plants\[0\].M must be a finite number > 0 \(kg\), got 'heavy'"),
        (plant(M=0.0), "got 0.0"),
        (plant(mu=0.0), r"set.plants\[0\].mu must be a finite number > 0, got 0.0"),
        (plant(mu=float("nan")), "got nan"),
        (plant(M=0.01, mu=1.0), r"set.plants\[0\]: .*Painleve"),
        (plant(seed=-1), r"seed must be an integer >= 0, got -1"),
        (plant(seed=True), "got True"),
        (plant(theta=1.58), r"theta must be an angle in rad within 1\.571 of 0, got 1\.58"),
        (plant(theta=None), "got None"),
        (plant(colour="red"), "got a field 'colour'"),
        (plant(changes=3), r"set.plants\[0\].changes must be a list"),
        (change((33.0, 0.5, 0.01)), r"changes\[0\].t must be a number of seconds within \(0, 33\).*got 33.0"),
        (change((0.0, 0.5, 0.01)), "got 0.0"),
        (change((5.0, 0.5, 0.01), (5.0, 0.5, 0.01)), r"changes\[1\].t .*later than the change before, got 5.0"),
        (change((5.0, -0.5, 0.01)), r"changes\[0\].M must be a finite number > 0"),
    ],
)
def test_malformed_sets_name_the_field_and_what_is_accepted(tmp_path, content, message):
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=message) as caught:
        load_set(path)
    assert str(path) in str(caught.value)


def test_unknown_sets_and_broken_files(tmp_path):
    with pytest.raises(ValueError, match=r"set must be one of nominal, paper, wide, .* got 'papr'"):
        load_set("papr")
    path = tmp_path / "broken.json"
    path.write_text("{")
    with pytest.raises(ValueError, match=r"broken\.json is not an evaluation set"):
        load_set(path)


def test_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sets, "SETS_FOLDER", tmp_path / "sets")
    assert sets.main([]) == 0
    assert sets.stale_sets(tmp_path / "sets") == []
    (tmp_path / "sets" / "wide.json").unlink()
    (tmp_path / "sets" / "paper.json").write_text("{}")
    stale = sets.stale_sets(tmp_path / "sets")
    assert [line.split("/")[-1] for line in stale] == ["paper.json differs from its draw", "wide.json is missing"]
