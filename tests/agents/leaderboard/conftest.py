import pytest

from agents.leaderboard import page, rows
from agents.leaderboard.page import END, START
from baselines.evaluation import policies
from tests.agents.fakes import Sine, Twitch, write_run
from tests.agents.leaderboard.world import write_all

README = f"# Title\n\nBefore.\n\n{START}\n{END}\n\nAfter.\n"


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Scripted policies: ordinary, failing everywhere, chaotic and of another task; a checkpoint; a README."""
    known = {name: Sine(amplitude, name=name) for name, amplitude in (("adaptive", 0.3), ("bold", 0.6))}
    known["wild"] = Sine(1.5, period=10.0, name="wild")
    known["twitch"] = Twitch()
    for module in (policies, rows):
        monkeypatch.setattr(module, "SCRIPTED", known)
    monkeypatch.setattr(policies, "TASK_SCRIPTED", {"stay": Sine(0.1, name="stay", env_kwargs={"task": "goal"})})
    for module in (policies, page):
        monkeypatch.setattr(module, "CHECKPOINTS", tmp_path / "checkpoints")
    monkeypatch.setattr(rows, "COPIES", 20)
    for seed in (0, 1):
        write_run(tmp_path / "checkpoints" / "learnt" / f"seed-{seed}", seed)
    (tmp_path / "checkpoints" / "README.md").write_text("| `learnt` | 0 to 1 | `python train.py --seed N` |\n")
    (tmp_path / "README.md").write_text(README)
    return tmp_path


@pytest.fixture
def written(world):
    write_all(world)
    return world
