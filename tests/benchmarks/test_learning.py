import json

import pytest
import torch

from benchmarks import training as benchmark
from benchmarks import training_cost, training_profile
from tests.agents.training.small import SMALL


def test_benchmark_compares_what_was_learned_and_goes_on(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(benchmark, "SETTINGS", {"tuned": {**SMALL, "n_steps": 32}})
    plants = [{"M": 0.5, "mu": 0.01, "seed": seed, "changes": []} for seed in range(2)]
    (tmp_path / "two.json").write_text(json.dumps({"name": "two", "plants": plants}))
    options = ["--settings", "adaptive", "tuned", "--steps", "512", "--set", str(tmp_path / "two.json")]
    options += ["--runs", str(tmp_path / "runs")]
    assert benchmark.main([*options, "--seeds", "0", "--json", str(tmp_path / "a.json")]) == 0
    first = (tmp_path / "runs" / "tuned-512-seed0" / "model.zip").stat().st_mtime_ns
    written = ["--json", str(tmp_path / "b.json"), "--markdown", str(tmp_path / "b.md")]
    assert benchmark.main([*options, "--seeds", "0", "1", *written]) == 0
    assert (tmp_path / "runs" / "tuned-512-seed0" / "model.zip").stat().st_mtime_ns == first
    content = json.loads((tmp_path / "b.json").read_text())
    assert content["settings"]["tuned"]["summary"]["training_seeds"] == [0, 1]
    assert [run["steps"] for run in content["settings"]["tuned"]["runs"]] == [512, 512]
    assert content["settings"]["tuned"]["runs"][0]["processor_seconds"] > 0.0
    line = next(line for line in (tmp_path / "b.md").read_text().splitlines() if line.startswith("| tuned "))
    assert line.split("|")[2].strip() == "2"
    assert "mean speed" in capsys.readouterr().out


def test_benchmark_measures_speeds_and_where_time_goes(tmp_path, capsys, monkeypatch):
    tiny = {"num_envs": 4, "hidden": 8, "batch_size": 16}
    rivals = [training_cost.ppo("ppo", n_steps=8, **tiny), training_cost.sac("sac", learning_starts=20, **tiny)]
    slow = [training_cost.ppo("one by one", training_cost.one_by_one(training_cost.DummyVecEnv), n_steps=8, **tiny)]
    monkeypatch.setattr(benchmark, "axes", lambda: {"both": rivals, "slow": slow})
    monkeypatch.setattr(benchmark, "profiled", lambda: rivals)
    before = torch.get_num_threads()
    for mode in ("--sweep", "--profile"):
        files = [f"--json={tmp_path / mode[2:]}.json", f"--markdown={tmp_path / mode[2:]}.md"]
        assert benchmark.main([mode, "--turns", "2", "--seconds", "0.02", *files]) == 0
    assert torch.get_num_threads() == before
    rates = json.loads((tmp_path / "sweep.json").read_text())["env_steps_per_second"]
    assert set(rates) == {"both", "slow"} and len(rates["both"]["sac"]) == 2
    assert "[start:slow]" in (tmp_path / "sweep.md").read_text()
    parts = json.loads((tmp_path / "profile.json").read_text())["microseconds_per_env_step"]
    assert all(value > 0.0 for name in ("ppo", "sac") for value in parts[name].values())
    assert {
        training_profile.ENVIRONMENT,
        training_profile.SAMPLE,
        training_profile.TARGETS,
        training_profile.BACKWARD,
    } <= set(parts["sac"])
    assert "update: Adam" in capsys.readouterr().out


def test_clocks_leave_out_what_is_clocked_inside_and_leave_no_trace(monkeypatch):
    now = 0.0
    monkeypatch.setattr(training_profile.time, "perf_counter", lambda: now)

    class Work:
        def outer(self):
            nonlocal now
            now += 1.0
            self.inner()

        def inner(self):
            nonlocal now
            now += 5.0

    work, clocks = Work(), training_profile.Clocks()
    clocks.watch(work, "outer", "outer")
    clocks.watch(Work, "inner", "inner")
    work.outer()
    clocks.stop()
    assert clocks.seconds == {"outer": 1.0, "inner": 5.0}
    assert not vars(work)
    work.outer()
    assert clocks.seconds == {"outer": 1.0, "inner": 5.0}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--json", __file__], "--json"),
        (["--settings", "nobody"], "nobody"),
        (["--steps", "0.5"], "--steps"),
        (["--sweep", "sideways"], "sideways"),
    ],
)
def test_bad_options_of_the_benchmark_are_named(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        benchmark.main(arguments)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
