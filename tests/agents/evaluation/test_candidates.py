import numpy as np
import pytest

from agents.evaluation.candidates import all_candidates, checkpoint_names, find_candidate
from tests.agents.fakes import write_run


@pytest.mark.usefixtures("world")
def test_candidates_by_name():
    assert [c.name for c in all_candidates()] == ["adaptive", "bold", "learnt"]
    learnt = find_candidate("learnt")
    assert [run.training_seed for run in learnt.runs] == [2, 10]
    assert learnt.description == "PPO, the whole torque, trained with randomization wide"
    assert find_candidate("bold").runs[0].training_seed is None
    (run,) = find_candidate("learnt/seed-10").runs
    assert (run.name, run.training_seed, run.revision) == ("learnt/seed-10", 10, "0123456789ab")


def test_candidates_by_path(world):
    folder = world / "checkpoints" / "learnt"
    assert [run.training_seed for run in find_candidate(str(folder)).runs] == [2, 10]
    assert find_candidate(str(folder / "seed-2")).runs[0].training_seed == 2
    assert find_candidate(str(folder / "seed-2" / "policy.safetensors")).runs[0].training_seed == 2
    # The best policy of a run counts.
    write_run(folder / "seed-2" / "best", 7)
    assert find_candidate(str(folder / "seed-2")).runs[0].training_seed == 7


def test_unknown_candidates_list_what_exists(world):
    accepted = r"scripted policy \(adaptive, bold\), a checkpoint \(learnt\), .* got 'lernt'"
    with pytest.raises(ValueError, match=accepted):
        find_candidate("lernt")
    (world / "empty").mkdir()
    with pytest.raises(ValueError, match=r"empty is no folder of a training run"):
        find_candidate(str(world / "empty"))
    (world / "model.zip").write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"model\.zip is no policy"):
        find_candidate(str(world / "model.zip"))


def test_malformed_runs_are_refused(world):
    run = world / "checkpoints" / "learnt" / "seed-2"
    (run / "policy.safetensors").write_bytes(b"half")
    with pytest.raises(ValueError, match=r"seed-2.policy\.safetensors is no policy"):
        all_candidates()
    write_run(run, 10)
    with pytest.raises(ValueError, match=r"different training seeds, got \[10, 10\]"):
        all_candidates()
    write_run(run, 2, algorithm="sac")
    with pytest.raises(ValueError, match="runs of one kind"):
        all_candidates()
    for seed in (2, 10):
        write_run(run.with_name(f"seed-{seed}"), seed, env_kwargs={"torque_limit": 1.0})
    with pytest.raises(ValueError, match=r"must act under a torque_limit of 1\.5 N m as all others, got 1\.0"):
        all_candidates()
    (world / "checkpoints" / "learnt").rename(world / "checkpoints" / "bold")
    assert checkpoint_names() == ["bold"]
    with pytest.raises(ValueError, match="must not have the name of a scripted policy, got 'bold'"):
        all_candidates()


def test_a_law_from_elsewhere_needs_consent(world):
    run = world / "stranger"
    ten = {"layers": ((np.zeros((1, 10), np.float32), np.zeros(1, np.float32)),), "mean": np.zeros(10)}
    write_run(run, 0, **ten, variance=np.ones(10), env_kwargs={"controller": "somewhere:law"})
    with pytest.raises(ValueError, match="names the control law 'somewhere:law', which does not come with"):
        find_candidate(str(run))
    assert find_candidate(str(run), trust_controller=True).runs[0].policy.env_kwargs["controller"] == "somewhere:law"
