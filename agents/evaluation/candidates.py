"""Finds what can be evaluated by name: scripted policies, checkpoints, and runs by their path."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.evaluation.episodes import Episode, Policy, evaluate
from agents.evaluation.sets import EvaluationSet
from agents.training.presets import CONFIG, MODEL, NORMALISATION
from baselines.policies import SCRIPTED
from capsule_gym.task import HORIZON, TORQUE_LIMIT

# The paper's controller, which everything else is compared with.
BASELINE = "adaptive"
CHECKPOINTS = Path(__file__).parents[1] / "checkpoints"
POLICY_FILES = (CONFIG, MODEL, NORMALISATION)


@dataclass(frozen=True)
class Run:
    """One policy that acts: a scripted one, or one training run.

    Attributes:
        name: of the candidate it belongs to.
        path: the run's folder or an archive inside it; None for a scripted policy.
        training_seed: None for a scripted policy.
        revision: the git revision it was trained at; None for a scripted policy.
    """

    name: str
    path: Path | None = None
    training_seed: int | None = None
    revision: str | None = None

    def load(self) -> Policy:
        """The policy itself."""
        if self.path is None:
            return SCRIPTED[self.name]
        # Imports torch, which takes seconds that scripted policies need not pay.
        from agents.training.runs import load_policy

        return load_policy(self.path)

    def evaluate(self, evaluation_set: EvaluationSet, horizon: float = HORIZON) -> list[Episode]:
        """Runs the policy on a set; the episodes of a training run carry its `training_seed`."""
        episodes = evaluate(self.load(), evaluation_set, horizon=horizon)
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


def _read_config(run: Path) -> dict[str, Any]:
    """The config.json of a run, given by its folder or an archive in it, after a check of the fields that matter."""
    # An archive may lie one folder deeper, as in best/model.zip.
    folders = [run] if run.is_dir() else [run.parent, run.absolute().parent.parent]
    path = next((folder / CONFIG for folder in folders if (folder / CONFIG).is_file()), None)
    if path is None:
        raise ValueError(f"{run} is not part of a training run: there is no {folders[0] / CONFIG}")
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is not JSON: {error}") from error
    if not isinstance(config, dict):
        raise ValueError(f"{path} must hold an object, got {config!r}")
    for field, kind, accepted in (
        ("algo", str, "a string"),
        ("env", dict, "an object"),
        ("seed", int, "an integer"),
        ("revision", str, "a string"),
    ):
        if not isinstance(config.get(field), kind):
            raise ValueError(f'{path} must hold "{field}", {accepted}, got {config.get(field)!r}')
    return config


def _describe(config: dict[str, Any]) -> str:
    """What a run was trained as, from its config.json."""
    env = config["env"]
    action = "the whole torque"
    if env.get("controller"):
        limit = env.get("residual_limit") or env.get("torque_limit", TORQUE_LIMIT)
        action = f"a residual torque of up to {limit:g} N m on `{env['controller']}`"
    return f"{config['algo'].upper()}, {action}, trained with randomization {env.get('randomization', 'paper')}"


def _candidate(name: str, folder: Path, paths: Sequence[Path]) -> Candidate:
    """A trained policy from the paths of its runs."""
    configs = [_read_config(path) for path in paths]
    runs = [Run(name, path, config["seed"], config["revision"]) for path, config in zip(paths, configs, strict=True)]
    seeds = [config["seed"] for config in configs]
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"{folder} must hold runs of different training seeds, got {seeds}")
    descriptions = dict.fromkeys(_describe(config) for config in configs)
    if len(descriptions) > 1:
        raise ValueError(f"{folder} must hold runs of one kind, got: {'; '.join(descriptions)}")
    in_order = sorted(range(len(runs)), key=seeds.__getitem__)
    return Candidate(name, tuple(runs[i] for i in in_order), next(iter(descriptions)), folder)


def _all_seeds(name: str, folder: Path) -> Candidate:
    """A folder with the runs seed-0, seed-1, .. inside."""
    paths = [path for path in sorted(folder.glob("seed-*")) if path.is_dir()]
    if not paths:
        raise ValueError(f"{folder} is no checkpoint: it holds no folder seed-0, seed-1, ..")
    return _candidate(name, folder, paths)


def _scripted(name: str) -> Candidate:
    return Candidate(name, (Run(name),), SCRIPTED[name].description)


def checkpoint_names() -> list[str]:
    """The names of the committed checkpoints."""
    return sorted(path.name for path in CHECKPOINTS.glob("*") if path.is_dir()) if CHECKPOINTS.is_dir() else []


def all_candidates() -> list[Candidate]:
    """Everything that the leaderboard lists: scripted policies, then checkpoints.

    Raises:
        ValueError: if a checkpoint is incomplete, has the name of a scripted policy, or has another torque limit than
            the scripted policies.
    """
    checkpoints = checkpoint_names()
    for name in checkpoints:
        if name in SCRIPTED:
            raise ValueError(f"{CHECKPOINTS / name} must not have the name of a scripted policy, got {name!r}")
        for path in sorted((CHECKPOINTS / name).glob("seed-*")):
            limit = _read_config(path)["env"].get("torque_limit", TORQUE_LIMIT)
            if limit != TORQUE_LIMIT:
                raise ValueError(
                    f"{path} must act under a torque_limit of {TORQUE_LIMIT} N m as all others, got {limit}"
                )
    return [_scripted(name) for name in SCRIPTED] + [_all_seeds(name, CHECKPOINTS / name) for name in checkpoints]


def find_candidate(name_or_path: str) -> Candidate:
    """Finds a policy.

    Args:
        name_or_path: a scripted policy; a checkpoint in agents/checkpoints, which means all its training seeds; the
            path of a folder with runs seed-0, seed-1, .. inside; the path of one run's folder, or of a .zip in it.

    Raises:
        ValueError: if there is no such policy, or its folder is incomplete.
    """
    if name_or_path in SCRIPTED:
        return _scripted(name_or_path)
    if name_or_path in checkpoint_names():
        return _all_seeds(name_or_path, CHECKPOINTS / name_or_path)
    path = Path(name_or_path)
    is_archive = path.suffix == ".zip" and path.is_file()
    if is_archive or (path / CONFIG).is_file():
        return _candidate(name_or_path, path, [path])
    if path.is_dir():
        return _all_seeds(name_or_path, path)
    raise ValueError(
        f"policy must be a scripted policy ({_listed(list(SCRIPTED))}), a checkpoint "
        f"({_listed(checkpoint_names())}), or the path of a run's folder or of a .zip in one, got {name_or_path!r}"
    )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "there is none"
