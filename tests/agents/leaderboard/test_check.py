import pytest

from agents.evaluation import candidates, episodes
from agents.leaderboard import check as module
from agents.leaderboard.page import END, START
from capsule_gym import Capsule
from tests.agents.fakes import write_run
from tests.agents.leaderboard.world import SETS, checked, edit, make_set, row_of, table


def nudge(name, factor, metric="mean_speed"):
    """A change of a recorded number on the set `paper`."""

    def change(board):
        row_of(board, name)["results"]["paper"][metric]["iqm"] *= factor

    return change


def test_what_is_written_passes_the_check(written):
    assert checked(written) == []
    assert not list(written.glob(".*"))
    readme = (written / "README.md").read_text()
    assert readme.startswith(f"# Title\n\nBefore.\n\n{START}\n| policy ")
    assert table(readme)[0][0] == "policy"
    assert readme.endswith(f"|\n{END}\n\nAfter.\n")


def test_check_says_when_there_is_none(world):
    assert checked(world) == ["leaderboard.json is missing"]
    for text in ("{", "[]", '{"sets": {}, "versions": {}, "rows": [{}]}'):
        (world / "leaderboard.json").write_text(text)
        (stale,) = checked(world)
        assert stale.startswith("leaderboard.json is malformed: ")


def test_check_names_changed_sets_before_any_work(written, monkeypatch):
    monkeypatch.setattr(module, "build", lambda *args, **kwargs: pytest.fail("evaluated"))
    other = [SETS[0], make_set("paper", (0.5, 0.02)), make_set("new", (0.5, 0.01))]
    stale = checked(written, other)
    assert stale[0] == f"set paper: hash is {SETS[1].hash} in leaderboard.json and {other[1].hash} now"
    assert stale[1].startswith("set new: hash is None")
    assert stale[-1] == "the numbers were not evaluated again"


def test_check_names_changed_rows(written):
    write_run(written / "checkpoints" / "learnt" / "seed-1", 1, clip=9.0)
    write_run(written / "checkpoints" / "fresh" / "seed-0", 0)
    candidates.SCRIPTED["newcomer"] = candidates.SCRIPTED.pop("bold")
    assert checked(written)[:-1] == [
        "bold: is in leaderboard.json and does not exist",
        "newcomer: exists and is not in leaderboard.json",
        "fresh: exists and is not in leaderboard.json",
        "learnt: files have changed: seed-1/policy.safetensors",
    ]


def test_check_names_changed_revisions_and_seeds(written):
    (written / "checkpoints" / "learnt" / "seed-0").rename(written / "gone")
    edit(written, lambda board: row_of(board, "learnt").update(revision="feed"))
    stale = checked(written)
    assert "learnt: training_seeds is [0, 1] in leaderboard.json and [1] now" in stale
    assert "learnt: revision is 'feed' in leaderboard.json and '0123456789ab' now" in stale


def test_check_names_stale_pages(written):
    with (written / "LEADERBOARD.md").open("a") as file:
        file.write("mine is better\n")
    readme = written / "README.md"
    readme.write_text(readme.read_text().replace("| policy ", "| polity "))
    assert checked(written)[:-1] == [
        "LEADERBOARD.md is not what leaderboard.json renders to",
        "README.md: the leaderboard's head is not what leaderboard.json renders to",
    ]


@pytest.mark.parametrize("name", ["bold", "learnt", "twitch"])
def test_check_compares_numbers_to_the_last_of_their_digits(written, name):
    edit(written, nudge(name, 1.0 + 3e-6))
    (stale,) = checked(written)
    assert stale.startswith(f"{name} on paper: mean_speed iqm is ")


def test_check_compares_shares_and_what_noise_does(written):
    def change(board):
        row_of(board, "bold")["results"]["paper"]["share_of_optimum"]["iqm"] *= 1.01
        row_of(board, "twitch")["disturbed"]["high"] += 0.01

    edit(written, change)
    starts = {line.partition(" is ")[0] for line in checked(written)}
    assert starts == {"bold on paper: share_of_optimum iqm", "twitch disturbed: high"}


def test_check_compares_counts_and_undefined_numbers(written):
    def change(board):
        row_of(board, "bold")["results"]["paper"]["failures"] = 1
        row_of(board, "bold")["results"]["paper"]["stray"] = None
        row_of(board, "adaptive")["results"]["paper"]["mean_speed"]["low"] = None

    edit(written, change)
    found = checked(written)
    assert sorted(line.partition(" and ")[0] for line in found) == [
        "adaptive on paper: mean_speed low is None in leaderboard.json",
        "bold on paper: failures is 1 in leaderboard.json",
        "bold on paper: stray is None in leaderboard.json",
    ]
    edit(written, lambda board: row_of(board, "bold")["results"]["paper"].pop("rms_torque"))
    assert any(line.startswith("bold on paper: rms_torque iqm is 'absent' in") for line in checked(written))
    edit(written, lambda board: row_of(board, "bold").pop("disturbed"), pages=False)
    assert checked(written) == ["leaderboard.json is malformed: KeyError: 'disturbed'"]


def test_another_plant_is_found_out(written, monkeypatch):
    monkeypatch.setitem(episodes.EPISODE_SETTINGS, "capsule", Capsule(l=0.3 * 1.02))
    stale = checked(written)
    for name in ("adaptive", "bold", "learnt"):
        assert any(line.startswith(f"{name} on paper: mean_speed iqm") for line in stale)
