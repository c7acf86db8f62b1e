"""Studies: the plan of runs, failures and interruptions, and publication of results."""

import dataclasses
import json
import os
import re
import signal
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from agents.study import FINISHED, Job, copy_policy, main, plan, results_table, train_all
from agents.training.config import RunError
from agents.training.presets import TRAINED_ROWS
from tests import ROOT
from tests.agents.fakes import write_run
from tests.agents.training.small import differences, small

STEPS = 2048


def job(folder, seed=0, **changes):
    settings = dict(total_steps=STEPS, evaluate_every=512) | changes
    config = small("direct", "ppo", seed=seed, **settings)
    return Job("tiny", config, folder / "tiny" / f"seed-{seed}")


def write_config(job, **more):
    content = {"task": "direct", "algo": "ppo", "hyperparameters": job.config.to_dict(), **more}
    job.run.mkdir(parents=True, exist_ok=True)
    (job.run / "config.json").write_text(json.dumps(content))


def test_a_run_with_other_settings_is_not_resumed(tmp_path):
    config = dataclasses.replace(TRAINED_ROWS["direct-ppo"], gamma=0.5)
    write_config(Job("direct-ppo", config, tmp_path / "direct-ppo" / "seed-0"))
    with pytest.raises(RunError, match=r"gamma was 0\.5 and is 0\.995"):
        plan(["direct-ppo"], [0], tmp_path)


def test_a_study_has_every_run_once(tmp_path):
    jobs = plan(["direct-ppo", "direct-sac", "direct-ppo"], [1, 2, 1], tmp_path)
    expected = [("direct-ppo", 1), ("direct-sac", 1), ("direct-ppo", 2), ("direct-sac", 2)]
    assert [(job.row, job.config.seed) for job in jobs] == expected
    assert [job.name for job in jobs] == [f"{row}/seed-{seed}" for row, seed in expected]


EVALUATIONS = """\
steps,seconds,mean_speed_cm_s,failed,score_cm_s
512,1.5,9.0,0.25,8.0
1024,1.5,8.0,0.25,7.5
16384,1.5,7.0,0.0,7.0
"""


@pytest.fixture
def quick_training(monkeypatch):
    """Trainings only write evaluations."""

    def train(run):
        return bool((run / "evaluations.csv").write_text(EVALUATIONS))

    monkeypatch.setattr("agents.training.loop.train", train)


def test_a_run_that_fails_does_not_stop_the_others(tmp_path, quick_training):
    wrong, right = job(tmp_path, 0, gamma=2.0), job(tmp_path, 1)
    failures = train_all([wrong, right], 1)
    assert list(failures) == [wrong]
    assert "gamma must be a number in [0, 1], got 2.0" in failures[wrong]
    assert "Traceback" in wrong.run.with_name("seed-0.log").read_text()
    assert not wrong.finished
    assert right.finished


def test_the_table_shows_the_best_evaluation(tmp_path):
    one = job(tmp_path, 1)
    one.run.mkdir(parents=True)
    (one.run / "evaluations.csv").write_text(EVALUATIONS)
    titles, *_, line = results_table([job(tmp_path, 0), one]).splitlines()
    # Numbers end where their title does.
    assert line.index("16,384") + len("16,384") == titles.index("steps") + len("steps")
    assert line.split() == "tiny/seed-1 16,384 512 9.00 cm/s, failed 25.0%".split()


def test_a_finished_run_is_not_trained_again(tmp_path, quick_training):
    def times():
        return {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}

    jobs = [job(tmp_path)]
    assert train_all(jobs, 1) == {}
    before = times()
    assert train_all(jobs, 1) == {}
    assert times() == before


def test_an_interrupt_ends_a_study_after_the_present_runs(tmp_path, monkeypatch):
    def interrupt(run):
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("agents.training.loop.train", interrupt)
    first, second = job(tmp_path, 0), job(tmp_path, 1)
    with pytest.raises(KeyboardInterrupt):
        train_all([first, second], 1)
    assert first.run.exists()
    assert not second.run.exists()


