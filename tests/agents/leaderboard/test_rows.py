import io
import zipfile

import numpy as np
import pytest

from agents.leaderboard.rows import evaluate, load_row, load_rows, save_row, static_header
from capsule_gym.evaluation import episodes
from capsule_gym.evaluation.candidates import find_candidate
from tests.agents.leaderboard.world import HORIZON, SETS, make_set


def test_a_row_holds_every_number_of_its_episodes_and_a_malformed_file_raises_an_error(world):
    (row,) = evaluate([find_candidate("learnt")], SETS, horizon=HORIZON)
    folder, path = world / "results", world / "results" / "learnt.npz"
    save_row(folder, row)
    found, whole = load_row(path), path.read_bytes()
    assert found.header == row.header and found.trained
    assert set(found.header["versions"]) >= {"capsule_gym", "python", "numpy"}
    for each in SETS:
        expected = episodes.evaluate("learnt", each, horizon=HORIZON)
        for episode in expected:
            del episode["distance"], episode["energy"]
        assert found.episodes(each) == expected
        assert found.score(each.name, "mean_speed").ravel().tolist() == [
            e["mean_speed"] for e in expected
        ]
    with pytest.raises(
        ValueError, match=f"learnt: the hash of the set paper is {SETS[1].hash} in its results and "
    ):
        found.episodes(make_set("paper", (0.5, 0.02)))
    array = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        array, {"descr": "<f8", "fortran_order": False, "shape": (2**50,)}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.npy", array.getvalue())
    for content in (path.read_bytes(), b"", b"PK", whole[:-40], whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"^learnt: learnt\.npz contains no results: "):
            load_row(path)
    row.header["training_seeds"] = [0]
    save_row(folder, row)
    with pytest.raises(ValueError, match="does not match its name or arrays"):
        load_row(path)
    path.unlink()
    with pytest.raises(ValueError, match=r"^learnt: no results in learnt\.npz"):
        load_rows(folder, ["learnt"])


def test_the_base_of_a_residual_is_the_policy_of_its_law():
    bases = {
        "adaptive": None,
        "residual-ppo": "adaptive",
        "residual-real": "gait-predictive",
        "direct-ppo": None,
    }
    assert {name: static_header(find_candidate(name))["base"] for name in bases} == bases


def test_processes_give_the_same_bits():
    # Spawned workers import everything anew.
    real = [find_candidate(name) for name in ("adaptive", "direct-ppo")]
    alone, shared = (list(evaluate(real, SETS, jobs=jobs, horizon=0.1)) for jobs in (1, 2))
    assert [row.name for row in alone] == ["adaptive", "direct-ppo"]
    for one, other in zip(alone, shared, strict=True):
        assert one.header == other.header
        assert all(
            values.tobytes() == other.scores[name].tobytes() for name, values in one.scores.items()
        )
