import json

import pytest

from capsule_gym import CapsuleEnv, Disturbances
from capsule_gym.evaluation.sets import FOLDER, TASK_SET_NAMES, load_set, parse_set


def test_hash_ignores_layout_and_integers_for_floats(tmp_path):
    content = load_set("drift").to_dict()
    reordered = {
        "plants": [dict(reversed(plant.items())) for plant in content["plants"]],
        "name": content["name"],
    }
    path = tmp_path / "same.json"
    path.write_text(json.dumps(reordered))
    assert load_set(path).hash == load_set("drift").hash
    one = parse_set({"name": "x", "plants": [{"M": 1, "mu": 0.1, "seed": 0}]})
    assert (
        one.hash
        == parse_set(
            {"name": "x", "plants": [{"M": 1.0, "mu": 0.1, "seed": 0, "changes": []}]}
        ).hash
    )
    assert (
        one.hash
        != parse_set({"name": "x", "plants": [{"M": 1.0, "mu": 0.1, "seed": 2**128 - 1}]}).hash
    )


def test_an_empty_capsule_is_none():
    (only,) = parse_set(plant(capsule={})).plants
    assert only.capsule is None
    # A plant of its own is varied, but not disturbed.
    varied = parse_set(plant(capsule={"l": 0.35})).env_kwargs["disturbances"]
    assert varied == Disturbances(stick_threshold=0.0, x_noise=0.0)
    for options in (only.reset_options(), {"capsule": {}, "disturbances": {}}):
        CapsuleEnv().reset(options=options)


def plant(**fields):
    return {"name": "x", "plants": [{"M": 0.5, "mu": 0.01, "seed": 0} | fields]}


ONE_GOAL = {"name": "x", "task": "goal", "plants": [*plant()["plants"], *plant(goal=0.1)["plants"]]}
EARLY, LATE = (plant(changes=[{"t": t, "M": 0.5, "mu": 0.01}]) for t in (0.0, 33.0))
MALFORMED = [
    (
        [],
        r"set must be an object with the fields name, plants and optionally .*disturbances, got \[\]",
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
        {**plant(goal=2e6), "task": "goal"},
        r"\[0\].goal must be a number of m within 1e\+06 of 0, got 2000000.0",
    ),
    (ONE_GOAL, "set.plants must have a goal each, or none must have one"),
    (
        {**plant(), "capsule": {"weight": 1.0}},
        "set.capsule must have fields out of .*mu.*, got .*weight",
    ),
    ("[" * 100_000, r"bad\.json is not an evaluation set: "),
    (
        {**ONE_GOAL, "plants": [*plant()["plants"], *plant(capsule={"l": 0.3})["plants"]]},
        "must each have a capsule",
    ),
    (plant(seed=2**128), r"\[0\].seed must be an integer in \[0, 2\*\*128\), got 3402823669"),
    (EARLY, r"changes\[0\]\['t'\] must be a number of seconds within \(0, 33\).*got 0.0"),
    (LATE, r"changes\[0\]\['t'\] must be a number of seconds within \(0, 33\).*got 33.0"),
]


@pytest.mark.parametrize(("content", "message"), MALFORMED)
def test_malformed_sets_name_the_field_and_what_is_accepted(tmp_path, content, message):
    path = tmp_path / "bad.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(ValueError, match=message) as caught:
        load_set(path)
    assert str(path) in str(caught.value)


# The sets are frozen: a changed hash makes every published result incomparable. Add a set under a
# new name instead.
HASHES = {
    "nominal": "175e0d05f0d7", "paper": "0c2b967613ff", "wide": "320467521a65", "extrapolation": "d16be15d7b3e",
    "drift": "f5da17a7f7a4", "sticky": "424bf16c03a5", "sticky-2": "b790fab4e287", "sticky-3": "d1c2c4de4dcc",
    "real": "0a0741ffbe6c", "real-wide": "9d6480404fd7", "goal": "fc320f20332b", "goal-paper": "5e10e2b674c7",
    "velocity": "a8ff944552c4",
}  # fmt: skip


@pytest.mark.parametrize("name", HASHES)
def test_committed_sets_are_frozen_and_their_files_give_them_back(name):
    frozen = load_set(FOLDER / f"{name}.json")
    assert (frozen.name, frozen.hash[:12]) == (name, HASHES[name])
    assert parse_set(json.loads(json.dumps(frozen.to_dict()))) == frozen
    assert frozen.task == (name.partition("-")[0] if name in TASK_SET_NAMES else "speed")
