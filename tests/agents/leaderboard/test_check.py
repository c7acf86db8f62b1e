import shutil
import zipfile
from dataclasses import replace
from functools import partial

import pytest

from agents.leaderboard import __main__ as leaderboard
from agents.leaderboard import candidates as scripted
from agents.leaderboard.chart import CHART
from agents.leaderboard.page import MAIN_SETS, TABLES
from agents.leaderboard.rows import RESULTS
from capsule_gym.evaluation.candidates import find_candidate
from tests.agents.fakes import write_run
from tests.agents.leaderboard.conftest import make_world
from tests.agents.leaderboard.world import (
    SETS,
    checked,
    edit_row,
    evaluated_again,
    make_set,
    table,
)

WRONG = {
    "--check --plants 0": "--plants",
    "--plants 5": "--plants",
    "lernt": "got lernt; did you mean 'learnt'?",
    "pd --from-results": "--from-results must be given without names, got 'pd'",
    "pd": "adaptive: no results in adaptive.npz; `python -m agents.leaderboard NAME` writes them",
}


def test_written_results_pass_the_check(written):
    assert checked(written) == []
    candidates = map(find_candidate, ("adaptive", "pd", "learnt"))
    assert evaluated_again(written, *candidates) == []


def test_no_temporary_files_are_left(written):
    assert not list(written.glob(".*"))
    assert not list((written / RESULTS).glob(".*"))


def test_the_readme_keeps_its_own_text(written):
    readme = (written / "README.md").read_text()
    assert readme.startswith("# Title\n\n<!--")
    assert readme.count("\n\nBetween.\n\n") == 1
    assert "Torque as a" in readme


def test_the_chart_is_stale_if_a_drawn_number_changes(written):
    before = (written / CHART).read_text()
    edit_row(written, "pd", lambda row: row.scores["real"][0].fill(1.0))
    (written / CHART).write_text(before)
    assert checked(written) == [f"{CHART} differs from the results"]


def test_check_names_changed_rows(written):
    edit_row(written, "learnt", lambda row: row.header.update(revision="feed"))
    write_run(written / "checkpoints" / "learnt" / "seed-1", 1, clip=9.0)
    scripted.SCRIPTED.pop("wild")
    scripted.SCRIPTED.pop("rocking")
    first, second, revision, changed, *pages = checked(written)
    assert first == "rocking: has results and does not exist"
    assert second == "wild: has results and does not exist"
    assert revision == "learnt: revision differs from its results"
    assert changed == "learnt: files differs from its results"
    assert all(line.endswith(" differs from the results") for line in pages)


def test_check_names_rows_with_results_on_further_sets(written):
    (first, *others) = checked(written, [each for each in SETS if each.name != "nominal"])
    assert first == "adaptive: sets differs from its results"
    assert "stay: sets differs from its results" not in others
    assert "learnt: sets differs from its results" in others


def test_check_needs_results_of_every_policy(written):
    write_run(written / "checkpoints" / "fresh" / "seed-0", 0)
    message = r"fresh: no results in fresh\.npz; `python -m agents\.leaderboard NAME`"
    with pytest.raises(ValueError, match=message):
        checked(written)


@pytest.mark.parametrize("name", ["leaderboard.json", "LEADERBOARD.md", "README.md", TABLES, CHART])
def test_check_names_stale_pages(written, name):
    text = (written / name).read_text()
    (written / name).write_text("" if name == CHART else text.replace("adaptive", "?", 1))
    assert checked(written) == [f"{name} differs from the results"]


@pytest.mark.parametrize(("name", "seed"), [("learnt", "training seed 1, "), ("rocking", "")])
def test_check_compares_the_last_bit_of_every_episode(written, name, seed):
    def nudge(row):
        row.scores["paper"][0, -1, 1] *= 1.0 + 2.0**-51

    edit_row(written, name, nudge)
    (stale,) = evaluated_again(written, find_candidate(name))
    assert stale.startswith(f"{name} on paper: mean_speed is ")
    assert f" now ({seed}episode 1; 1 of " in stale
    assert evaluated_again(written, find_candidate("pd")) == []


