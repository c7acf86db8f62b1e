from dataclasses import replace

import pytest

from agents.leaderboard import __main__ as leaderboard
from agents.leaderboard import candidates as scripted
from agents.leaderboard.candidates import all_candidates
from agents.leaderboard.chart import CHART
from agents.leaderboard.page import MAIN_SETS, TABLES
from agents.leaderboard.rows import RESULTS
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.evaluation.sets import load_set
from tests.agents.fakes import write_run
from tests.agents.leaderboard.world import checked, edit_row, evaluated_again, make_set, table

WRONG = {
    "--check --plants 0": "--plants",
    "--plants 5": "--plants",
    "lernt": "got lernt; did you mean 'learnt'?",
}
WRONG["pd --from-results"] = "--from-results must be given without names, got 'pd'"
WRONG["pd"] = (
    "adaptive: no results in adaptive.npz; `python -m agents.leaderboard NAME` writes them"
)


def test_written_results_pass_the_check_and_the_chart_is_stale_if_a_drawn_number_changes(written):
    assert checked(written) == [] and evaluated_again(written, *all_candidates()) == []
    assert not list(written.glob(".*")) and not list((written / RESULTS).glob(".*"))
    readme = (written / "README.md").read_text()
    assert (
        readme.startswith("# Title\n\n<!--")
        and readme.count("\n\nBetween.\n\n") == 1
        and "Torque as a" in readme
    )
    before = (written / CHART).read_text()
    edit_row(written, "pd", lambda row: row.scores["real"][0].fill(1.0))
    (written / CHART).write_text(before)
    assert checked(written) == [f"{CHART} differs from the results"]


def test_the_published_pages_and_the_first_episodes_of_policies_are_those_of_the_results():
    names = [
        "adaptive",
        "lqr",
        "pd",
        "oscillator",
        "gait-guarded",
        "gait-predictive",
        "goal-pulses",
        "velocity-pulses",
    ]
    names += ["dp-oracle", "dp-nominal", "direct-ppo"]
    sets = [load_set(name) for name in leaderboard.SETS]
    candidates = {each.name: each for task in leaderboard.TASKS for each in all_candidates(task)}
    assert list(leaderboard.find_stale(leaderboard.ROOT, list(candidates.values()), sets)) == []
    firsts = [replace(each, plants=each.plants[:1]) for each in sets]
    slow = ("mpc", "adaptive-as-published", "feedback-linearising", "open-loop")
    for chosen, own in ((names, firsts), (slow, firsts[:1])):
        rows = leaderboard.evaluate([candidates[name] for name in chosen], own)
        assert list(leaderboard.check_episodes(leaderboard.ROOT, rows)) == []


def test_check_names_changed_rows(written):
    edit_row(written, "learnt", lambda row: row.header.update(revision="feed"))
    write_run(written / "checkpoints" / "learnt" / "seed-1", 1, clip=9.0)
    scripted.SCRIPTED.pop("rocking")
    gone, revision, changed, *pages = checked(written)
    assert gone == "rocking: has results and does not exist"
    assert (revision, changed) == tuple(
        f"learnt: {field} differs from its results" for field in ("revision", "files")
    )
    assert all(line.endswith(" differs from the results") for line in pages)
    write_run(written / "checkpoints" / "fresh" / "seed-0", 0)
    with pytest.raises(
        ValueError, match=r"fresh: no results in fresh\.npz; `python -m agents\.leaderboard NAME`"
    ):
        checked(written)


@pytest.mark.parametrize("name", ["leaderboard.json", "LEADERBOARD.md", "README.md", TABLES, CHART])
def test_check_names_stale_pages(written, name):
    text = (written / name).read_text()
    (written / name).write_text("" if name == CHART else text.replace("adaptive", "?", 1))
    assert checked(written) == [f"{name} differs from the results"]
    (written / name).write_text(text)
    assert checked(written) == []


