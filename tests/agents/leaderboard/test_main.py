import pytest

from agents.leaderboard import __main__ as leaderboard
from agents.leaderboard.rows import RESULTS
from tests.agents.fakes import write_run
from tests.agents.leaderboard.world import SETS


@pytest.fixture
def main(world, monkeypatch):
    """The command on one small set."""
    monkeypatch.setattr(leaderboard, "SET_NAMES", ("paper",))
    monkeypatch.setattr(leaderboard, "load_set", lambda name: SETS[1])
    return lambda *words: leaderboard.main([*words, "--jobs", "1"], root=world)


def test_command_line(main, world, capsys):
    assert main("--check") == 1
    assert "The leaderboard is stale:\n- adaptive: has no results" in capsys.readouterr().out
    assert main() == 0
    assert main("--check") == 0
    assert "up to date: 5 policies on 1 sets" in capsys.readouterr().out
    (world / "LEADERBOARD.md").unlink()
    assert main("--check", "--from-results") == 1
    assert main("--from-results") == 0
    assert main("--check", "bold") == 0


def test_named_rows_alone_are_evaluated(main, world, monkeypatch):
    assert main() == 0
    write_run(world / "checkpoints" / "learnt" / "seed-1", 1, clip=9.0)
    write_run(world / "checkpoints" / "fresh" / "seed-0", 0)
    times = {path.name: path.stat().st_mtime_ns for path in (world / RESULTS).iterdir()}
    assert main("learnt", "fresh") == 0
    new = {path.name: path.stat().st_mtime_ns for path in (world / RESULTS).iterdir()}
    assert {name for name in new if times.get(name) != new[name]} == {"fresh.npz", "learnt.npz"}
    assert "| fresh " in (world / "LEADERBOARD.md").read_text()
    # The results of a row that came out the same stay as they are.
    assert main("bold") == 0
    assert (world / RESULTS / "bold.npz").stat().st_mtime_ns == times["bold.npz"]


def test_what_was_evaluated_survives_an_interruption(main, world, monkeypatch, capsys):
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
        (["--jobs", "-1"], "--jobs"),
        (["--jobs", "two"], "--jobs"),
        (["lernt"], "names must be out of adaptive, bold, wild, twitch, learnt, got lernt"),
        (["bold", "--from-results"], "--from-results must stand without names, got bold"),
        (["bold"], "adaptive: has no results, expected in adaptive.npz; `python -m agents.leaderboard NAME`"),
    ],
)
def test_wrong_options_are_named(words, message, world, monkeypatch, capsys):
    monkeypatch.setattr(leaderboard, "SET_NAMES", ("paper",))
    monkeypatch.setattr(leaderboard, "load_set", lambda name: SETS[1])
    with pytest.raises(SystemExit) as stop:
        leaderboard.main(words if "--jobs" in words else [*words, "--jobs", "1"], root=world)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
