import pytest

from agents.evaluation import episodes, policies
from agents.leaderboard import check as module
from agents.leaderboard.page import END, START
from agents.leaderboard.rows import RESULTS
from capsule_gym import Capsule
from tests.agents.fakes import write_run
from tests.agents.leaderboard.world import SETS, checked, edit, edit_row, make_set, row_of, table


def test_what_is_written_passes_the_check(written):
    assert checked(written) == []
    assert not list(written.glob(".*")) and not list((written / RESULTS).glob(".*"))
    readme = (written / "README.md").read_text()
    assert readme.startswith(f"# Title\n\nBefore.\n\n{START}\n| policy ")
    assert table(readme)[0][0] == "policy"
    assert readme.endswith(f"|\n{END}\n\nAfter.\n")


def test_check_says_when_there_is_none(world):
    assert checked(world) == ["adaptive: has no results, expected in adaptive.npz"]


def test_check_names_what_is_no_leaderboard(written):
    for text in ("{", "[]", '{"sets": {}, "versions": {}, "rows": [{}]}'):
        (written / "leaderboard.json").write_text(text)
        stale, last = checked(written)
        assert stale.startswith("leaderboard.json is malformed: ")
        assert last == "the numbers were not evaluated again"
    (written / "leaderboard.json").unlink()
    assert checked(written)[0] == "leaderboard.json is missing"


def test_check_names_changed_sets_before_any_work(written, monkeypatch):
    monkeypatch.setattr(module, "evaluate", lambda *args, **kwargs: pytest.fail("evaluated"))
    other = [make_set("paper", (0.5, 0.02)), make_set("new", (0.5, 0.01))]
    stale = checked(written, other)
    assert stale[0] == f"adaptive: the hash of the set paper is {SETS[1].hash} in its results and {other[0].hash} now"
    assert stale[1].startswith("adaptive: the hash of the set new is None")
    assert stale[2] == "adaptive: the set nominal is in its results and does not exist"
    assert stale[-1] == "the numbers were not evaluated again"


def test_check_names_changed_rows(written):
    write_run(written / "checkpoints" / "learnt" / "seed-1", 1, clip=9.0)
    policies.SCRIPTED.pop("bold")
    (written / "checkpoints" / "README.md").unlink()
    assert checked(written)[:-1] == [
        "bold: has results and does not exist",
        "learnt: files have changed: seed-1/policy.safetensors",
        "learnt: the table in agents/checkpoints/README.md has no command that trains it",
    ]
    write_run(written / "checkpoints" / "fresh" / "seed-0", 0)
    assert checked(written) == ["fresh: has no results, expected in fresh.npz"]


def test_check_names_changed_revisions_and_seeds(written):
    edit_row(written, "learnt", lambda row: row.header.update(revision="feed"))
    (written / "checkpoints" / "learnt" / "seed-0").rename(written / "gone")
    stale = checked(written)
    assert "learnt: training_seeds is [0, 1] in its results and [1] now" in stale
    assert "learnt: revision is 'feed' in its results and '0123456789ab' now" in stale


def test_check_names_stale_pages(written):
    with (written / "LEADERBOARD.md").open("a") as file:
        file.write("mine is better\n")
    readme = written / "README.md"
    readme.write_text(readme.read_text().replace("| policy ", "| polity "))
    assert checked(written)[:-1] == [
        "LEADERBOARD.md is not what the results give",
        "README.md: the leaderboard's head is not what the results give",
    ]
    assert checked(written, evaluated=[])[-1] == "README.md: the leaderboard's head is not what the results give"


@pytest.mark.parametrize("name", ["bold", "learnt", "twitch"])
def test_check_compares_the_last_bit_of_every_episode(written, name):
    def nudge(row):
        row.scores["paper"][0, -1, 1] *= 1.0 + 2.0**-51

    edit_row(written, name, nudge)
    (stale,) = checked(written)
    assert stale.startswith(f"{name} on paper: mean_speed is ")
    seed = "training seed 1, " if name == "learnt" else ""
    assert stale.endswith(f" now ({seed}episode 1; 1 of {6 if name == 'learnt' else 3} differ)")
    others = [each for each in policies.all_candidates() if each.name != name]
    assert checked(written, evaluated=others) == []


def test_check_compares_what_noise_does(written):
    edit_row(written, "twitch", lambda row: row.header["disturbed"].update(high=9.0))
    (stale,) = checked(written)
    assert stale.startswith("twitch disturbed: high is 9.0 in its results and ")


def test_check_names_results_of_other_shapes(written):
    def cut(row):
        row.scores["paper"] = row.scores["paper"][:, :, :2]

    with pytest.raises(ValueError, match="bold: its results hold 2 episodes of the set paper, which has 3"):
        edit_row(written, "bold", cut)
    assert checked(written)[0] == "bold: its results hold 2 episodes of the set paper, which has 3"


def test_check_compares_the_leaderboard_with_the_results(written):
    def change(board):
        row = row_of(board, "bold")["results"]["paper"]
        row["mean_speed"]["iqm"] *= 1.0 + 3e-6
        row["failures"] = 1
        row["stray"] = None
        row.pop("rms_torque")
        row_of(board, "adaptive")["results"]["paper"]["mean_speed"]["low"] = None
        row_of(board, "twitch").pop("disturbed")

    edit(written, change)
    starts = {line.partition(" in leaderboard.json and ")[0].partition(" is ")[0] for line in checked(written)[:-1]}
    assert starts == {
        "bold: results paper mean_speed iqm",
        "bold: results paper failures",
        "bold: results paper stray",
        *(f"bold: results paper rms_torque {end}" for end in ("iqm", "low", "high")),
        "adaptive: results paper mean_speed low",
        *(f"twitch: disturbed {end}" for end in ("low", "high")),
    }


def test_check_compares_the_leaderboards_sets(written):
    edit(written, lambda board: board.update(sets={}))
    assert checked(written)[0] == "leaderboard.json is not what the results give"


def test_another_plant_is_found_out(written, monkeypatch):
    monkeypatch.setitem(episodes.EPISODE_SETTINGS, "capsule", Capsule(l=0.3 * 1.02))
    stale = checked(written)
    for name in ("adaptive", "bold", "learnt"):
        assert any(line.startswith(f"{name} on paper: mean_speed is") for line in stale)
