import pytest

from agents.leaderboard import candidates as leaderboard
from agents.leaderboard import page
from capsule_gym.evaluation import candidates
from tests.agents.fakes import Sine, write_run
from tests.agents.leaderboard.world import write_all

README = (
    "# Title\n\n"
    + "\n\nBetween.\n\n".join(page._section(name, "") for name in ("message", "leaderboard"))
    + "\n"
)


@pytest.fixture
def world(tmp_path, monkeypatch):
    """The rows of all tables as sines; a failing policy, one of another task; a checkpoint; a
    README."""
    names = {name for names, _ in page.SECTIONS.values() for name in names}.union(
        *page.GROUPS.values()
    )
    known = {name: Sine(0.05 + 0.02 * n, name=name) for n, name in enumerate(sorted(names))}
    known["wild"] = Sine(1.5, period=10.0, name="wild")
    known["rocking"] = Sine(0.4, name="rocking")
    of_tasks = {"stay": Sine(0.1, name="stay", env_kwargs={"task": "goal"})}
    monkeypatch.setattr(
        candidates, "find_scripted", lambda name: known.get(name, of_tasks.get(name))
    )
    monkeypatch.setattr(leaderboard, "SCRIPTED", known)
    monkeypatch.setattr(leaderboard, "TASK_SCRIPTED", of_tasks)
    monkeypatch.setattr(candidates, "CHECKPOINTS", tmp_path / "checkpoints")
    for seed in (0, 1):
        write_run(tmp_path / "checkpoints" / "learnt" / f"seed-{seed}", seed)
    (tmp_path / "docs/media").mkdir(parents=True)
    (tmp_path / "README.md").write_text(README)
    return tmp_path


@pytest.fixture
def written(world):
    write_all(world)
    return world
