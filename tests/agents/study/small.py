"""Runs of a second; `python -m tests.agents.study.small` is `agents.study` with a row that has no end."""

from __future__ import annotations

from pathlib import Path

from agents.study.__main__ import main
from agents.study.jobs import Job
from agents.study.study import leave
from agents.training.presets import ROWS
from tests.agents.training.small import small

STEPS = 2048
SETTINGS = {"total_steps": STEPS, "evaluate_every": 512}


def job(folder: Path, seed: int = 0, **changes) -> Job:
    config = small("direct", "ppo", seed=seed, **{**SETTINGS, **changes})
    return Job("tiny", config, folder / "tiny" / f"seed-{seed}")


if __name__ == "__main__":
    ROWS["endless"] = small("direct", "ppo", **{**SETTINGS, "total_steps": 10_000_000})
    leave(main)
