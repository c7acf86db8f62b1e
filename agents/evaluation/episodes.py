"""Runs policies on evaluation sets and sums their episodes up."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Protocol

import numpy as np
from gymnasium.vector import AutoresetMode

import capsule_gym
from agents.evaluation.sets import EvaluationSet, PlantSpec
from agents.evaluation.statistics import Estimate, estimate, paired_difference
from agents.evaluation.tables import SHARE
from capsule_gym import __version__
from capsule_gym.evaluation_sets import EPISODE_SETTINGS
from capsule_gym.task import CONTROL_DT, HORIZON, START_THETA, TORQUE_LIMIT

Act = Callable[[np.ndarray], np.ndarray]
Episode = dict[str, Any]

# What an episode says beside its metrics.
LABELS = ("M", "mu", "seed", "theta", "changes", "training_seed")
PACKAGES = ("numpy", "numba", "gymnasium", "stable-baselines3", "torch")


class Policy(Protocol):
    """What can be evaluated: scripted policies and trained ones alike.

    Attributes:
        name: as it appears in results.
        env_kwargs: the `CapsuleVectorEnv` that the policy acts in: controller, residual_limit, torque_limit and so on.
            What makes an episode (`EPISODE_SETTINGS`, number and length) is the evaluation's.
    """

    @property
    def name(self) -> str:
        """As it appears in results."""

    @property
    def env_kwargs(self) -> Mapping[str, Any]:
        """The environment that the policy acts in."""

    def start(self, seeds: Sequence[int], /) -> Act:
        """Begins a batch of episodes.

        Args:
            seeds: one per episode, for policies that draw random numbers.

        Returns:
            A function from observations of shape (episodes, entries) to actions of shape (episodes, 1), float32,
            called once per agent step.
        """


def evaluate(policy: Policy, evaluation_set: EvaluationSet, *, horizon: float = HORIZON) -> list[Episode]:
    """Runs a policy once on every plant of a set, all at once, each from rest.

    A trained policy runs in compiled code, `capsule_gym.rollout`; the others are asked at every step.

    Args:
        policy: what acts.
        evaluation_set: the plants.
        horizon: length of an episode in s.

    Returns:
        One dict per plant, in order: M (kg), mu, seed, where it has them theta (rad) and changes, and the metrics of
        `capsule_gym.task.Metrics`; where `has_optimum` says so also `share_of_optimum`, the mean speed over the
        optimum's of the episode's plant.
    """
    settings: dict[str, Any] = {**policy.env_kwargs, **EPISODE_SETTINGS}
    metrics = _run(policy, settings, evaluation_set.plants, round(horizon / settings.get("control_dt", CONTROL_DT)))
    limited = settings.get("torque_limit", TORQUE_LIMIT) == TORQUE_LIMIT
    return as_episodes(evaluation_set, metrics, shared=limited)


def as_episodes(
    evaluation_set: EvaluationSet, metrics: Mapping[str, np.ndarray], *, shared: bool = True
) -> list[Episode]:
    """The episodes of a set as `evaluate` returns them.

    Args:
        evaluation_set: the plants.
        metrics: by name, each of shape (plants,).
        shared: whether a share of the optimum belongs to them, where `has_optimum` says so as well.
    """
    shared = shared and has_optimum(evaluation_set)
    if shared:
        # Here, as in other functions, since numba comes with it, which takes most of a second to import.
        from baselines.optimum import optimal_speed
    episodes = []
    for i, plant in enumerate(evaluation_set.plants):
        values = {name: float(column[i]) for name, column in metrics.items()}
        if shared:
            values[SHARE.metric] = values["mean_speed"] / optimal_speed(plant.M, plant.mu)
        label = plant.to_dict()
        if not plant.changes:
            del label["changes"]
        episodes.append({**label, **values})
    return episodes


def _run(policy: Policy, settings: Mapping[str, Any], plants: Sequence[PlantSpec], steps: int) -> dict[str, np.ndarray]:
    """The metrics of one episode per plant, all run side by side; each of shape (plants,)."""
    seeds = [plant.seed for plant in plants]
    batch = {"num_envs": len(plants), "max_episode_steps": steps, "autoreset_mode": AutoresetMode.DISABLED}
    env = capsule_gym.CapsuleVectorEnv(**{**settings, **batch})
    try:
        observations, _ = env.reset(
            seed=seeds,
            options={
                "M": np.array([plant.M for plant in plants]),
                "mu": np.array([plant.mu for plant in plants]),
                "state": np.array([(plant.theta, 0.0, 0.0, 0.0) for plant in plants]),
                "changes": [[change.to_dict() for change in plant.changes] for plant in plants],
            },
        )
        if isinstance(policy, capsule_gym.Policy):
            from capsule_gym.rollout import rollout

            return rollout(env.simulation, policy, steps)
        act = policy.start(seeds)
        for _ in range(steps):
            observations, _, terminated, truncated, _ = env.step(act(observations))
            if (terminated | truncated).all():
                break
        # Who has ended stands still.
        return env.episode_metrics()
    finally:
        env.close()


def has_optimum(evaluation_set: EvaluationSet) -> bool:
    """Whether all episodes of a set are such as the table of optima holds: its start, its grid, no jumps."""
    from baselines.gaits.archive import in_grid

    return all(
        plant.theta == START_THETA and not plant.changes and in_grid(plant.M, plant.mu)
        for plant in evaluation_set.plants
    )


def scores(episodes: Sequence[Episode], metric: str) -> np.ndarray:
    """The values of a metric, shape (training seeds, episodes of a set).

    Args:
        episodes: of one policy on one set; those of a training seed follow each other.
        metric: its name. None, which stands for infinite in files, becomes infinite again.
    """
    runs: dict[Any, list[float]] = {}
    for episode in episodes:
        value = episode[metric]
        runs.setdefault(episode.get("training_seed"), []).append(float("inf") if value is None else value)
    return np.array(list(runs.values()), dtype=np.float64)


def failures(episodes: Sequence[Episode]) -> int:
    """How many episodes ended before their time."""
    return sum(int(episode["failed"]) for episode in episodes)


def summarise(episodes: Sequence[Episode]) -> dict[str, Any]:
    """The summary of a policy's episodes on one set.

    Returns:
        For every metric but `failed` its interquartile mean with interval, `{"iqm": .., "low": .., "high": ..}`; then
        `episodes` and `failures` as counts over all training seeds (a trimmed mean would hide a few failures),
        `training_seeds` (empty for scripted policies) and `resampled`: "seeds", "episodes" or "nothing".
    """
    names = [name for name in episodes[0] if name not in LABELS and name != "failed"]
    estimates = {name: estimate(scores(episodes, name)) for name in names}
    training_seeds = list(dict.fromkeys(e["training_seed"] for e in episodes if "training_seed" in e))
    return {
        **{name: result.to_dict() for name, result in estimates.items()},
        "episodes": len(episodes),
        "failures": failures(episodes),
        "training_seeds": training_seeds,
        "resampled": estimates[names[0]].resampled,
    }


def difference(episodes: Sequence[Episode], reference: Sequence[Episode], metric: str) -> Estimate:
    """The paired difference of a metric between two policies on the same set; see `paired_difference`."""
    return paired_difference(scores(episodes, metric), scores(reference, metric))


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the packages that a result depends on."""
    found = {"capsule_gym": __version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            # Scripted policies need neither torch nor Stable-Baselines3.
            continue
    return found


def make_result(name: str, evaluation_set: EvaluationSet, episodes: Sequence[Episode]) -> dict[str, Any]:
    """The content of a result file.

    Args:
        name: of the policy.
        evaluation_set: what it ran on.
        episodes: all of them; those of trained policies carry `training_seed`.
    """
    return {
        "policy": name,
        "set": evaluation_set.name,
        "set_hash": evaluation_set.hash,
        "versions": versions(),
        "episodes": list(episodes),
        "summary": summarise(episodes),
    }