@pytest.mark.skipif(os.name == "nt", reason="needs signals")
def test_sigterm_ends_the_run_of_a_worker(tmp_path):
    endless = job(tmp_path, total_steps=10**7)

    def terminate():
        while not (endless.run / "evaluations.csv").exists():
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=terminate, daemon=True)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        train_all([endless], 2)
    assert list(endless.run.glob("checkpoint-*"))
    assert not endless.finished


def test_a_study_uses_all_cores_unless_it_is_told_how_many(monkeypatch):
    counts = []

    def record(self, tasks):
        counts.append(self.n_jobs)
        return []

    monkeypatch.setattr("joblib.Parallel.__call__", record)
    train_all([])
    train_all([], 2)
    assert counts == [-1, 2]


def test_a_killed_worker_is_a_failure_of_the_unfinished_runs(tmp_path, monkeypatch):
    first, second = job(tmp_path, 0), job(tmp_path, 1)

    def killed(self, tasks):
        next(iter(tasks))
        first.run.mkdir(parents=True)
        (first.run / FINISHED).touch()
        raise RuntimeError("a worker was killed\nand more")

    monkeypatch.setattr("joblib.Parallel.__call__", killed)
    failures = train_all([first, second], 1)
    reason = "RuntimeError: a worker was killed; --resume continues"
    assert failures == {second: reason}


@pytest.fixture
def ray(monkeypatch):
    """A substitute of Ray, which runs tasks at once in this process."""
    module = SimpleNamespace(
        init=Mock(),
        remote=lambda **_: lambda function: SimpleNamespace(remote=function),
        wait=lambda references: (references[:1], references[1:]),
        get=list,
        shutdown=Mock(),
    )
    monkeypatch.setitem(sys.modules, "ray", module)
    return module


def test_the_machines_of_a_cluster_find_the_code_and_the_runs(tmp_path, ray, monkeypatch):
    trained = []
    monkeypatch.setattr("agents.training.loop.begin", Mock())
    monkeypatch.setattr("agents.training.loop.train", trained.append)
    monkeypatch.chdir(tmp_path)
    jobs = [job(Path("runs"), seed) for seed in (0, 1)]
    # Without a result a run is not complete.
    assert train_all(jobs, backend="ray") == dict.fromkeys(jobs, "stopped by a signal")
    assert trained == [tmp_path / each.run for each in jobs]
    environment = ray.init.call_args.kwargs["runtime_env"]["env_vars"]
    assert environment == {"PYTHONPATH": str(ROOT)}
    ray.shutdown.assert_called_once_with()


def test_a_lost_node_of_a_ray_cluster_loses_no_run(tmp_path, monkeypatch):
    cluster_utils = pytest.importorskip("ray.cluster_utils")
    # A busy machine starts nodes slowly.
    monkeypatch.setenv("RAY_raylet_start_wait_time_s", "300")
    head = {"num_cpus": 1, "include_dashboard": False}
    cluster = cluster_utils.Cluster(initialize_head=True, head_node_args=head)
    other = cluster.add_node(num_cpus=1)
    monkeypatch.setenv("RAY_ADDRESS", cluster.address)
    jobs = [job(tmp_path, seed, total_steps=12_000, evaluate_every=2000) for seed in range(3)]
    lost = []

    def lose_node():
        # Both nodes are in the middle of a run.
        while sum(any(each.run.glob("checkpoint-*")) and not each.finished for each in jobs) < 2:
            time.sleep(0.05)
        cluster.remove_node(other, allow_graceful=False)
        lost.append([each for each in jobs if not each.finished])

    thread = threading.Thread(target=lose_node, daemon=True)
    thread.start()
    try:
        assert train_all(jobs, backend="ray") == {}
    finally:
        cluster.shutdown()
    thread.join()
    assert len(lost[0]) == 3
    for each in jobs:
        assert each.finished
        # Also the run that began on the lost node is, bit for bit, the run of a single process.
        whole = dataclasses.replace(each, run=tmp_path / "whole" / each.run.name)
        assert train_all([whole], 1) == {}
        assert differences(each.run, whole.run) == []


@pytest.fixture
def finished(tmp_path):
    made = job(tmp_path / "runs", seed=3)
    write_run(made.run / "best", 3)
    write_config(made, revision="0123456789ab")
    (made.run / "evaluations.csv").write_text("steps,seconds\n")
    (made.run / FINISHED).touch()
    return made


