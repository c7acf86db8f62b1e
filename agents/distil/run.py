"""One run: lessons in which the student leads more and more, a fit after each, and a longer one at the end.

policy.safetensors   the best policy so far, by evaluations on draws of the run's own
finished.json        once the run has come to its end: what `Result` says
"""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from agents.distil.lessons import Classroom, Lesson
from agents.distil.network import Fit, Network
from agents.distil.students import Budget, Student
from agents.evaluation.episodes import evaluate, scores
from agents.evaluation.sets import validation_set
from agents.study.jobs import FINISHED
from agents.training.callbacks import FAILURE_COST
from agents.training.checkpoint import git_revision
from agents.training.signals import Stop
from capsule_gym import Policy
from capsule_gym.evaluation_sets import EvaluationSet
from capsule_gym.files import to_json, write_atomically
from capsule_gym.policy import POLICY

# Seeds of own draws, far from those of other draws and of the frozen sets: to compare policies, and to select the best.
SELECTION_SEED, COMPARED_SEED = 6_000_000, 7_000_000
# The share of the time in which the teacher leads, lesson by lesson, and then none.
SHARES = (1.0, 0.5, 0.3, 0.2, 0.1)
# What is left of the step size at the end of the fit after a lesson.
LEFT = 0.3


@dataclass(frozen=True)
class Result:
    """What a run has come to.

    Attributes:
        mean_speed: of its best policy in the evaluation that chose it, cm/s.
        failed: share of failed episodes in it.
        core_seconds: of processor time that the run took.
        revision: the git revision that it ran at.
    """

    mean_speed: float
    failed: float
    core_seconds: float
    revision: str


def own_draws(student: Student, first_seed: int, count: int) -> EvaluationSet:
    """Plants that are drawn as the student's episodes are."""
    return validation_set(student.randomization, f"own draws from {student.randomization}", first_seed, count)


def plan(budget: Budget) -> list[tuple[float | None, Fit]]:
    """The course of a run: the teacher's share of a lesson, None for no lesson, and the fit after it."""
    rate, size = budget.learning_rate, budget.batch_size
    shares = (*SHARES, *[0.0] * budget.lessons)[: budget.lessons]
    course: list[tuple[float | None, Fit]] = [(share, Fit(budget.updates, rate, LEFT * rate, size)) for share in shares]
    for n in range(budget.parts):
        start, end = (rate * (1.0 - m / budget.parts) for m in (n, n + 1))
        course.append((None, Fit(budget.last_updates // budget.parts, start, end, size)))
    return course


def read_result(folder: Path) -> Result | None:
    """What a run has come to; None where it is not finished."""
    path = folder / FINISHED
    return Result(**json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else None


def judge(policy: Policy, draws: EvaluationSet) -> tuple[float, float]:
    """The mean speed (cm/s) and the share of failed episodes."""
    episodes = evaluate(policy, draws)
    speed, failed = (float(scores(episodes, metric).mean()) for metric in ("mean_speed", "failed"))
    return speed, failed


def distil(name: str, student: Student, seed: int, folder: Path, stop: Stop, budget: Budget) -> Result | None:
    """Teaches a student from its beginning.

    Args:
        name: the student's.
        student: what it meets and sees.
        seed: of everything: on one machine the same seed gives the same policy.
        folder: a new one, for the files above.
        stop: ends the run early; the best policy so far then is in the folder, if there is one.
        budget: how much it takes.

    Returns:
        What it has come to; None where it was stopped.

    Raises:
        FileExistsError: if the folder exists.
    """
    folder.mkdir(parents=True)
    torch.set_num_threads(1)
    began, revision = time.process_time(), git_revision(Path(__file__).parent)
    rng = np.random.default_rng(seed)
    classroom = Classroom(student, budget.num_envs, rng)
    draws = own_draws(student, SELECTION_SEED + seed * budget.episodes, budget.episodes)
    course = plan(budget)
    lessons: list[Lesson] = []
    network: Network | None = None
    policy: Policy | None = None
    best = (-math.inf, 0.0, 0.0)
    with tqdm(
        total=sum(fit.updates for _, fit in course), desc=f"{name}/{folder.name}", file=sys.stderr, disable=None
    ) as bar:

        def report(regret: float) -> bool:
            bar.update()
            return not stop.requested

        for share, fit in course:
            if share is not None:
                act = policy.start(range(budget.num_envs)) if policy else None
                lessons.append(classroom.lesson(budget.steps, share, act, lambda: stop.requested))
            network = network or Network(lessons[0], seed)
            network.fit(lessons, fit, rng, report)
            if stop.requested:
                return None
            policy = network.policy(name, student, seed, revision)
            speed, failed = judge(policy, draws)
            bar.set_postfix_str(f"{speed:.2f} cm/s, {100.0 * failed:.0f} % failed")
            found = (speed - FAILURE_COST * failed, speed, failed)
            if found > best:
                best = found
                policy.save(folder / POLICY)
    result = Result(best[1], best[2], round(time.process_time() - began, 1), revision)
    write_atomically(folder / FINISHED, to_json(asdict(result)))
    return result
