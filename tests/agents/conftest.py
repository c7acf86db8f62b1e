import json

import pytest

from baselines.evaluation import policies
from tests.agents.fakes import PLANTS, Sine, write_run


@pytest.fixture
def tiny_file(tmp_path):
    path = tmp_path / "tiny.json"
    path.write_text(json.dumps(PLANTS))
    return str(path)


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Two scripted policies and a checkpoint with two seeds."""
    known = {name: Sine(amplitude, name=name) for name, amplitude in (("adaptive", 0.3), ("bold", 0.5))}
    monkeypatch.setattr(policies, "SCRIPTED", known)
    monkeypatch.setattr(policies, "CHECKPOINTS", tmp_path / "checkpoints")
    for seed in (10, 2):
        write_run(tmp_path / "checkpoints" / "learnt" / f"seed-{seed}", seed)
    return tmp_path