@pytest.mark.parametrize(("plants", "differences"), [(1, 0), (2, 1)])
def test_the_first_plants_of_every_set_are_checked_alone(written, plants, differences):
    edit_row(written, "rocking", lambda row: row.scores["paper"][0, :, 1].fill(9.0))
    found = evaluated_again(written, find_candidate("rocking"), plants=plants)
    assert len(found) == differences


def make_command(root, patch):
    """The command on small sets for two tasks in a world."""
    patch.setattr(leaderboard, "SETS", ("nominal", *MAIN_SETS, "goal"))

    def load(name):
        return replace(make_set(name, (0.5, 0.01)), task="goal" if name == "goal" else "speed")

    patch.setattr(leaderboard, "load_set", load)
    patch.setattr(leaderboard, "evaluate", partial(leaderboard.evaluate, horizon=0.4))
    patch.setattr(leaderboard, "ROOT", root)
    return lambda *words: leaderboard.main([*words, "--jobs", "1"])


@pytest.fixture
def main(world, monkeypatch):
    return make_command(world, monkeypatch)


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A world in which the command has written everything."""
    root = tmp_path_factory.mktemp("complete")
    with pytest.MonkeyPatch.context() as patch:
        make_world(root, patch)
        assert make_command(root, patch)() == 0
    return root


@pytest.fixture
def ready(main, world, complete):
    """The command after it has written everything."""
    shutil.copytree(complete, world, dirs_exist_ok=True)
    return main


def test_check_passes_after_everything_is_written(main, capsys, refused):
    assert "adaptive: no results" in refused(main, "--check")
    assert main() == 0
    assert main("--check") == 0
    assert main("--check", "pd", "--plants", "1") == 0
    assert "The leaderboard is up to date." in capsys.readouterr().out


def test_every_task_has_a_table_on_another_page(ready, world):
    (_, _, stay) = table((world / TABLES).read_text(), "start:goal]")
    assert stay[0] == "stay"
    assert "stay" not in (world / "LEADERBOARD.md").read_text()


def test_pages_are_written_from_results(ready, world, capsys):
    (world / "LEADERBOARD.md").unlink()
    assert ready("--check", "--from-results") == 1
    assert "- LEADERBOARD.md differs from the results" in capsys.readouterr().out
    assert ready("--from-results") == 0
    assert ready("--check", "--from-results") == 0


def test_an_unchanged_row_keeps_the_bytes_of_its_results(ready, world):
    def contents():
        return {path.name: path.read_bytes() for path in (world / RESULTS).iterdir()}

    before = contents()
    write_run(world / "checkpoints" / "learnt" / "seed-1", 1, clip=9.0)
    write_run(world / "checkpoints" / "fresh" / "seed-0", 0)
    assert ready("learnt", "fresh", "pd") == 0
    changed = {name for name, content in contents().items() if before.get(name) != content}
    assert changed == {"fresh.npz", "learnt.npz"}
    assert "|fresh|" in (world / "LEADERBOARD.md").read_text()


@pytest.mark.parametrize("words", [[], ["dirty"]])
def test_uncommitted_training_code_raises_an_error(ready, world, refused, words):
    write_run(world / "checkpoints" / "dirty" / "seed-3", 3, revision="0123456789ab+")
    assert "dirty/seed-3: the revision 0123456789ab+ is not committed" in refused(ready, *words)
    assert not (world / RESULTS / "dirty.npz").exists()
    assert "dirty: no results" in refused(ready, "--check")


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


def test_an_archive_instead_of_a_name_raises_an_error(main, tmp_path, refused):
    path = tmp_path / "model.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", "")
    assert f"{path} is no policy file, but an archive" in refused(main, str(path))


@pytest.mark.parametrize(("words", "message"), WRONG.items())
def test_wrong_options_are_named(main, words, message, refused):
    assert message in refused(main, *words.split())
