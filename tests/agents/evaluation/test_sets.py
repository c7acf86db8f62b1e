import pytest

from capsule_gym.evaluation_sets import FOLDERS, TASK_SET_NAMES, load_set

# The sets are frozen: a changed hash makes every published result incomparable. Add a set under a new name instead.
HASHES = {
    "nominal": "175e0d05f0d7",
    "paper": "0c2b967613ff",
    "wide": "320467521a65",
    "extrapolation": "d16be15d7b3e",
    "drift": "f5da17a7f7a4",
    "sticky": "424bf16c03a5",
    "sticky-2": "b790fab4e287",
    "sticky-3": "d1c2c4de4dcc",
    "real": "0a0741ffbe6c",
    "real-wide": "9d6480404fd7",
    "goal": "fc320f20332b",
    "goal-paper": "5e10e2b674c7",
    "velocity": "a8ff944552c4",
}


@pytest.mark.parametrize("name", HASHES)
def test_committed_sets_are_frozen(name):
    frozen = load_set(FOLDERS[-1] / f"{name}.json")
    assert (frozen.name, frozen.hash[:12]) == (name, HASHES[name])
    assert frozen.task == (name.partition("-")[0] if name in TASK_SET_NAMES else "speed")
