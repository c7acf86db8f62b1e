import pytest

from agents.evaluation import candidates
from agents.leaderboard import __main__ as leaderboard
from tests.agents.leaderboard.world import SETS


def test_command_line(world, monkeypatch, capsys):
    monkeypatch.setattr(leaderboard, "SET_NAMES", ("paper",))
    monkeypatch.setattr(leaderboard, "load_set", lambda name: SETS[1])
    monkeypatch.setattr(candidates, "CHECKPOINTS", world / "none")
    assert leaderboard.main(["--check", "--jobs", "1"], root=world) == 1
    assert "The leaderboard is stale:\n- leaderboard.json is missing\nRun " in capsys.readouterr().out
    assert leaderboard.main(["--jobs", "1"], root=world) == 0
    assert leaderboard.main(["--check", "--jobs", "1"], root=world) == 0
    assert "up to date: 4 policies on 1 sets" in capsys.readouterr().out


@pytest.mark.parametrize("jobs", ["0", "-1", "two"])
def test_wrong_options_are_named(jobs, capsys):
    with pytest.raises(SystemExit) as stop:
        leaderboard.main(["--jobs", jobs])
    assert stop.value.code == 2
    assert "--jobs" in capsys.readouterr().err