@pytest.mark.parametrize("name", ["learnt", "rocking"])
def test_check_compares_the_last_bit_of_every_episode(written, name):
    def nudge(row):
        row.scores["paper"][0, -1, 1] *= 1.0 + 2.0**-51

    edit_row(written, name, nudge)
    (stale,) = evaluated_again(written, find_candidate(name))
    assert stale.startswith(f"{name} on paper: mean_speed is ")
    seed = "training seed 1, " if name == "learnt" else ""
    assert (
        f" now ({seed}episode 1; 1 of " in stale
        and evaluated_again(written, find_candidate("pd")) == []
    )
    # The first plants of every set alone, without and with the episode that differs.
    assert [len(evaluated_again(written, find_candidate(name), plants=n)) for n in (1, 2)] == [0, 1]


@pytest.fixture
def main(world, monkeypatch):
    """The command on small sets for two tasks."""
    monkeypatch.setattr(leaderboard, "SETS", ("nominal", *MAIN_SETS, "goal"))

    def load(name):
        return replace(make_set(name, (0.5, 0.01)), task="goal" if name == "goal" else "speed")

    monkeypatch.setattr(leaderboard, "load_set", load)
    evaluate = leaderboard.evaluate
    monkeypatch.setattr(
        leaderboard,
        "evaluate",
        lambda *args, **kwargs: evaluate(*args, **{**kwargs, "horizon": 0.4}),
    )
    monkeypatch.setattr(leaderboard, "ROOT", world)
    return lambda *words: leaderboard.main([*words, "--jobs", "1"])


def test_command_line(main, world, capsys, refused):
    assert "adaptive: no results" in refused(main, "--check") and main() == main("--check") == 0
    assert "The leaderboard is up to date." in capsys.readouterr().out
    # Every task has a table of its own, on another page.
    (_, _, stay) = table((world / TABLES).read_text(), "start:goal]")
    assert stay[0] == "stay" and "stay" not in (world / "LEADERBOARD.md").read_text()
    (world / "LEADERBOARD.md").unlink()
    assert main("--check", "--from-results") == 1
    assert "- LEADERBOARD.md differs from the results" in capsys.readouterr().out
    assert main("--from-results") == main("--check", "pd") == 0
    write_run(world / "checkpoints" / "learnt" / "seed-1", 1, clip=9.0)
    write_run(world / "checkpoints" / "fresh" / "seed-0", 0)
    contents = {path.name: path.read_bytes() for path in (world / RESULTS).iterdir()}
    assert main("learnt", "fresh", "pd") == 0
    # The results of an unchanged row keep their bytes.
    new = {path.name: path.read_bytes() for path in (world / RESULTS).iterdir()}
    assert {name for name in new if contents.get(name) != new[name]} == {"fresh.npz", "learnt.npz"}
    assert "|fresh|" in (world / "LEADERBOARD.md").read_text()


def test_uncommitted_training_code_raises_an_error(main, world, refused):
    assert main() == 0
    write_run(world / "checkpoints" / "dirty" / "seed-3", 3, revision="0123456789ab+")
    for words in ([], ["dirty"]):
        assert "dirty/seed-3: the revision 0123456789ab+ is not committed" in refused(main, *words)
    assert not (world / RESULTS / "dirty.npz").exists()
    assert "dirty: no results" in refused(main, "--check")


def test_finished_rows_survive_an_interruption(main, world, monkeypatch, capsys):
    evaluate = leaderboard.evaluate

    def interrupted(*args, **kwargs):
        yield next(evaluate(*args, **kwargs))
        raise KeyboardInterrupt

    monkeypatch.setattr(leaderboard, "evaluate", interrupted)
    assert main() == 130 and [path.name for path in (world / RESULTS).iterdir()] == ["adaptive.npz"]
    assert not (world / "LEADERBOARD.md").exists()
    assert "Stopped. The rows that were finished are kept" in capsys.readouterr().out


@pytest.mark.parametrize(("words", "message"), WRONG.items())
def test_wrong_options_are_named(main, words, message, refused):
    assert message in refused(main, *words.split())
