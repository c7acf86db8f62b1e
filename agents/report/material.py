"""What a report is made of: the episodes of its policies, their learning curves, and what runs were told."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from agents.evaluation import policies as evaluation_policies
from agents.evaluation.policies import BASELINE, Candidate, all_candidates, find_candidate
from agents.evaluation.statistics import estimate
from agents.evidence.material import SPEED, Evidence, Learning, gather, read_evaluations, read_learning
from agents.leaderboard.page import RANKING_SET, build
from agents.leaderboard.rows import RESULTS, Row, evaluate_run, load_row, make_row, path_of
from agents.training.presets import BEST, CONFIG, EVALUATIONS, MODEL
from capsule_gym.evaluation_sets import SET_NAMES, EvaluationSet, load_set
from capsule_gym.policy import POLICY, Policy
from capsule_gym.task import HORIZON

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, eq=False)
class Material:
    """What a report shows.

    Attributes:
        evidence: the rows, the paper's controller among them, with their sets and learning curves.
        summaries: by row and set what leaderboard.json says of them.
        configs: the content of config.json, by the name of each row that is a run of one's own.
        policies: the trained policy with the lowest seed, by the name of each row that is a run of one's own.
    """

    evidence: Evidence
    summaries: dict[str, dict[str, Any]]
    configs: dict[str, dict[str, Any]]
    policies: dict[str, Policy]

    @property
    def subjects(self) -> list[Row]:
        """The rows that the report is about: all but the paper's controller, unless there is no other."""
        others = [row for row in self.evidence.rows if row.name != BASELINE]
        return others or list(self.evidence.rows)


def collect(names: Sequence[str], *, trust_controller: bool = False, root: Path = ROOT) -> Material:
    """Gathers what there is to say of some policies; runs of one's own are evaluated, rows of the leaderboard are read.

    Args:
        names: rows of the leaderboard, or paths of runs, of folders with runs seed-0, seed-1, .. inside, or of policy
            files; none means all rows.
        trust_controller: as for `capsule_gym.load_policy`.
        root: the folder of leaderboard.json and of the results.

    Raises:
        OSError: if a file cannot be read.
        ValueError: if there is no such policy, two have one name, or a file is not what it should be.
    """
    published = {row["policy"]: row["results"] for row in _leaderboard(root)["rows"]}
    sets = [load_set(name) for name in SET_NAMES]
    rows: list[Row] = []
    curves: dict[str, Learning] = {}
    configs: dict[str, dict[str, Any]] = {}
    policies: dict[str, Policy] = {}
    for name in dict.fromkeys([*(names or [each.name for each in all_candidates()]), BASELINE]):
        if name in published:
            rows.append(load_row(path_of(root / RESULTS, name)))
            continue
        path = Path(name)
        candidate = _candidate(name, trust_controller)
        rows.append(evaluated(candidate, sets))
        if isinstance(policy := candidate.policies[0], Policy):
            policies[candidate.name] = policy
        curves[rows[-1].name] = _learning(path)
        if (path / CONFIG).is_file():
            configs[rows[-1].name] = json.loads((path / CONFIG).read_text(encoding="utf-8"))
    _refuse_twins(rows)
    evidence = gather(rows, sets, evaluation_policies.CHECKPOINTS)
    learning = evidence.learning | {name: each for name, each in curves.items() if each.seeds}
    own = build([row for row in rows if row.name not in published], sets)
    summaries = published | {row["policy"]: row["results"] for row in own["rows"]}
    return Material(replace(evidence, learning=learning), summaries, configs, policies)


def _leaderboard(root: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((root / "leaderboard.json").read_text(encoding="utf-8"))
    return content


def _refuse_twins(rows: Sequence[Row]) -> None:
    names = [row.name for row in rows]
    twins = sorted({name for name in names if names.count(name) > 1})
    if twins:
        raise ValueError(f"policies of a report must have different names, got {', '.join(twins)} more than once")


def _candidate(name: str, trust_controller: bool) -> Candidate:
    """A policy by the last part of its path."""
    path = Path(name)
    if (path / BEST / MODEL).is_file() and not (path / BEST / POLICY).is_file():
        # Imports torch, which takes seconds.
        from agents.training.recurrent import load_best

        return Candidate(path.name, (load_best(path),), "an agent with a memory")
    found = find_candidate(name, trust_controller=trust_controller)
    return replace(found, name=path.resolve().name)


def evaluated(candidate: Candidate, sets: Sequence[EvaluationSet]) -> Row:
    """The row of a policy that is not on the leaderboard."""
    row = make_row(candidate, sets, [evaluate_run(policy, sets, HORIZON) for policy in candidate.policies], {})
    # A policy with a memory has no file that says its seed.
    seeds = row.header["training_seeds"] or list(range(len(candidate.policies)))
    return replace(row, header={**row.header, "training_seeds": seeds})


def _learning(path: Path) -> Learning:
    """The evaluations of a run, or of the runs in a folder."""
    if not (path / EVALUATIONS).is_file():
        return read_learning(path)
    return Learning({0: read_evaluations(path / EVALUATIONS)})


def fastest(rows: Sequence[Row]) -> Row:
    """The row that is fastest on the ranking set."""
    return max(rows, key=lambda row: estimate(row.score(RANKING_SET, SPEED)).value)
