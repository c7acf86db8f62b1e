"""What the runs came to: the episodes of each and its evaluations while it learnt, in one file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import capsule_gym
from agents.authority.design import BASES, Arm, own_plants
from agents.evaluation.episodes import Episode, evaluate, versions
from agents.study.jobs import Job, evaluations, revision_of
from baselines.policies import SCRIPTED
from capsule_gym.files import write_atomically

RESULTS = Path(__file__).with_name("results.json")
DIGITS = 4


@dataclass(frozen=True)
class Run:
    """One agent, or one law alone, on the episodes that all are judged on.

    Attributes:
        arm: what it is.
        seed: of its training; None for a law alone.
        speeds: of the episodes in order, cm/s.
        failed: the numbers of those that failed.
        learning: of its evaluations while it learnt, on draws of its own: steps, mean speed in cm/s, share of failures.
        revision: of the code that it was trained by.
    """

    arm: Arm
    seed: int | None
    speeds: tuple[float, ...]
    failed: tuple[int, ...]
    learning: tuple[tuple[int, float, float], ...] = ()
    revision: str | None = None


@dataclass(frozen=True)
class Results:
    """All of them.

    Attributes:
        steps: of a training run.
        runs: laws alone and agents.
        header: the set's hashes, and the versions of what trained and judged them.
    """

    steps: int
    runs: tuple[Run, ...]
    header: dict[str, Any]

    def arms(self) -> list[Arm]:
        """What there are runs of, each once."""
        return list(dict.fromkeys(run.arm for run in self.runs))

    def of(self, arm: Arm) -> list[Run]:
        """The runs of one kind, in order of their seeds."""
        return sorted((run for run in self.runs if run.arm == arm), key=lambda run: run.seed or 0)

    def speeds(self, arm: Arm) -> np.ndarray:
        """Of a kind's runs, shape (runs, episodes), cm/s."""
        return np.array([run.speeds for run in self.of(arm)])

    def failed(self, arm: Arm) -> np.ndarray:
        """Which of these episodes failed, the same shape, as 0.0 and 1.0."""
        found = np.zeros(self.speeds(arm).shape)
        for line, run in zip(found, self.of(arm), strict=True):
            line[list(run.failed)] = 1.0
        return found


def _judged(arm: Arm, episodes: Sequence[Episode], **more: Any) -> Run:
    speeds = tuple(round(each["mean_speed"], DIGITS) for each in episodes)
    failed = tuple(n for n, each in enumerate(episodes) if each["failed"])
    return Run(arm, speeds=speeds, failed=failed, **more)


def judge(job: Job, arm: Arm) -> Run:
    """Evaluates what a finished run has chosen as its best policy, on draws of its own."""
    found = [(each.steps, each.mean_speed, each.failed) for each in evaluations(job.run)]
    more = {"seed": job.config.seed, "learning": tuple(found), "revision": revision_of(job.run)}
    return _judged(arm, evaluate(capsule_gym.load_policy(job.run), own_plants(arm.plants)), **more)


def laws_alone(arms: Iterable[Arm]) -> list[Run]:
    """Evaluates the laws below these agents by themselves, on the same plants: no authority at all."""
    alone = dict.fromkeys(arm.alone for arm in arms if arm.base)
    return [_judged(arm, evaluate(SCRIPTED[arm.base], own_plants(arm.plants)), seed=None) for arm in alone]


def gather(runs: Iterable[Run], steps: int) -> Results:
    """Puts runs together, with what they rest on."""
    ordered = tuple(runs)
    sets = sorted({run.arm.plants for run in ordered})
    header = {"sets": {name: own_plants(name).hash for name in sets}, "versions": versions()}
    return Results(steps, ordered, header)


def save(results: Results, path: Path = RESULTS) -> None:
    """Writes all runs, one a line."""
    head = json.dumps({"steps": results.steps, **results.header})[:-1]
    lines = ",\n".join(json.dumps(asdict(run), separators=(",", ":")) for run in results.runs)
    write_atomically(path, f'{head}, "runs": [\n{lines}\n]}}\n')


def load(path: Path = RESULTS) -> Results:
    """Reads what `save` wrote.

    Raises:
        ValueError: if there is nothing, it is something else, or it was found on other plants than there are now.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        runs = []
        for each in content.pop("runs"):
            arm = Arm(**each.pop("arm"))
            learning = tuple((int(steps), speed, failed) for steps, speed, failed in each.pop("learning"))
            speeds, failed = tuple(each.pop("speeds")), tuple(each.pop("failed"))
            if arm.base and arm.base not in BASES:
                raise ValueError(f"there is no base {arm.base!r}")
            runs.append(Run(arm, **each, speeds=speeds, failed=failed, learning=learning))
        results = Results(content.pop("steps"), tuple(runs), content)
        hashes = results.header["sets"]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} must be what `python -m agents.authority --publish` writes, got {type(error).__name__}: {error}"
        ) from error
    for name, value in hashes.items():
        if own_plants(name).hash != value:
            raise ValueError(f"{path} holds episodes on other plants of {name} than there are now: train anew")
    return results