def test_the_best_policy_and_the_evaluations_are_published(finished, tmp_path):
    row = tmp_path / "checkpoints" / "tiny"
    assert copy_policy(finished, tmp_path / "checkpoints") == row / "seed-3"
    # Existing files are replaced.
    (row / "seed-3" / "policy.safetensors").write_bytes(b"")
    copy_policy(finished, tmp_path / "checkpoints")
    copies = {
        "config.json": "config.json",
        "seed-3/evaluations.csv": "evaluations.csv",
        "seed-3/policy.safetensors": "best/policy.safetensors",
    }
    found = {path.relative_to(row).as_posix() for path in row.rglob("*.*")}
    assert found == set(copies)
    for copy, original in copies.items():
        assert (row / copy).read_bytes() == (finished.run / original).read_bytes()


@pytest.mark.parametrize("revision", ["0123456789ab+", "unknown"])
def test_a_revision_that_cannot_be_checked_out_is_not_published(finished, tmp_path, revision):
    write_config(finished, revision=revision)
    message = re.escape(f"committed code, got the revision {revision!r}")
    with pytest.raises(RunError, match=message):
        copy_policy(finished, tmp_path / "checkpoints")
    assert not (tmp_path / "checkpoints").exists()


def test_an_unfinished_run_is_not_published(finished, tmp_path):
    (finished.run / FINISHED).unlink()
    with pytest.raises(RunError, match="not finished"):
        copy_policy(finished, tmp_path / "checkpoints")
    assert not (tmp_path / "checkpoints").exists()


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A study of two runs on the command line, with its revisions and the end of its training."""

    def run(train, *revisions):
        monkeypatch.setattr("agents.study.train_all", train)
        revision = Mock(side_effect=revisions)
        monkeypatch.setattr("agents.training.checkpoint.git_revision", revision)
        words = "direct-ppo --seeds 0 1 --jobs 3 --publish --runs"
        return main([*words.split(), str(tmp_path)])

    return run


def test_uncommitted_code_is_refused_before_the_training(study, refused):
    error = refused(study, Mock(side_effect=AssertionError), "0123456789ab", "0123456789ab+")
    assert "--publish needs runs of committed code, got the revision '0123456789ab+' of" in error


def lose_first(jobs, parallel, backend):
    assert (len(jobs), parallel, backend) == (2, 3, "loky")
    return {jobs[0]: "lost"}


def interrupt(jobs, parallel, backend):
    raise KeyboardInterrupt


SUMMARY = "Mean speed and failures of the best evaluation on the run's validation plants"


@pytest.mark.parametrize(
    ("train", "status", "said", "errors"),
    [
        (lose_first, 1, SUMMARY, "direct-ppo/seed-0 failed: lost\n"),
        (interrupt, 130, "--resume", ""),
    ],
)
def test_failures_and_ctrl_c_have_their_exit_status(study, capsys, train, status, said, errors):
    assert study(train, "0123456789ab", "0123456789ab") == status
    out, err = capsys.readouterr()
    assert said in out
    assert err == errors


@pytest.fixture
def completed(tmp_path, monkeypatch):
    """A study on the command line of which all runs are completed."""

    def train(jobs, *_):
        for each in jobs:
            each.run.mkdir(parents=True)
            (each.run / FINISHED).touch()
        return {}

    def run(copy_policy, *options):
        monkeypatch.setattr("agents.study.copy_policy", copy_policy)
        return main(["direct-ppo", "--seeds", "0", "1", "--runs", str(tmp_path), *options])

    monkeypatch.setattr("agents.study.train_all", train)
    monkeypatch.setattr("agents.study.check_committed", Mock())
    return run


@pytest.mark.parametrize("options", [["--publish"], []])
def test_finished_runs_are_published_only_on_request(completed, options):
    copied = Mock(return_value="folder")
    assert completed(copied, *options) == 0
    assert copied.call_count == 2 * len(options)


def test_every_run_that_cannot_be_published_is_named(completed, capsys):
    assert completed(Mock(side_effect=OSError("disk full")), "--publish") == 1
    reasons = [f"direct-ppo/seed-{seed} is not published: disk full" for seed in (0, 1)]
    assert capsys.readouterr().err.splitlines() == reasons
