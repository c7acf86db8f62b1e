import pytest

from agents.evaluation.candidates import Run, all_candidates, checkpoint_names, find_candidate
from tests.agents.fakes import write_run


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
