import numpy as np
import pytest

from agents.evaluation.episodes import evaluate as evaluate_policy
from agents.evaluation.policies import find_candidate
from agents.leaderboard.board import evaluate
from agents.leaderboard.rows import COLUMNS, load_row, load_rows, path_of, save_row
from tests.agents.leaderboard.world import HORIZON, SETS, make_set


@pytest.fixture
def row(world):
    (row,) = evaluate([find_candidate("learnt")], SETS, horizon=HORIZON)
    return row


def test_a_row_holds_every_number_of_its_episodes(row, world):
    assert save_row(world / "results", row)
    found = load_row(path_of(world / "results", "learnt"))
    assert found.same_as(row) and found.trained
    assert set(found.header["versions"]) >= {"capsule_gym", "python", "numpy"}
    for each in SETS:
        episodes = evaluate_policy("learnt", each, horizon=HORIZON)
        again = found.episodes(each)
        assert all(set(old) - set(new) == {"distance", "energy"} for old, new in zip(episodes, again, strict=True))
        assert all(old[name] == value for old, new in zip(episodes, again, strict=True) for name, value in new.items())
        assert found.score(each.name, "mean_speed").ravel().tolist() == [e["mean_speed"] for e in episodes]


def test_the_same_row_gives_the_same_bytes_and_is_not_written_again(row, world):
    folder = world / "results"
    save_row(folder, row)
    path = path_of(folder, "learnt")
    before = path.read_bytes()
    assert not save_row(folder, row)
    path.unlink()
    assert save_row(folder, row) and path.read_bytes() == before
    path.write_bytes(b"broken")
    assert save_row(folder, row) and path.read_bytes() == before


def test_another_set_of_the_same_name_is_refused(row):
    with pytest.raises(ValueError, match=f"learnt: the hash of the set paper is {SETS[1].hash} in its results and "):
        row.episodes(make_set("paper", (0.5, 0.02)))


def test_what_holds_no_results_is_named(row, world):
    folder = world / "results"
    save_row(folder, row)
    path = path_of(folder, "learnt")
    whole = path.read_bytes()
    for content in (b"", b"PK", whole[:-40], whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"^learnt: learnt\.npz holds no results: "):
            load_row(path)
    for arrays in ({}, {"header": np.frombuffer(b"[]", np.uint8)}, {"header": np.frombuffer(b"{}", np.uint8)}):
        np.savez_compressed(path, **arrays)
        with pytest.raises(ValueError, match="holds no results"):
            load_row(path)
    path.write_bytes(whole)
    path.rename(folder / "other.npz")
    with pytest.raises(ValueError, match="does not fit its name"):
        load_row(folder / "other.npz")
    with pytest.raises(ValueError, match=r"^learnt: has no results, expected in learnt\.npz"):
        load_rows(folder, ["learnt"])


def test_columns_are_metrics_that_do_not_follow_from_others():
    assert {"mean_speed", "cost_of_transport", "failed"} <= set(COLUMNS)
    assert not {"distance", "energy"} & set(COLUMNS)
