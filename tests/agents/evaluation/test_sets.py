import numpy as np
import pytest

from agents.evaluation import sets
from capsule_gym.evaluation_sets import TASK_SET_NAMES, load_set
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS, Capsule

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
    frozen, episodes = load_set(sets.SETS_FOLDER / f"{name}.json"), sets.EPISODES.get(name, 1000)
    assert (frozen.name, frozen.hash[:12], len(frozen.plants)) == (name, HASHES[name], episodes)
    assert frozen.task == (name.partition("-")[0] if name in TASK_SET_NAMES else "speed")


def test_the_plants_of_a_task_are_those_that_it_draws():
    for name in ("goal", "velocity"):
        plants = load_set(name).plants
        mus = [plant.mu for plant in plants]
        assert 0.05 <= min(mus) < 0.052 and 0.48 < max(mus) <= 0.5 and all(0.45 <= plant.M <= 0.55 for plant in plants)
    for name in ("goal", "goal-paper"):
        goals = [plant.goal for plant in load_set(name).plants]
        assert 0.05 <= min(map(abs, goals)) and max(map(abs, goals)) <= 0.5
        assert 400 < sum(goal > 0.0 for goal in goals) < 600
    on_paper = load_set("goal-paper")
    assert on_paper.capsule == NOMINAL and all(0.009 <= plant.mu <= 0.011 for plant in on_paper.plants)


def test_the_command_writes_the_committed_files(tmp_path, monkeypatch):
    committed = sets.SETS_FOLDER
    monkeypatch.setattr(sets, "SETS_FOLDER", tmp_path)
    assert sets.main([]) == 0
    for name in HASHES:
        assert (tmp_path / f"{name}.json").read_bytes() == (committed / f"{name}.json").read_bytes()


@pytest.mark.parametrize("name", ["paper", "wide", "sticky"])
def test_the_first_plants_of_a_set_cover_its_ranges_as_all_do(name):
    frozen, ranges = load_set(name), RANDOMIZATIONS[name]
    assert frozen.capsule == (Capsule(static_ratio=1.3) if name == "sticky" else None)
    scale = np.log if ranges.log_mu else np.asarray
    given = [[plant.M for plant in frozen.plants], scale([plant.mu for plant in frozen.plants])]
    plants = np.transpose(
        [np.interp(x, limits, (0, 1)) for x, limits in zip(given, (ranges.M, scale(ranges.mu)), strict=True)]
    )
    for count, cells in ((64, 5), (len(plants), 12)):
        filled = np.minimum(plants[:count] * cells, cells - 1).astype(int)
        assert len(np.unique(filled, axis=0)) == cells**2


def test_plants_of_extrapolation_lie_outside_of_wide_on_both_sides_alike():
    M, mu = np.array([(plant.M, plant.mu) for plant in load_set("extrapolation").plants]).T
    low, high = RANDOMIZATIONS["wide"].M, RANDOMIZATIONS["wide"].mu
    for values, (least, most), others in ((M, low, mu), (mu, high, M)):
        outside = np.array([np.sum(values < least), np.sum(values > most)])
        assert np.all(abs(outside - len(M) / 3) <= 6) and len(np.unique(others)) > 300
    assert np.all((M < low[0]) | (M > low[1]) | (mu < high[0]) | (mu > high[1]))
