import json
import math
import re

import numpy as np
import pytest
from stable_baselines3 import PPO

from agents import evaluate
from agents.evaluation import candidates
from agents.evaluation import episodes as evaluation
from agents.evaluation.candidates import Run, all_candidates, checkpoint_names, find_candidate
from agents.evaluation.episodes import difference, failures, make_result, scores, summarise
from agents.evaluation.sets import load_set, parse_set
from agents.evaluation.statistics import estimate
from agents.training.presets import CONFIG
from agents.training.runs import MODEL, NORMALISATION, Normalisation, save_model
from agents.training.vec_env import CapsuleSB3VecEnv
from capsule_gym import CapsuleVectorEnv
from capsule_gym.files import to_json
from tests.agents.fakes import Sine, write_run

PLANTS = {
    "name": "tiny",
    "plants": [
        {"M": 0.5, "mu": 0.01, "seed": 0},
        {"M": 0.6, "mu": 0.1, "seed": 1},
        {"M": 0.5, "mu": 0.01, "seed": 2, "changes": [{"t": 0.5, "M": 0.7, "mu": 0.3}]},
    ],
}
TINY = parse_set(PLANTS)


@pytest.fixture
def tiny_file(tmp_path):
    path = tmp_path / "tiny.json"
    path.write_text(json.dumps(PLANTS))
    return str(path)


def test_episodes_are_those_of_single_environments():
    policy = Sine(0.5)
    episodes = evaluation.evaluate(policy, TINY, horizon=2.0)
    assert [e["seed"] for e in episodes] == [0, 1, 2]
    assert [e.get("changes", []) for e in episodes] == [p.to_dict()["changes"] for p in TINY.plants]
    for plant, episode in zip(TINY.plants, episodes, strict=True):
        env = CapsuleVectorEnv(1, max_episode_steps=100, randomization="none")
        options = {"M": plant.M, "mu": plant.mu, "changes": [[change.to_dict() for change in plant.changes]]}
        observation, _ = env.reset(seed=[plant.seed], options=options)
        act = policy.start([plant.seed])
        for _ in range(100):
            observation, _, _, truncated, _ = env.step(act(observation))
        assert truncated.all()
        for name, values in env.episode_metrics().items():
            assert episode[name] == values[0], name
    # The jump to a heavier platform on a rougher floor is felt.
    assert episodes[2]["mean_speed"] != episodes[0]["mean_speed"]


def test_only_the_first_end_of_an_episode_counts():
    # Full torque swings the ball into the platform at once.
    episodes = evaluation.evaluate(Sine(1.5, period=10.0), TINY, horizon=4.0)
    assert failures(episodes) == 3
    for episode in episodes:
        assert episode["duration"] < 1.0
        assert episode["mean_speed"] == pytest.approx(100.0 * episode["distance"] / 4.0)


def test_what_a_policy_was_trained_with_does_not_change_the_episodes():
    plain = evaluation.evaluate(Sine(0.3), TINY, horizon=1.0)
    kwargs = {"randomization": "wide", "initial_noise": 0.3, "num_envs": 7, "max_episode_steps": 3}
    kwargs |= {"autoreset_mode": "SAME_STEP"}
    assert evaluation.evaluate(Sine(0.3, env_kwargs=kwargs), TINY, horizon=1.0) == plain
    # The agent's step is the policy's own; the episode is as long.
    finer = evaluation.evaluate(Sine(0.3, env_kwargs={"control_dt": 0.01}), TINY, horizon=1.0)
    assert finer[0]["duration"] == pytest.approx(1.0)


def episodes_of(speeds, **fields):
    return [{"M": 0.5, "mu": 0.01, "seed": i, "mean_speed": v, "failed": 0.0, **fields} for i, v in enumerate(speeds)]


def test_summary():
    rng = np.random.default_rng(0)
    speeds = rng.normal(size=(2, 20))
    learned = [e for seed in (0, 1) for e in episodes_of(speeds[seed].tolist(), training_seed=seed)]
    learned[3]["failed"] = 1.0
    summary = summarise(learned)
    assert summary["mean_speed"] == estimate(speeds).to_dict()
    assert (summary["failures"], summary["episodes"]) == (1, 40)
    assert (summary["training_seeds"], summary["resampled"]) == ([0, 1], "seeds")
    assert set(summary) == {"mean_speed", "episodes", "failures", "training_seeds", "resampled"}
    scripted = episodes_of(rng.normal(size=20).tolist())
    assert summarise(scripted)["training_seeds"] == []
    assert difference(learned, scripted, "mean_speed").resampled == "seeds"


