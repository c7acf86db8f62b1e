import shutil

import pytest

from agents.leaderboard import candidates as leaderboard
from agents.leaderboard import page
from capsule_gym.evaluation import candidates
from tests.agents.fakes import Sine, write_run
from tests.agents.leaderboard.world import write_all

MESSAGE, TABLE = (page._section(name, "") for name in ("message", "leaderboard"))
README = f"# Title\n\n{MESSAGE}\n\nBetween.\n\n{TABLE}\n"


def make_world(root, patch):
    names = set().union(*page.GROUPS.values(), *(names for names, _ in page.SECTIONS.values()))
    known = {name: Sine(0.05 + 0.02 * n, name=name) for n, name in enumerate(sorted(names))}
    known["wild"] = Sine(1.5, period=10.0, name="wild")
    known["rocking"] = Sine(0.4, name="rocking")
    of_tasks = {"stay": Sine(0.1, name="stay", env_kwargs={"task": "goal"})}
    patch.setattr(candidates, "find_scripted", (known | of_tasks).get)
    patch.setattr(leaderboard, "SCRIPTED", known)
    patch.setattr(leaderboard, "TASK_SCRIPTED", of_tasks)
    patch.setattr(candidates, "CHECKPOINTS", root / "checkpoints")
    for seed in (0, 1):
        write_run(root / "checkpoints" / "learnt" / f"seed-{seed}", seed)
    (root / "docs/media").mkdir(parents=True)
    (root / "README.md").write_text(README)


@pytest.fixture
def world(tmp_path, monkeypatch):
    """The rows of all tables as sines; a failing policy, one of another task; a checkpoint; a
    README."""
    make_world(tmp_path, monkeypatch)
    return tmp_path


@pytest.fixture(scope="session")
def results(tmp_path_factory):
    root = tmp_path_factory.mktemp("world")
    with pytest.MonkeyPatch.context() as patch:
        make_world(root, patch)
        write_all(root)
    return root


@pytest.fixture
def written(world, results):
    """The world with its results and pages."""
    return shutil.copytree(results, world, dirs_exist_ok=True)
