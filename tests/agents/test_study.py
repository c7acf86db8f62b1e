"""Studies: the plan of runs, failures and interruptions, and publication of results."""

import dataclasses
import json
import re
import signal
import threading
import time

import pytest

from agents.study import FINISHED, Job, copy_policy, main, plan, results_table, train_all
from agents.training.config import RunError
from agents.training.presets import TRAINED_ROWS
from tests.agents.fakes import write_run
from tests.agents.training.small import differences, small

STEPS = 2048


def job(folder, seed=0, **changes):
    config = small(
        "direct", "ppo", seed=seed, **{"total_steps": STEPS, "evaluate_every": 512, **changes}
    )
    return Job("tiny", config, folder / "tiny" / f"seed-{seed}")


def test_a_run_with_other_settings_is_not_resumed(tmp_path):
    run = tmp_path / "direct-ppo" / "seed-0"
    run.mkdir(parents=True)
    config = dataclasses.replace(TRAINED_ROWS["direct-ppo"], gamma=0.5)
    content = {"task": "direct", "algo": "ppo", "hyperparameters": config.to_dict()}
    (run / "config.json").write_text(json.dumps(content))
    with pytest.raises(RunError, match=r"gamma was 0\.5 and is 0\.995"):
        plan(["direct-ppo"], [0], tmp_path)
    assert len(plan(["direct-ppo", "direct-ppo"], [1, 1], tmp_path)) == 1


def test_a_run_that_fails_does_not_stop_the_others(tmp_path, monkeypatch):
    def train(run):
        lines = "steps,seconds,mean_speed_cm_s,failed,score_cm_s\n512,1.5,9.0,0.25,8.0\n2048,1.5,7.0,0.0,7.0\n"
        return bool((run / "evaluations.csv").write_text(lines))

    monkeypatch.setattr("agents.training.loop.train", train)
    jobs = [job(tmp_path, 0, gamma=2.0), job(tmp_path, 1)]
    failures = train_all(jobs, 1)
    assert (
        list(failures) == [jobs[0]]
        and "gamma must be a number in [0, 1], got 2.0" in failures[jobs[0]]
    )
    assert jobs[1].finished and not jobs[0].finished
    assert (
        " ".join(results_table(jobs).splitlines()[-1].split())
        == "tiny/seed-1 2,048 512 9.00 cm/s, failed 25.0%"
    )
    assert "Traceback" in jobs[0].run.with_name("seed-0.log").read_text()
    # A finished run is not trained again.
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    assert (
        train_all(jobs[1:], 1) == {}
        and {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
    )


def test_an_interrupt_ends_a_study_after_the_present_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "agents.training.loop.train", lambda run: signal.raise_signal(signal.SIGINT)
    )
    jobs = [job(tmp_path, seed) for seed in range(2)]
    with pytest.raises(KeyboardInterrupt):
        train_all(jobs, 1)
    assert jobs[0].run.exists() and not jobs[1].run.exists()


def test_a_killed_worker_is_a_failure_of_the_unfinished_runs(tmp_path, monkeypatch):
    jobs = [job(tmp_path, seed) for seed in range(2)]

    def killed(self, tasks):
        next(iter(tasks))
        jobs[0].run.mkdir(parents=True)
        (jobs[0].run / FINISHED).write_text("{}")
        raise RuntimeError("a worker was killed\nand more")

    monkeypatch.setattr("joblib.Parallel.__call__", killed)
    failures = train_all(jobs, 1)
    assert list(failures) == [jobs[1]] and failures[jobs[1]].startswith(
        "RuntimeError: a worker was killed"
    )


def test_a_lost_node_of_a_ray_cluster_loses_no_run(tmp_path, monkeypatch):
    cluster_utils = pytest.importorskip("ray.cluster_utils")
    # A busy machine starts nodes slowly.
    monkeypatch.setenv("RAY_raylet_start_wait_time_s", "300")
    cluster = cluster_utils.Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
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
        assert train_all([whole], 1) == {} and differences(each.run, whole.run) == []


@pytest.fixture
def finished(tmp_path):
    made = job(tmp_path / "runs", seed=3)
    write_run(made.run / "best", 3)
    content = {
        "task": "direct",
        "algo": "ppo",
        "hyperparameters": made.config.to_dict(),
        "revision": "0123456789ab",
    }
    (made.run / "config.json").write_text(json.dumps(content))
    (made.run / "evaluations.csv").write_text("steps,seconds\n")
    (made.run / FINISHED).write_text("{}")
    return made


def test_the_best_policy_and_the_evaluations_are_published(finished, tmp_path):
    checkpoints = tmp_path / "checkpoints"
    folder = copy_policy(finished, checkpoints)
    assert folder == checkpoints / "tiny" / "seed-3"
    assert sorted(path.name for path in folder.iterdir()) == [
        "evaluations.csv",
        "policy.safetensors",
    ]
    assert (checkpoints / "tiny" / "config.json").read_bytes() == (
        finished.run / "config.json"
    ).read_bytes()
    policy = (finished.run / "best" / "policy.safetensors").read_bytes()
    # Existing files are replaced.
    (folder / "policy.safetensors").write_bytes(b"")
    copy_policy(finished, checkpoints)
    assert (folder / "policy.safetensors").read_bytes() == policy


@pytest.mark.parametrize("revision", ["0123456789ab+", "unknown"])
def test_a_revision_that_cannot_be_checked_out_is_not_published(finished, tmp_path, revision):
    path = finished.run / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "revision": revision}))
    with pytest.raises(
        RunError, match=f"committed code, got the revision {re.escape(repr(revision))}"
    ):
        copy_policy(finished, tmp_path / "checkpoints")
    (finished.run / FINISHED).unlink()
    with pytest.raises(RunError, match="not finished"):
        copy_policy(finished, tmp_path / "checkpoints")
    assert not (tmp_path / "checkpoints").exists()


@pytest.mark.parametrize(
    ("error", "status", "said"), [(None, 1, "failed: lost"), (KeyboardInterrupt, 130, "--resume")]
)
def test_failures_and_ctrl_c_have_their_exit_status(
    tmp_path, monkeypatch, capsys, error, status, said
):
    def train(jobs, parallel, backend):
        assert (len(jobs), parallel, backend) == (2, 3, "loky")
        if error:
            raise error
        return {jobs[0]: "lost"}

    monkeypatch.setattr("agents.study.train_all", train)
    revisions = iter("0123456789ab 0123456789ab+ 0123456789ab 0123456789ab".split())
    monkeypatch.setattr("agents.training.checkpoint.git_revision", lambda _: next(revisions))
    words = ["direct-ppo", "--seeds", "0", "1", "--jobs", "3", "--runs", str(tmp_path), "--publish"]
    # Before the training.
    with pytest.raises(SystemExit, match="2"):
        main(words)
    assert (
        "--publish needs runs of committed code, got the revision '0123456789ab+' of"
        in capsys.readouterr().err
    )
    assert main(words) == status
    assert said in "".join(capsys.readouterr())
