"""Speed and learning of trainings: nothing here measures a time."""

from __future__ import annotations

import json

from benchmarks import training
from benchmarks.training import Run, trainer

TINY = {"num_envs": 8, "n_steps": 4, "batch_size": 32, "hidden": 8, "evaluation_episodes": 2}


def test_every_part_is_measured_and_written(tmp_path, monkeypatch, capsys) -> None:
    own, peer = trainer("preset", **TINY), trainer("SB3's PPO", stock=True, **TINY)
    monkeypatch.setattr(training, "LEARNERS", (own, peer))
    monkeypatch.setattr(training, "CONTENDERS", (own, peer))
    monkeypatch.setattr(training, "SECONDS", 0.01)
    words = ["--parts", "learning", "speed", "--seeds", "2", "--total-steps", "1024", "--turns", "2"]
    words += ["--json", str(tmp_path / "a.json"), "--markdown", str(tmp_path / "a.md")]
    assert training.main([*words, "--figure", str(tmp_path / "curves.png")]) == 0
    numbers = json.loads((tmp_path / "a.json").read_text())
    assert [(run["name"], run["seed"]) for run in numbers["runs"]] == [
        *(("preset", seed) for seed in range(2)),
        *(("SB3's PPO", seed) for seed in range(2)),
    ]
    for run in numbers["runs"]:
        assert run["steps"] == list(range(64, 1025, 64)) and run["seconds"] == sorted(run["seconds"])
        assert len(run["mean_speed"]) == len(run["failed"]) == len(run["steps"])
    assert {name: len(rates) for name, rates in numbers["rates"].items()} == {"preset": 2, "SB3's PPO": 2}
    page = (tmp_path / "a.md").read_text()
    assert "[start:learning]" in page and "[end:speed]" in page
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "range of the ratio" in capsys.readouterr().out


def test_numbers_of_the_tables_follow_from_the_runs() -> None:
    header, _, row = training.speed_table({"first": [10.0, 20.0], "other": [20.0, 30.0]})
    cells = dict(zip(header, row, strict=True))
    assert (cells["ratio"], cells["range of the ratio"]) == ("1.75", "1.50 to 2.00")
    runs = {
        name: [Run(name, seed, [100, 200], [1.0, second], [speed, 2 * speed], [0.0, 0.5]) for seed in range(2)]
        for name, second, speed in (("preset", 2.0, 2.0), ("SB3's PPO", 8.0, 1.0))
    }
    header, row, _ = training.learning_table(runs)
    cells = dict(zip(header, row, strict=True))
    assert (cells["steps/s"], cells["ratio (range)"], cells["failures"]) == ("100", "4.0 (4.0 to 4.0)", "50.0 %")
    assert cells["at 25 %"].startswith("2.0 [") and cells["at 100 %"].startswith("4.0 [")
    assert cells["whole curve"].startswith("3.0 [")
    assert "+1.5 cm/s [+1.5, +1.5]" in training.difference(runs)