def test_results_are_strict_json_and_survive_it():
    episodes = episodes_of([1.0, 2.0], cost_of_transport=math.inf)
    text = to_json(make_result("x", TINY, episodes))
    result = json.loads(text, parse_constant=lambda name: pytest.fail(name))
    assert set(result) == {"policy", "set", "set_hash", "versions", "episodes", "summary"}
    assert (result["set"], result["set_hash"]) == ("tiny", TINY.hash)
    assert result["versions"]["numpy"] == np.__version__
    assert result["summary"]["cost_of_transport"] == {"iqm": None, "low": None, "high": None}
    np.testing.assert_array_equal(scores(result["episodes"], "cost_of_transport"), [[math.inf, math.inf]])


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Two scripted policies and a checkpoint of two seeds."""
    known = {name: Sine(amplitude, name=name) for name, amplitude in (("adaptive", 0.3), ("bold", 0.5))}
    for module in (candidates, evaluate):
        monkeypatch.setattr(module, "SCRIPTED", known)
    monkeypatch.setattr(candidates, "CHECKPOINTS", tmp_path / "checkpoints")
    for seed in (10, 2):
        write_run(tmp_path / "checkpoints" / "learnt" / f"seed-{seed}", seed)
    return tmp_path


@pytest.mark.usefixtures("world")
def test_candidates_by_name():
    assert [c.name for c in all_candidates()] == ["adaptive", "bold", "learnt"]
    learnt = find_candidate("learnt")
    assert [run.training_seed for run in learnt.runs] == [2, 10]
    assert (
        learnt.description
        == "PPO, a residual torque of up to 3 N m on `baselines:adaptive`, trained with randomization wide"
    )
    assert find_candidate("bold").runs[0].path is None


def test_candidates_by_path(world):
    folder = world / "checkpoints" / "learnt"
    assert find_candidate(str(folder)).runs[1].path == folder / "seed-10"
    assert find_candidate(str(folder / "seed-2")).runs[0].training_seed == 2
    archive = folder / "seed-2" / "best" / "model.zip"
    archive.parent.mkdir()
    (folder / "seed-2" / "model.zip").rename(archive)
    assert find_candidate(str(archive)).runs[0] == Run(str(archive), archive, 2, "0123456789ab")


def test_unknown_candidates_list_what_exists(world):
    accepted = r"scripted policy \(adaptive, bold\), a checkpoint \(learnt\), .* got 'lernt'"
    with pytest.raises(ValueError, match=accepted):
        find_candidate("lernt")
    (world / "empty").mkdir()
    with pytest.raises(ValueError, match="holds no folder seed-0"):
        find_candidate(str(world / "empty"))
    (world / "loose.zip").touch()
    with pytest.raises(ValueError, match=r"loose\.zip is not part of a training run"):
        find_candidate(str(world / "loose.zip"))


def test_malformed_runs_are_refused(world):
    config = world / "checkpoints" / "learnt" / "seed-2" / "config.json"
    for text, message in [
        ("{", "is not JSON"),
        ("[]", r"must hold an object, got \[\]"),
        ('{"algo": "ppo", "env": {}, "seed": "two"}', "must hold \"seed\", an integer, got 'two'"),
    ]:
        config.write_text(text)
        with pytest.raises(ValueError, match=message):
            all_candidates()
    write_run(config.parent, 10)
    with pytest.raises(ValueError, match=r"different training seeds, got \[10, 10\]"):
        all_candidates()
    write_run(config.parent, 2, algo="sac")
    with pytest.raises(ValueError, match="runs of one kind"):
        all_candidates()
    write_run(config.parent, 2)
    (world / "checkpoints" / "learnt").rename(world / "checkpoints" / "bold")
    assert checkpoint_names() == ["bold"]
    with pytest.raises(ValueError, match="must not have the name of a scripted policy, got 'bold'"):
        all_candidates()


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
    assert set(candidates.POLICY_FILES) == {CONFIG, MODEL, NORMALISATION}


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


def test_frozen_sets_are_accepted_by_the_environment():
    for name in ("nominal", "extrapolation", "drift"):
        episodes = evaluation.evaluate(Sine(0.2), load_set(name), horizon=0.1)
        assert all(math.isfinite(e["mean_speed"]) for e in episodes)
