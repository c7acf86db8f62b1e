import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from agents.leaderboard.rows import evaluate, load_row, load_rows, save_row, static_header
from capsule_gym.evaluation import episodes
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.policies.policy import POLICY
from tests.agents.leaderboard.world import HORIZON, PAPER, SETS, make_set


@pytest.fixture
def row(world):
    (found,) = evaluate([find_candidate("learnt")], SETS, horizon=HORIZON)
    return found


@pytest.fixture
def path(row, tmp_path):
    """The row's file."""
    save_row(tmp_path / "results", row)
    return tmp_path / "results" / "learnt.npz"


def test_a_file_holds_the_header_of_a_row(path, row):
    found = load_row(path)
    assert found.header == row.header
    assert found.trained
    assert set(found.header["versions"]) >= {"capsule_gym", "python", "numpy"}


def test_a_file_does_not_depend_on_the_byte_order(path, row, tmp_path):
    swapped = {name: values.astype(">f8") for name, values in row.scores.items()}
    save_row(tmp_path, replace(row, scores=swapped))
    assert (tmp_path / path.name).read_bytes() == path.read_bytes()


@pytest.mark.parametrize("evaluation_set", SETS, ids=lambda each: each.name)
def test_a_file_holds_every_number_of_its_episodes(path, evaluation_set):
    found = load_row(path)
    expected = episodes.evaluate("learnt", evaluation_set, horizon=HORIZON)
    for episode in expected:
        del episode["distance"], episode["energy"]
    assert found.episodes(evaluation_set) == expected
    speeds = found.score(evaluation_set.name, "mean_speed").ravel().tolist()
    assert speeds == [episode["mean_speed"] for episode in expected]


def test_episodes_of_another_set_raise_an_error(row):
    message = f"learnt: the hash of the set paper is {PAPER.hash} in its results and "
    with pytest.raises(ValueError, match=message):
        row.episodes(make_set("paper", (0.5, 0.02)))


def huge_array():
    """An archive whose array would take 8 PiB."""
    array = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (2**50,)}
    np.lib.format.write_array_header_1_0(array, header)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("header.npy", array.getvalue())
    return content.getvalue()


DAMAGES = {
    "huge": lambda whole: huge_array(),
    "empty": lambda whole: b"",
    "only a magic number": lambda whole: b"PK",
    "without its end": lambda whole: whole[:-40],
    "half": lambda whole: whole[: len(whole) // 2],
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_malformed_file_raises_an_error(path, damage):
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(ValueError, match=r"^learnt: learnt\.npz contains no results: "):
        load_row(path)


def test_a_header_that_does_not_match_its_arrays_raises_an_error(path, row):
    row.header["training_seeds"] = [0]
    save_row(path.parent, row)
    with pytest.raises(ValueError, match="does not match its name or arrays"):
        load_row(path)


def test_an_array_that_does_not_match_the_header_raises_an_error(path, row):
    row.scores["real"] = row.scores["real"][:, :1]
    save_row(path.parent, row)
    with pytest.raises(ValueError, match="does not match its name or arrays"):
        load_row(path)


def test_a_missing_file_raises_an_error(tmp_path):
    with pytest.raises(ValueError, match=r"^learnt: no results in learnt\.npz"):
        load_rows(tmp_path, ["learnt"])


def test_a_header_names_the_files_and_revisions_of_a_trained_policy():
    candidate = find_candidate("direct-ppo")
    header = static_header(candidate)
    seeds = sorted(map(str, header["training_seeds"]))
    assert list(header["files"]) == [f"seed-{seed}/{POLICY}" for seed in seeds]
    assert header["revision"] == candidate.policies[0].revision


def test_a_scripted_policy_has_no_files_and_no_revision():
    header = static_header(find_candidate("adaptive"))
    assert (header["files"], header["revision"], header["training_seeds"]) == ({}, None, [])


@pytest.mark.parametrize(
    ("name", "base"),
    [
        ("adaptive", None),
        ("residual-ppo", "adaptive"),
        ("residual-real", "gait-predictive"),
        ("direct-ppo", None),
    ],
)
def test_the_base_of_a_residual_is_the_policy_of_its_law(name, base):
    assert static_header(find_candidate(name))["base"] == base


def test_no_bar_is_shown_unless_standard_error_is_a_terminal(world, capsys):
    assert list(evaluate([find_candidate("adaptive")], SETS, horizon=0.1))
    assert capsys.readouterr().err == ""


def test_processes_give_the_same_bits():
    # Spawned workers import everything anew.
    real = [find_candidate(name) for name in ("adaptive", "direct-ppo")]
    alone, shared = (list(evaluate(real, SETS, jobs=jobs, horizon=0.1)) for jobs in (1, 2))
    assert [row.name for row in alone] == ["adaptive", "direct-ppo"]
    for one, other in zip(alone, shared, strict=True):
        assert one.header == other.header
        for name, values in one.scores.items():
            assert values.tobytes() == other.scores[name].tobytes()
