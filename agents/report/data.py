"""Data of a report: episodes of its policies, their learning curves and the settings of runs."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from agents.analysis.data import Learning, Results, gather, read_evaluations, read_learning
from agents.evaluation import policies as evaluation_policies
from agents.evaluation.policies import BASELINE, Candidate, all_candidates, find_candidate
from agents.leaderboard.page import build
from agents.leaderboard.rows import RESULTS, Row, evaluate_run, load_row, make_row, path_of
from agents.training.presets import BEST, CONFIG, EVALUATIONS, MODEL
from capsule_gym.evaluation_sets import SET_NAMES, load_set
from capsule_gym.policy import POLICY, Policy
from capsule_gym.task import HORIZON

ROOT = Path(__file__).resolve().parents[2]


@dataclass(eq=False)
class Data:
    """What a report shows; everything but the first two is of the runs that are not on the leaderboard.

    Attributes:
        results: the rows, the paper's controller among them, with their sets and learning curves.
        summaries: the entries of leaderboard.json, by row and set.
        configs: contents of config.json, by the row's name.
        policies: the trained policy with the lowest seed, by the row's name.
    """

    results: Results
    summaries: dict[str, dict[str, Any]]
    configs: dict[str, dict[str, Any]] = field(default_factory=dict)
    policies: dict[str, Policy] = field(default_factory=dict)

    @property
    def subjects(self) -> list[Row]:
        """The rows that the report is about: all but the paper's controller, unless there is no other."""
        return [row for row in self.results.rows if row.name != BASELINE] or list(self.results.rows)


def collect(names: Sequence[str], *, trust_controller: bool = False) -> Data:
    """Reads the rows of the leaderboard, and evaluates other runs.

    Args:
        names: rows of the leaderboard, or paths of runs, of folders with runs seed-0, seed-1, .. inside, or of policy
            files; none means all rows.
        trust_controller: as for `capsule_gym.load_policy`.

    Raises:
        OSError: if a file cannot be read.
        ValueError: if there is no such policy, two have one name, or a file is broken.
    """
    board = json.loads((ROOT / "leaderboard.json").read_text(encoding="utf-8"))
    published = {row["policy"]: row["results"] for row in board["rows"]}
    sets = [load_set(name) for name in SET_NAMES]
    rows: list[Row] = []
    curves: dict[str, Learning] = {}
    configs: dict[str, dict[str, Any]] = {}
    policies: dict[str, Policy] = {}
    for name in dict.fromkeys([*(names or [each.name for each in all_candidates()]), BASELINE]):
        if name in published:
            rows.append(load_row(path_of(ROOT / RESULTS, name)))
            continue
        path, candidate = Path(name), _candidate(name, trust_controller)
        row = make_row(candidate, sets, [evaluate_run(policy, sets, HORIZON) for policy in candidate.policies], {})
        # A recurrent policy has no file that says its seed.
        seeds = row.header["training_seeds"] or list(range(len(candidate.policies)))
        rows.append(replace(row, header={**row.header, "training_seeds": seeds}))
        if isinstance(policy := candidate.policies[0], Policy):
            policies[row.name] = policy
        one = path / EVALUATIONS
        learning = Learning({0: read_evaluations(one)}) if one.is_file() else read_learning(path)
        if learning.seeds:
            curves[row.name] = learning
        if (path / CONFIG).is_file():
            configs[row.name] = json.loads((path / CONFIG).read_text(encoding="utf-8"))
    twins = [name for name, count in Counter(row.name for row in rows).items() if count > 1]
    if twins:
        raise ValueError(f"policies of a report must have different names, got {', '.join(twins)} more than once")
    results = gather(rows, sets, evaluation_policies.CHECKPOINTS)
    own = build([row for row in rows if row.name not in published], sets)
    summaries = published | {row["policy"]: row["results"] for row in own["rows"]}
    return Data(replace(results, learning=results.learning | curves), summaries, configs, policies)


def _candidate(name: str, trust_controller: bool) -> Candidate:
    """A policy, named by the last part of its path."""
    path = Path(name)
    if (path / BEST / MODEL).is_file() and not (path / BEST / POLICY).is_file():
        # Imports torch, which takes seconds.
        from agents.training.export import load_best

        return Candidate(path.name, (load_best(path),), "a recurrent agent")
    return replace(find_candidate(name, trust_controller=trust_controller), name=path.resolve().name)
