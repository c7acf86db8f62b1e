"""Learning and speed of trainings. These tests measure no time."""

from __future__ import annotations

from benchmarks import training
from benchmarks.training import Run, configure

TINY = {"num_envs": 8, "n_steps": 4, "batch_size": 32, "hidden": 8, "evaluation_episodes": 2}


def test_the_learning_curves_are_measured_and_written(tmp_path, monkeypatch, capsys) -> None:
    learners = {"preset": configure(**TINY), "SB3's PPO": configure(**TINY, stock=True)}
    monkeypatch.setattr(training, "LEARNERS", learners)
    run = training.learn("preset", configure(**TINY, total_steps=1024))
    assert run.steps == list(range(64, 1025, 64)) and run.seconds == sorted(run.seconds)
    assert len(run.mean_speed) == len(run.failed) == len(run.steps)
    words = ["--seeds", "2", "--total-steps", "64", "--markdown", str(tmp_path / "a.md")]
    assert training.main([*words, "--figure", str(tmp_path / "curves.png")]) == 0
    assert "|SB3's PPO|2|" in (tmp_path / "a.md").read_text()
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "Over the whole curve" in capsys.readouterr().out


def test_numbers_of_the_tables_follow_from_the_runs() -> None:
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
