"""Puts finished runs where the leaderboard finds them."""

from __future__ import annotations

import re
from pathlib import Path

from agents.evaluation.policies import CHECKPOINTS
from agents.study.jobs import Job, refuse_other_settings, revision_of
from agents.training.errors import RunError
from agents.training.presets import BEST, EVALUATIONS
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY


def refuse_revision(run: Path, revision: str) -> None:
    """Refuses a run that was begun at a revision that nobody can check out.

    Args:
        run: its folder.
        revision: as `agents.training.runs.git_revision` gave it.

    Raises:
        RunError: if that was no commit, or had changes on it.
    """
    if not re.fullmatch(r"[0-9a-f]+", revision):
        raise RunError(f"{run} must be begun at a revision with nothing uncommitted, got {revision!r}: train it again")


def publish(job: Job, checkpoints: Path = CHECKPOINTS) -> Path:
    """Copies a run's best policy and its evaluations into the folder of its row and seed.

    Args:
        job: the run.
        checkpoints: the folder of all rows.

    Returns:
        The folder that holds them now.

    Raises:
        RunError: if the run is not finished, has other settings than its row, or was begun at a revision that nobody
            can check out.
    """
    if not job.finished:
        raise RunError(f"{job.run} is not finished")
    refuse_other_settings(job)
    refuse_revision(job.run, revision_of(job.run))
    contents = {name: (job.run / source).read_bytes() for name, source in _SOURCES.items()}
    folder = checkpoints / job.row / f"seed-{job.config.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        write_atomically(folder / name, content)
    return folder


_SOURCES = {EVALUATIONS: EVALUATIONS, POLICY: f"{BEST}/{POLICY}"}
