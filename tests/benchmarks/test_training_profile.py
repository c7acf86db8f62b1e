"""Where the time of a training goes: the clocks, and the parts that they are put on."""

from __future__ import annotations

import json

from benchmarks import training_profile
from benchmarks.trainers import ppo, sac

TINY = {"num_envs": 4, "hidden": 8, "batch_size": 16}
RIVALS = (
    ppo("ppo", n_steps=8, **TINY),
    ppo("plain", own=False, n_steps=8, **TINY),
    sac("sac", learning_starts=20, **TINY),
)


def test_every_part_of_a_training_has_its_time(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(training_profile, "PROFILED", RIVALS)
    files = ["--json", str(tmp_path / "profile.json"), "--markdown", str(tmp_path / "profile.md")]
    assert training_profile.main(["--turns", "2", "--seconds", "0.02", *files]) == 0
    parts = json.loads((tmp_path / "profile.json").read_text())["microseconds_per_env_step"]
    assert all(value > 0.0 for each in parts.values() for value in each.values())
    assert {training_profile.ROLLOUT, training_profile.STEPS} <= set(parts["ppo"])
    assert {
        training_profile.ENVIRONMENT,
        training_profile.SAMPLE,
        training_profile.TARGETS,
        training_profile.BACKWARD,
    } <= set(parts["sac"])
    assert set().union(*parts.values()) == set(training_profile.PARTS)
    assert "[start:profile]" in (tmp_path / "profile.md").read_text()
    assert "update: Adam" in capsys.readouterr().out


def test_clocks_leave_out_what_is_clocked_inside_and_leave_no_trace(monkeypatch):
    now = 0.0
    monkeypatch.setattr(training_profile.time, "process_time", lambda: now)

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
