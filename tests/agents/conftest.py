import json

import pytest

from agents.leaderboard import candidates as leaderboard
from capsule_gym.evaluation import candidates
from tests.agents.fakes import PLANTS, Sine, write_run


@pytest.fixture
def tiny_file(tmp_path):
    path = tmp_path / "tiny.json"
    path.write_text(json.dumps(PLANTS))
    return str(path)


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Two scripted policies and a checkpoint with two seeds."""
    known = {"adaptive": Sine(0.3, name="adaptive"), "bold": Sine(0.5, name="bold")}
    monkeypatch.setattr(candidates, "scripted_names", lambda: list(known))
    monkeypatch.setattr(candidates, "find_scripted", known.get)
    monkeypatch.setattr(leaderboard, "SCRIPTED", known)
    monkeypatch.setattr(candidates, "CHECKPOINTS", tmp_path / "checkpoints")
    for seed in (10, 2):
        write_run(tmp_path / "checkpoints" / "learnt" / f"seed-{seed}", seed)
    return tmp_path
