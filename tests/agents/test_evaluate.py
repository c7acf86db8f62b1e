import json
import re

import numpy as np
import pytest
from stable_baselines3 import PPO

from agents import evaluate
from agents.training.runs import Normalisation, save_model
from agents.training.vec_env import CapsuleSB3VecEnv
from tests.agents.fakes import Sine


def test_command_line(world, tiny_file, monkeypatch, capsys):
    monkeypatch.setattr("agents.training.runs.load_policy", lambda path: Sine(0.4, name="learnt"))
    out = world / "result.json"
    assert evaluate.main(["learnt", "--set", tiny_file, "--json", str(out), "--seed-runs"]) == 0
    printed = capsys.readouterr().out
    assert "learnt on the set tiny (3 episodes, " in printed
    assert "adaptive" in printed
    assert "over training seeds" in printed
    assert re.search(r"\ntraining seed +mean speed", printed)
    result = json.loads(out.read_text())
    assert [e["training_seed"] for e in result["episodes"]] == [2, 2, 2, 10, 10, 10]
    assert result["policy"] == "learnt"
    assert not list(world.glob(".*"))


def test_command_line_keeps_existing_results(world, tiny_file, capsys):
    out = world / "result.json"
    out.write_text("precious")
    with pytest.raises(SystemExit):
        evaluate.main(["bold", "--set", tiny_file, "--json", str(out)])
    assert out.read_text() == "precious"
    assert "--json must name a new file unless --overwrite is given" in capsys.readouterr().err
    assert evaluate.main(["adaptive", "--set", tiny_file, "--json", str(out), "--overwrite"]) == 0
    assert json.loads(out.read_text())["policy"] == "adaptive"
    # The reference needs no comparison with itself.
    assert "difference" not in capsys.readouterr().out


def test_a_real_training_run_is_evaluated(world, tiny_file, capsys):
    run = world / "checkpoints" / "learnt" / "seed-2"
    config = json.loads((run / "config.json").read_text()) | {"env": {"torque_limit": 0.1}}
    (run / "config.json").write_text(json.dumps(config))
    with pytest.raises(SystemExit):
        evaluate.main([str(run), "--set", tiny_file])
    assert "normalisation.json is missing" in capsys.readouterr().err
    env = CapsuleSB3VecEnv(1, torque_limit=0.1)
    entries = env.observation_space.shape
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu")
    save_model(run, model, Normalisation(np.zeros(entries), np.ones(entries), 1.0, 10.0, 1e-8))
    assert evaluate.main([str(run), "--set", tiny_file]) == 0
    assert "seed-2 on the set tiny" in capsys.readouterr().out


@pytest.mark.usefixtures("world")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nobody"], "got 'nobody'"),
        (["bold", "--set", "papr"], "got 'papr'"),
        (["bold", "--against", "nobody"], "got 'nobody'"),
        (["bold", "--json", "/nowhere/x.json"], "--json must name a file in a folder that exists"),
    ],
)
def test_command_line_refuses_before_any_work(arguments, message, capsys):
    with pytest.raises(SystemExit) as caught:
        evaluate.main(arguments)
    assert caught.value.code == 2
    assert message in capsys.readouterr().err


def test_help_warns_of_pickles(capsys):
    with pytest.raises(SystemExit):
        evaluate.main(["--help"])
    assert "load only what you trust" in " ".join(capsys.readouterr().out.split())
