"""The names of what comes with the package, and the files behind them."""

from __future__ import annotations

from pathlib import Path

import pytest

import baselines
from baselines.policies import SCRIPTED
from capsule_gym import policy as module
from capsule_gym.demo import driver_names, find_law, law_names
from capsule_gym.policy import POLICY, load_policy, policy_names, pretrained

# Of all committed files together.
SIZE_LIMIT = 2_000_000


def test_names_are_known_and_mean_the_first_seed():
    assert policy_names() == sorted(policy_names()) and {"direct-ppo", "residual-ppo", "robust"} < set(policy_names())
    assert {name.partition("/")[0] for name in policy_names(seeds=True)} == set(policy_names())
    for name in policy_names():
        first, named = load_policy(name), load_policy(f"{name}/seed-0")
        assert (first.name, first.training_seed) == (name, 0)
        assert first._network.tobytes() == named._network.tobytes()
    assert load_policy("residual-ppo/seed-2")._network.tobytes() != load_policy("residual-ppo")._network.tobytes()


def test_committed_policies_take_little_room():
    files = set(pretrained().values())
    assert len(files) == len(policy_names(seeds=True))
    assert 0 < sum(path.stat().st_size for path in files) < SIZE_LIMIT


def test_every_name_is_listed_and_drives():
    names = driver_names()
    assert {"zero", "adaptive", "gait-guarded", "direct-ppo"} <= set(names) and len(names) == len(set(names))


def test_laws_have_the_names_of_the_leaderboard_and_drive_by_their_own_too():
    assert set(law_names()) < set(SCRIPTED)
    assert find_law("gait-guarded") == find_law("gait") == find_law("baselines:gait") == "baselines:gait"
    assert {find_law(name) for name in law_names()} == {find_law(name) for name in baselines.__all__}
    assert None not in map(find_law, baselines.__all__)


def test_a_law_that_is_not_on_the_leaderboard_has_its_own_name(monkeypatch):
    monkeypatch.setattr(baselines, "__all__", [*baselines.__all__, "of_mine"])
    assert law_names()[-1] == "of_mine" and find_law("of_mine") == "baselines:of_mine"


@pytest.mark.parametrize("name", ["random", "gait-nominal", "gait-oracle", "optimum-nominal", "zero", "direct-ppo", ""])
def test_what_is_no_law_is_not_found_as_one(name):
    assert find_law(name) is None


@pytest.mark.parametrize(
    "name", ["residual-ppo/../direct-ppo", "residual-ppo/seed-0/..", "residual-ppo/seed-00", ".", "", "seed-0"]
)
def test_no_name_leads_out_of_the_policies_folder_or_to_another_file(name):
    assert "residual-ppo/seed-0" in pretrained()
    assert name not in pretrained()


def found_in(folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """What is found in a folder of policies: the names, and the paths of the files within it."""
    monkeypatch.setattr(module, "FOLDERS", (folder.with_name("nowhere"), folder))
    # Around the cache, which keeps what the package holds.
    return {name: file.relative_to(folder).as_posix() for name, file in pretrained.__wrapped__().items()}


def test_runs_are_counted_by_number_and_other_folders_are_none(tmp_path, monkeypatch):
    for place in ("b/seed-10", "b/seed-9", "a/seed-2", "a/best", "a/seed-x", "a/seed-1/best", "c/seed--1"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / POLICY).touch()
    (tmp_path / "d" / "seed-0").mkdir(parents=True)
    assert found_in(tmp_path, monkeypatch) == {
        "a": f"a/seed-2/{POLICY}",
        "a/seed-2": f"a/seed-2/{POLICY}",
        "b": f"b/seed-9/{POLICY}",
        "b/seed-9": f"b/seed-9/{POLICY}",
        "b/seed-10": f"b/seed-10/{POLICY}",
    }


def test_without_a_folder_there_are_no_policies(tmp_path, monkeypatch):
    assert found_in(tmp_path / "missing", monkeypatch) == {}
