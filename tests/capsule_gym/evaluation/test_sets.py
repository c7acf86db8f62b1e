import json

import pytest

from capsule_gym import CapsuleEnv, Disturbances
from capsule_gym.evaluation.sets import FOLDER, TASK_SET_NAMES, load_set, parse_set


def spec(**fields):
    return {"M": 0.5, "mu": 0.01, "seed": 0} | fields


def plant(**fields):
    """The content of a set with one plant."""
    return {"name": "x", "plants": [spec(**fields)]}


def test_a_hash_ignores_layout_and_order(tmp_path):
    content = load_set("drift").to_dict()
    plants = [dict(reversed(each.items())) for each in content["plants"]]
    path = tmp_path / "same.json"
    path.write_text(json.dumps({"plants": plants, "name": content["name"]}))
    assert load_set(path).hash == load_set("drift").hash


def test_a_hash_ignores_integers_for_floats():
    assert parse_set(plant(M=1)).hash == parse_set(plant(M=1.0, changes=[])).hash
    assert parse_set(plant(M=1)).hash != parse_set(plant(M=1, seed=2**128 - 1)).hash


def test_hashes_of_sets_without_sampling_stay():
    # As of a version whose disturbances ended with `push`.
    older = "ffbef85ada8c"
    late = {**plant(), "disturbances": {"latency": 0.01}}
    assert parse_set(late).hash.startswith(older)
    late["disturbances"]["jitter"] = 0.0
    assert parse_set(late).hash.startswith(older)
    late["disturbances"]["jitter"] = 0.001
    found = parse_set(late)
    assert not found.hash.startswith(older)
    assert parse_set(found.to_dict()) == found


def test_an_empty_capsule_is_none():
    (empty,) = parse_set(plant(capsule={})).plants
    assert empty.capsule is None
    CapsuleEnv().reset(options=empty.reset_options())
    CapsuleEnv().reset(options={"capsule": {}, "disturbances": {}})


def test_a_capsule_of_a_plant_is_varied_but_not_disturbed():
    varied = parse_set(plant(capsule={"l": 0.35})).env_kwargs["disturbances"]
    assert varied == Disturbances(stick_threshold=0.0, x_noise=0.0)


def two(**fields):
    """The content of a set of goals whose second plant has these fields."""
    return {"name": "x", "task": "goal", "plants": [spec(), spec(**fields)]}


def changed(t):
    return plant(changes=[{"t": t, "M": 0.5, "mu": 0.01}])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            [],
            r"set must be an object with the fields name, plants and optionally .*disturbances, "
            r"got \[\]",
        ),
        (
            plant(M="heavy"),
            r"set.plants\[0\]: M must be a finite number from 1e-12 to 1e\+12, got 'heavy'",
        ),
        (plant(theta=1.58), r"theta must be an angle in rad within 1\.571 of 0, got 1\.58"),
        (
            plant(capsule={"weight": 1.0}),
            r"\[0\].capsule must be an object with the fields m, l, .*, got .*weight",
        ),
        (
            plant(colour="red"),
            "fields M, mu, seed and optionally theta, changes, capsule, got .*colour",
        ),
        (
            plant(goal=2e6) | {"task": "goal"},
            r"\[0\].goal must be a number of m within 1e\+06 of 0, got 2000000.0",
        ),
        (two(goal=0.1), "set.plants must have a goal each, or none must have one"),
        (
            plant() | {"capsule": {"weight": 1.0}},
            "set.capsule must have fields out of .*mu.*, got .*weight",
        ),
        ("[" * 100_000, r"bad\.json is not an evaluation set: "),
        (two(capsule={"l": 0.3}), "must each have a capsule"),
        (plant(seed=2**128), r"\[0\].seed must be an integer in \[0, 2\*\*128\), got 3402823669"),
        (
            changed(0.0),
            r"changes\[0\]\['t'\] must be a number of seconds within \(0, 33\).*got 0.0",
        ),
        (
            changed(33.0),
            r"changes\[0\]\['t'\] must be a number of seconds within \(0, 33\).*got 33.0",
        ),
    ],
)
def test_malformed_sets_name_the_field_and_what_is_accepted(tmp_path, content, message):
    path = tmp_path / "bad.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(ValueError, match=message) as caught:
        load_set(path)
    assert str(path) in str(caught.value)


# The sets are frozen: a changed hash makes every published result incomparable. Add a set under a
# new name instead.
@pytest.mark.parametrize(
    ("name", "task", "sha256"),
    [
        ("nominal", "speed", "175e0d05f0d7"),
        ("paper", "speed", "0c2b967613ff"),
        ("wide", "speed", "320467521a65"),
        ("extrapolation", "speed", "d16be15d7b3e"),
        ("drift", "speed", "f5da17a7f7a4"),
        ("sticky", "speed", "424bf16c03a5"),
        ("sticky-2", "speed", "b790fab4e287"),
        ("sticky-3", "speed", "d1c2c4de4dcc"),
        ("real", "speed", "0a0741ffbe6c"),
        ("real-wide", "speed", "9d6480404fd7"),
        ("goal", "goal", "fc320f20332b"),
        ("goal-paper", "goal", "5e10e2b674c7"),
        ("velocity", "velocity", "a8ff944552c4"),
    ],
)
def test_a_committed_set_is_frozen(name, task, sha256):
    frozen = load_set(FOLDER / f"{name}.json")
    assert (frozen.name, frozen.task, frozen.hash[:12]) == (name, task, sha256)
    assert (name in TASK_SET_NAMES) == (task != "speed")


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.json")))
def test_the_content_of_a_committed_set_gives_it_back(name):
    frozen = load_set(FOLDER / f"{name}.json")
    assert parse_set(json.loads(json.dumps(frozen.to_dict()))) == frozen
