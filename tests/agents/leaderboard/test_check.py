import json
from dataclasses import replace

import pytest

from agents.leaderboard import __main__ as leaderboard
from agents.leaderboard.page import END, START
from agents.leaderboard.rows import RESULTS
from baselines.evaluation import policies
from capsule_gym import Capsule, evaluation_sets
from tests.agents.fakes import write_run
from tests.agents.leaderboard.world import checked, edit_row, make_set, table


def test_written_results_pass_the_check(written):
    assert checked(written) == []
    assert not list(written.glob(".*")) and not list((written / RESULTS).glob(".*"))
    before, table = (written / "README.md").read_text().split(START)
    assert before == "# Title\n\nBefore.\n\n" and table.endswith(f"|\n{END}\n\nAfter.\n")


def test_check_names_changed_sets_before_any_work(written, monkeypatch):
    monkeypatch.setattr(leaderboard, "evaluate", lambda *args, **kwargs: pytest.fail("evaluated"))
    other = [make_set("paper", (0.5, 0.02)), make_set("new", (0.5, 0.01))]
    stale = checked(written, other)
    assert stale[0] == "adaptive: sets differs from its results"
    assert stale[-1] == "the numbers were not evaluated again"


def test_check_names_changed_rows(written):
    edit_row(written, "learnt", lambda row: row.header.update(revision="feed"))
    write_run(written / "checkpoints" / "learnt" / "seed-1", 1, clip=9.0)
    policies.SCRIPTED.pop("bold")
    (written / "checkpoints" / "README.md").unlink()
    gone, revision, changed, command, _ = checked(written)
    assert gone == "bold: has results and does not exist"
    assert (revision, changed) == tuple(f"learnt: {field} differs from its results" for field in ("revision", "files"))
    assert command == "learnt: the table in agents/checkpoints/README.md has no command that trains it"
    write_run(written / "checkpoints" / "fresh" / "seed-0", 0)
    assert "fresh: no results in fresh.npz; `python -m agents.leaderboard NAME` writes them" in checked(written)


@pytest.mark.parametrize("name", ["leaderboard.json", "LEADERBOARD.md", "README.md"])
def test_check_names_stale_pages(written, name):
    text = (written / name).read_text()
    (written / name).write_text(text.replace("wild", "mild", 1))
    assert checked(written, evaluated=[]) == [f"{name} differs from the results"]
    assert checked(written)[-1] == "the numbers were not evaluated again"


@pytest.mark.parametrize("name", ["learnt", "twitch"])
def test_check_compares_the_last_bit_of_every_episode(written, name):
    def nudge(row):
        row.scores["paper"][0, -1, 1] *= 1.0 + 2.0**-51

    edit_row(written, name, nudge)
    (stale,) = checked(written, evaluated=[policies.find_candidate(name)])
    assert stale.startswith(f"{name} on paper: mean_speed is ")
    seed = "training seed 1, " if name == "learnt" else ""
    assert stale.endswith(f" now ({seed}episode 1; 1 of {6 if name == 'learnt' else 3} differ)")
    assert checked(written, evaluated=[policies.find_candidate("bold")]) == []


def test_check_evaluates_the_first_plants_of_every_set_alone(written):
    def nudge(row):
        row.scores["paper"][0, -1, 1] *= 1.0 + 2.0**-51

    edit_row(written, "learnt", nudge)
    chosen = [policies.find_candidate("learnt")]
    assert checked(written, evaluated=chosen, plants=1) == []
    (stale,) = checked(written, evaluated=chosen, plants=2)
    assert stale.endswith("training seed 1, episode 1; 1 of 4 differ)")


def test_check_finds_another_plant(written, monkeypatch):
    monkeypatch.setitem(evaluation_sets.EPISODE_SETTINGS, "capsule", Capsule(l=0.3 * 1.02))
    stale = checked(written)
    for name in ("adaptive", "bold", "learnt"):
        assert any(line.startswith(f"{name} on paper: mean_speed is") for line in stale)


@pytest.fixture
def main(world, monkeypatch):
    """The command on a small set for each of two tasks."""
    monkeypatch.setattr(leaderboard, "SETS", ("paper", "goal"))
    of_task = {"paper": "speed", "goal": "goal"}
    monkeypatch.setattr(leaderboard, "load_set", lambda name: replace(make_set(name, (0.5, 0.2)), task=of_task[name]))
    evaluate = leaderboard.evaluate
    monkeypatch.setattr(leaderboard, "evaluate", lambda *args, **kwargs: evaluate(*args, **{**kwargs, "horizon": 0.1}))
    return lambda *words: leaderboard.main([*words, "--jobs", "1"], root=world)


def test_command_line(main, world, capsys):
    assert main("--check") == 1
    assert "The leaderboard is stale:\n- adaptive: no results" in capsys.readouterr().out
    assert main() == 0
    assert main("--check") == 0
    assert "up to date: 6 policies on 2 sets" in capsys.readouterr().out
    # Every task has a table of its own.
    page = (world / "LEADERBOARD.md").read_text()
    (_, _, stay) = table(page, "## Goal")
    assert stay[:4] == ["stay", "0.0000", "0.10", "0/1"] and "stay" not in [row[1] for row in table(page)]
    (row,) = json.loads((world / "leaderboard.json").read_text())["tasks"]["goal"]["rows"]
    assert row["results"]["goal"]["success"]["mean"] == 0.0
    (world / "LEADERBOARD.md").unlink()
    assert main("--check", "--from-results") == 1
    assert main("--from-results") == 0
    assert main("--check", "bold") == 0
    write_run(world / "checkpoints" / "learnt" / "seed-1", 1, clip=9.0)
    write_run(world / "checkpoints" / "fresh" / "seed-0", 0)
    contents = {path.name: path.read_bytes() for path in (world / RESULTS).iterdir()}
    assert main("learnt", "fresh", "bold") == 0
    # The results of an unchanged row keep their bytes.
    new = {path.name: path.read_bytes() for path in (world / RESULTS).iterdir()}
    assert {name for name in new if contents.get(name) != new[name]} == {"fresh.npz", "learnt.npz"}
    assert "|fresh|" in (world / "LEADERBOARD.md").read_text()


def test_finished_rows_survive_an_interruption(main, world, monkeypatch, capsys):
    evaluate = leaderboard.evaluate

    def interrupted(*args, **kwargs):
        yield next(evaluate(*args, **kwargs))
        raise KeyboardInterrupt

    monkeypatch.setattr(leaderboard, "evaluate", interrupted)
    assert main() == 130
    assert [path.name for path in (world / RESULTS).iterdir()] == ["adaptive.npz"]
    assert not (world / "LEADERBOARD.md").exists()
    assert "Stopped. The rows that were finished are kept" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--jobs", "0"], "--jobs"),
        (["--check", "--plants", "0"], "--plants"),
        (["--plants", "5"], "--plants"),
        (["--jobs", "two"], "--jobs"),
        (["lernt"], "names must be among adaptive, bold, wild, twitch, learnt, stay, got lernt"),
        (["bold", "--from-results"], "--from-results must be given without names, got bold"),
        (["bold"], "adaptive: no results in adaptive.npz; `python -m agents.leaderboard NAME` writes them"),
    ],
)
def test_wrong_options_are_named(main, words, message, world, capsys):
    with pytest.raises(SystemExit) as stop:
        leaderboard.main(words if "--jobs" in words else [*words, "--jobs", "1"], root=world)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
