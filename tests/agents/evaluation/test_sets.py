import pytest

from agents.evaluation import sets
from capsule_gym.evaluation_sets import SET_NAMES, load_set

# The sets are frozen: a changed hash makes every published result incomparable. Add a set under a new name instead.
HASHES = {
    "nominal": "175e0d05f0d7",
    "paper": "b735055ceff1",
    "wide": "4eb52be12a6e",
    "extrapolation": "37f72254b16c",
    "drift": "a64a8c831746",
}


@pytest.mark.parametrize("name", SET_NAMES)
def test_committed_sets_are_frozen(name):
    frozen = load_set(name)
    assert (frozen.name, frozen.hash[:12], len(frozen.plants)) == (name, HASHES[name], 100)


def test_the_command_writes_the_committed_files(tmp_path, monkeypatch):
    committed = sets.SETS_FOLDER
    monkeypatch.setattr(sets, "SETS_FOLDER", tmp_path)
    assert sets.main([]) == 0
    for name in SET_NAMES:
        assert (tmp_path / f"{name}.json").read_bytes() == (committed / f"{name}.json").read_bytes()
