import numpy as np
import pytest

from agents.evaluation import episodes
from agents.evaluation.policies import find_candidate
from agents.leaderboard.rows import (
    COLUMNS,
    NOISE,
    disturbed_range,
    evaluate,
    load_row,
    load_rows,
    path_of,
    save_row,
    static_header,
    with_noise,
)
from tests.agents.fakes import Sine
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
        expected = episodes.evaluate("learnt", each, horizon=HORIZON)
        for episode in expected:
            del episode["distance"], episode["energy"]
        assert found.episodes(each) == expected
        assert found.score(each.name, "mean_speed").ravel().tolist() == [e["mean_speed"] for e in expected]
    with pytest.raises(ValueError, match=f"learnt: the hash of the set paper is {SETS[1].hash} in its results and "):
        found.episodes(make_set("paper", (0.5, 0.02)))


def test_the_same_row_gives_the_same_bytes_and_is_not_written_again(row, world):
    folder = world / "results"
    save_row(folder, row)
    path = path_of(folder, "learnt")
    before = path.read_bytes()
    assert not save_row(folder, row)
    path.write_bytes(b"broken")
    assert save_row(folder, row) and path.read_bytes() == before
    row.scores["paper"][0, 0, 0] *= 1.0 + 2.0**-51
    assert save_row(folder, row) and path.read_bytes() != before


def test_malformed_files_raise_an_error(row, world):
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
    for change in ({"policy": "other"}, {"metrics": ["mean_speed"]}, {"training_seeds": [0]}):
        header = row.header | change
        row.header.update(header, policy="learnt")
        path.write_bytes(whole)
        path.rename(folder / "other.npz")
        with pytest.raises(ValueError, match="does not fit its name"):
            load_row(folder / "other.npz")
    with pytest.raises(ValueError, match=r"^learnt: has no results, expected in learnt\.npz"):
        load_rows(folder, ["learnt"])


def test_columns_are_metrics_that_do_not_follow_from_others():
    assert {"mean_speed", "cost_of_transport", "failed"} <= set(COLUMNS)
    assert not {"distance", "energy"} & set(COLUMNS)


def test_the_base_of_a_residual_is_the_policy_of_its_law():
    names = ("adaptive", "residual-ppo", "residual-on-gait", "robust", "direct-ppo")
    bases = {each.name: static_header(each)["base"] for each in map(find_candidate, names)}
    assert bases == {
        "adaptive": None,
        "residual-ppo": "adaptive",
        "residual-on-gait": "gait-guarded",
        "robust": "gait-identifying",
        "direct-ppo": None,
    }


def test_processes_give_the_same_bits():
    # Spawned workers import everything anew.
    real = [find_candidate(name) for name in ("zero", "direct-sac")]
    alone, shared = (list(evaluate(real, SETS, jobs=jobs, horizon=0.1)) for jobs in (1, 2))
    assert [row.name for row in alone] == ["zero", "direct-sac"]
    assert all(one.same_as(other) for one, other in zip(alone, shared, strict=True))


def test_noise_is_a_ten_millionth_of_full_action():
    policy, seeds, observations = Sine(1.0), list(range(1000)), np.zeros((1000, 5), np.float32)
    noisy = with_noise(policy, 3)
    assert (noisy.name, noisy.env_kwargs) == (policy.name, policy.env_kwargs)
    quiet, first, same, other = (p.start(seeds) for p in (policy, noisy, noisy, with_noise(policy, 4)))
    for _ in range(9):
        actions, found = quiet(observations), first(observations)
        assert found.dtype == np.float32
        assert found.tobytes() == same(observations).tobytes() != other(observations).tobytes()
        # Rounding to float32 adds to it.
        assert 0.5 * NOISE < np.abs(found - actions).max() < 2.0 * NOISE
    noise = with_noise(Sine(0.0), 0).start(seeds)(observations)
    assert 0.99 * NOISE < np.abs(noise).max() <= NOISE
    assert noise.std() == pytest.approx(NOISE / np.sqrt(3.0), rel=0.05)


@pytest.mark.usefixtures("world")
def test_chaotic_policies_have_wide_ranges():
    stable, chaotic = (disturbed_range(find_candidate(name), HORIZON) for name in ("bold", "twitch"))
    assert disturbed_range(find_candidate("twitch"), HORIZON) == chaotic
    assert 0.0 < stable["high"] - stable["low"] < 1e-5
    assert chaotic["high"] - chaotic["low"] > 0.1
