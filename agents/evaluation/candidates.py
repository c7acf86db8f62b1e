"""Finds what can be evaluated by name: scripted policies, checkpoints, and runs by their path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import capsule_gym
from agents.evaluation.episodes import Episode, Policy, evaluate
from agents.evaluation.sets import EvaluationSet
from baselines.policies import SCRIPTED
from capsule_gym.parameters import nearest
from capsule_gym.task import HORIZON, TORQUE_LIMIT

# The paper's controller, which everything else is compared with.
BASELINE = "adaptive"
CHECKPOINTS = Path(__file__).parents[1] / "checkpoints"


@dataclass(frozen=True)
class Run:
    """One policy that acts: a scripted one, or one training run.

    Attributes:
        name: of the candidate it belongs to.
        policy: what acts.
    """

    name: str
    policy: Policy

    @property
    def training_seed(self) -> int | None:
        """None for a scripted policy."""
        return self.policy.training_seed if isinstance(self.policy, capsule_gym.Policy) else None

    @property
    def revision(self) -> str | None:
        """The git revision it was trained at; None for a scripted policy."""
        return self.policy.revision if isinstance(self.policy, capsule_gym.Policy) else None

    def evaluate(self, evaluation_set: EvaluationSet, horizon: float = HORIZON) -> list[Episode]:
        """Runs the policy on a set; the episodes of a training run carry its `training_seed`."""
        episodes = evaluate(self.policy, evaluation_set, horizon=horizon)
        if self.training_seed is None:
            return episodes
        return [{**episode, "training_seed": self.training_seed} for episode in episodes]


@dataclass(frozen=True)
class Candidate:
    """A named policy with all its training seeds.

    Attributes:
        name: as it appears in results.
        runs: one for a scripted policy, else one per training seed in order of the seed.
        description: what it is, in words.
        folder: where the checkpoint lies; None for a scripted policy.
    """

    name: str
    runs: tuple[Run, ...]
    description: str
    folder: Path | None = None

    def evaluate(self, evaluation_set: EvaluationSet, horizon: float = HORIZON) -> list[Episode]:
        """Runs all training seeds on a set, one after the other."""
        return [episode for run in self.runs for episode in run.evaluate(evaluation_set, horizon)]


def _candidate(name: str, folder: Path, paths: Sequence[Path], trust_controller: bool) -> Candidate:
    """A trained policy from the paths of its runs."""
    loaded = [capsule_gym.load_policy(path, trust_controller=trust_controller) for path in paths]
    seeds = [policy.training_seed for policy in loaded]
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"{folder} must hold runs of different training seeds, got {seeds}")
    descriptions = dict.fromkeys(policy.description for policy in loaded)
    if len(descriptions) > 1:
        raise ValueError(f"{folder} must hold runs of one kind, got: {'; '.join(descriptions)}")
    runs = tuple(Run(name, policy) for policy in sorted(loaded, key=lambda policy: policy.training_seed))
    return Candidate(name, runs, next(iter(descriptions)), folder)


def _all_seeds(name: str, folder: Path, trust_controller: bool = False) -> Candidate:
    """A folder with the runs seed-0, seed-1, .. inside."""
    paths = [path for path in sorted(folder.glob("seed-*")) if path.is_dir()]
    if not paths:
        raise ValueError(f"{folder} is no checkpoint: it holds no folder seed-0, seed-1, ..")
    return _candidate(name, folder, paths, trust_controller)


def _scripted(name: str) -> Candidate:
    return Candidate(name, (Run(name, SCRIPTED[name]),), SCRIPTED[name].description)


def checkpoint_names() -> list[str]:
    """The names of the committed checkpoints."""
    return sorted(path.name for path in CHECKPOINTS.glob("*") if path.is_dir()) if CHECKPOINTS.is_dir() else []


def all_candidates() -> list[Candidate]:
    """Everything that the leaderboard lists: scripted policies, then checkpoints.

    Raises:
        ValueError: if a checkpoint is incomplete, has the name of a scripted policy, or has another torque limit than
            the scripted policies.
    """
    found = [_scripted(name) for name in SCRIPTED]
    for name in checkpoint_names():
        if name in SCRIPTED:
            raise ValueError(f"{CHECKPOINTS / name} must not have the name of a scripted policy, got {name!r}")
        found.append(_all_seeds(name, CHECKPOINTS / name))
        for run in found[-1].runs:
            limit = run.policy.env_kwargs.get("torque_limit", TORQUE_LIMIT)
            if limit != TORQUE_LIMIT:
                accepted = f"a torque_limit of {TORQUE_LIMIT} N m as all others"
                raise ValueError(f"{CHECKPOINTS / name} must act under {accepted}, got {limit}")
    return found


def find_candidate(name_or_path: str, *, trust_controller: bool = False) -> Candidate:
    """Finds a policy.

    Args:
        name_or_path: a scripted policy; a checkpoint in agents/checkpoints, which means all its training seeds, or one
            run of it as NAME/seed-0; the path of a folder with runs seed-0, seed-1, .. inside; the path of one run's
            folder, or of a policy file.
        trust_controller: as for `capsule_gym.load_policy`.

    Raises:
        ValueError: if there is no such policy, its folder is incomplete, or it names a law that is not trusted.
    """
    if name_or_path in SCRIPTED:
        return _scripted(name_or_path)
    if name_or_path in checkpoint_names():
        return _all_seeds(name_or_path, CHECKPOINTS / name_or_path)
    # One run of a checkpoint goes by its name as well: residual-ppo/seed-2.
    for path in (Path(name_or_path), CHECKPOINTS / name_or_path):
        if path.is_dir() and any(path.glob("seed-*")):
            return _all_seeds(name_or_path, path, trust_controller)
        if path.exists():
            return _candidate(name_or_path, path, [path], trust_controller)
    raise ValueError(
        f"policy must be a scripted policy ({_listed(list(SCRIPTED))}), a checkpoint "
        f"({_listed(checkpoint_names())}), or the path of a run's folder or of a policy file, got {name_or_path!r}"
        f"{nearest(name_or_path, [*SCRIPTED, *checkpoint_names()])}"
    )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "there is none"
