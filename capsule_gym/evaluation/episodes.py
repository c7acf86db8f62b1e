"""Evaluates policies on evaluation sets, and summarises their episodes for results and tables."""

import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from capsule_gym.checks import check_number, require
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.contract import draw_plant
from capsule_gym.envs.resets import random_stream
from capsule_gym.envs.vector_env import CapsuleVectorEnv
from capsule_gym.evaluation.candidates import AnyPolicy, Candidate, find_candidate, wrap_policy
from capsule_gym.evaluation.optimum import PlantGrid, find_grid, optimal_speed
from capsule_gym.evaluation.sets import EvaluationSet, PlantSpec, batch_options, load_set
from capsule_gym.evaluation.statistics import estimate
from capsule_gym.parameters import CONSTANTS, NOMINAL, Capsule, Disturbances, Randomization
from capsule_gym.parameters.limits import LONGEST_STEP
from capsule_gym.policies.policy import Policy
from capsule_gym.policies.rollout import rollout
from capsule_gym.policies.scripted import ScriptedPolicy
from capsule_gym.tasks.registry import find_task
from capsule_gym.tasks.task import CONTROL_DT, START_THETA, TORQUE_LIMIT

Episode = dict[str, Any]

# Fields of an episode that are not metrics.
LABELS = ("M", "mu", "seed", "theta", "goal", "changes", "capsule", "training_seed")
PACKAGES = ("numpy", "gymnasium", "stable-baselines3", "torch")


@dataclass(frozen=True)
class TableMetric:
    """The format of a metric in tables.

    Attributes:
        name: name of the metric in results.
        label: name in tables, with the unit.
        digits: number of decimals.
        share: whether the metric is a share of the episodes. Its mean is not trimmed, which would
            hide a few misses.
    """

    name: str
    label: str
    digits: int
    share: bool = False

    def format(self, value: float | None, *, sign: bool = False) -> str:
        """Formats a number.

        An infinite or undefined number, which means no forward progress, gives a dash.
        """
        if value is None or not math.isfinite(value):
            return "-"
        text = f"{value:{'+' if sign else ''}.{self.digits}f}"
        # No sign in front of zero.
        return text.replace("-", "") if float(text) == 0.0 else text

    def with_interval(self, values: Iterable[float | None], *, sign: bool = False) -> str:
        """Formats a value and the ends of its interval as `value [low, high]`.

        Without an interval, the text is `value`.
        """
        value, low, high = (self.format(each, sign=sign) for each in values)
        return value if low == high == "-" else f"{value} [{low},\N{NO-BREAK SPACE}{high}]"


_SHOWN = (
    TableMetric("mean_speed", "mean speed (cm/s)", 2),
    TableMetric("cost_of_transport", "cost of transport", 2),
    TableMetric("peak_torque", "peak torque (N m)", 3),
    TableMetric("rms_torque", "rms torque (N m)", 3),
    TableMetric("backward_ratio", "backward / forward travel", 3),
    TableMetric("stuck_fraction", "fraction of time stuck", 3),
)
TABLE_METRICS = {metric.name: metric for metric in _SHOWN}
# Metrics of the other tasks.
TASK_METRICS = (
    TableMetric("success", "share of goals reached", 4, share=True),
    TableMetric("goal_time", "time to the goal (s)", 2),
    TableMetric("velocity_error", "error of the mean velocity (%)", 2),
    TableMetric("unsettled", "share of commands never settled", 4, share=True),
)
SHARES = [metric.name for metric in TASK_METRICS if metric.share]
# Mean speed divided by the optimal speed of the episode's plant, on sets that the table of optima
# covers.
SHARE_OF_OPTIMUM = TableMetric("share_of_optimum", "share of optimum", 2)


def validation_set(
    randomization: str | Randomization,
    name: str,
    first_seed: int,
    count: int,
    capsule: Capsule | None = None,
    task: str = "speed",
    disturbances: str | Disturbances = "none",
) -> EvaluationSet:
    """Draws a set of plants as the environment draws the plants of its episodes.

    Args:
        randomization: distribution of the environment's plants.
        name: name of the set.
        first_seed: seed of the first episode; the others follow. Far from 0, 1, .., the seeds of
            the frozen sets.
        count: number of plants.
        capsule: constants of the environment's plant.
        task: task of the environment; its further draws follow from the episodes' seeds.
        disturbances: disturbances of the environment.
    """
    ranges = Randomization.named(randomization)
    plants = []
    for seed in range(first_seed, first_seed + count):
        M, mu = draw_plant(ranges, capsule or NOMINAL, random_stream(seed, 0, "parameters"))
        shares = random_stream(seed, 0, "variation").random(len(CONSTANTS))
        drawn = {}
        for constant in ranges.drawn:
            low, high = getattr(ranges, constant)
            share = float(shares[CONSTANTS.index(constant)])
            drawn[constant] = low + (high - low) * share
        plants.append(PlantSpec(M, mu, seed, capsule=drawn or None))
    return EvaluationSet(name, tuple(plants), task, capsule, disturbances)


def drawn_like(set_name: str, first_seed: int, count: int) -> EvaluationSet:
    """Draws other plants from the distribution of a frozen set of the speed task.

    Args:
        set_name: name of the frozen set, which is also that of its distribution.
        first_seed: seed of the first episode; the others follow.
        count: number of plants.
    """
    like = load_set(set_name)
    return validation_set(
        set_name,
        f"plants drawn as those of {set_name}",
        first_seed,
        count,
        like.capsule,
        disturbances=like.disturbances,
    )


def drawn_from(
    env_kwargs: Mapping[str, Any], name: str, first_seed: int, count: int
) -> EvaluationSet:
    """Draws a set of plants as an environment with these arguments draws those of its episodes.

    Args:
        env_kwargs: arguments of the environment.
        name: name of the set.
        first_seed: seed of the first episode; the others follow.
        count: number of plants.
    """
    options = EnvConfig(**env_kwargs)
    return validation_set(
        options.randomization,
        name,
        first_seed,
        count,
        options.capsule,
        find_task(options.task).name,
        options.disturbances,
    )


def evaluate(
    policy: Any,
    evaluation_set: EvaluationSet | str | Path = "paper",
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    horizon: float | None = None,
) -> list[Episode]:
    """Runs a policy once on every plant of a set, all plants at once, each from rest.

    A trained policy runs inside the core (`rollout`). Any other policy is called at every step.

    Args:
        policy: as for `wrap_policy`; or a candidate, or a name or path as for `find_candidate`, of
            which all training seeds are evaluated, one after the other.
        evaluation_set: a set, the name of a frozen one, or the path of one.
        env_kwargs: as for `wrap_policy`, without what the set determines: plants and disturbances.
        horizon: length of an episode in s; None takes that of the set's task.

    Returns:
        One dict per plant, in order: the fields of the plant, the metrics of all tasks (`METRICS`)
        and of this one, `share_of_optimum` on a set that the table of optima covers, and
        `training_seed` for a trained policy.

    Raises:
        TypeError: if the policy is of another type.
        ValueError: if the policy or set does not exist, their tasks differ, or the policy's actions
            are invalid.
    """
    chosen = evaluation_set
    if not isinstance(chosen, EvaluationSet):
        chosen = load_set(chosen)
    if env_kwargs is not None:
        _check_env_kwargs(env_kwargs, policy, chosen)
    if isinstance(policy, (str, Path)):
        policy = find_candidate(str(policy))
    if isinstance(policy, Candidate):
        check_task(policy, chosen)
        return [
            episode for run in policy.policies for episode in evaluate(run, chosen, horizon=horizon)
        ]
    policy = wrap_policy(policy, env_kwargs=env_kwargs)
    check_task(Candidate(policy.name, (policy,), ""), chosen)
    settings = {**policy.env_kwargs, **chosen.env_kwargs}
    control_dt = EnvConfig(control_dt=settings.get("control_dt", CONTROL_DT)).control_dt
    seconds = chosen.horizon
    if horizon is not None:
        accepted = f"a number from {control_dt:g} to {LONGEST_STEP:g} (s)"
        seconds = check_number("horizon", horizon, accepted, control_dt, LONGEST_STEP)
    steps = round(seconds / control_dt)
    settings["num_envs"] = len(chosen.plants)
    settings["max_episode_steps"] = steps
    settings["autoreset_mode"] = AutoresetMode.DISABLED
    env = CapsuleVectorEnv(**settings)
    try:
        metrics = _run(env, policy, chosen.plants, steps)
    finally:
        env.close()
    limited = settings.get("torque_limit", TORQUE_LIMIT) == TORQUE_LIMIT
    seed = policy.training_seed if isinstance(policy, Policy) else None
    return as_episodes(chosen, metrics, training_seed=seed, shared=limited)


def _check_env_kwargs(env_kwargs: Any, policy: Any, chosen: EvaluationSet) -> None:
    """Checks arguments of the environment that the caller gives."""
    if isinstance(policy, (str, Path, Candidate)):
        raise TypeError(
            "env_kwargs must not be given with a policy's name or path or a candidate, which has "
            "its own"
        )
    require(isinstance(env_kwargs, Mapping), "env_kwargs", "None or a dict", env_kwargs, TypeError)
    determined = {*chosen.env_kwargs, "num_envs", "max_episode_steps", "autoreset_mode"}
    # The task of a policy is compared with that of the set.
    determined.remove("task")
    for name in determined.intersection(env_kwargs):
        raise ValueError(
            f"env_kwargs must not contain {name!r}, which the set {chosen.name!r} determines"
        )


def _run(
    env: CapsuleVectorEnv, policy: AnyPolicy, plants: Sequence[PlantSpec], steps: int
) -> dict[str, np.ndarray]:
    """The metrics of an episode on each plant."""
    seeds = [plant.seed for plant in plants]
    observations, _ = env.reset(seed=seeds, options=batch_options(plants))
    if isinstance(policy, Policy):
        return rollout(env.simulation, policy, steps)
    act = policy.start(seeds)
    for _ in range(steps):
        # An environment whose episode has ended ignores its actions.
        observations, _, terminated, truncated, _ = env.step(act(observations))
        if (terminated | truncated).all():
            break
    return env.episode_metrics()


def check_task(candidate: Candidate, evaluation_set: EvaluationSet) -> None:
    """Checks that policies are for the task of a set.

    Scripted policies without a task fit any set.

    Raises:
        ValueError: if a policy is for another task.
    """
    for policy in candidate.policies:
        unnamed = evaluation_set.task if isinstance(policy, ScriptedPolicy) else "speed"
        evaluation_set.check_task(policy.env_kwargs.get("task", unnamed), candidate.name)


def as_episodes(
    evaluation_set: EvaluationSet,
    metrics: Mapping[str, np.ndarray],
    *,
    training_seed: int | None = None,
    shared: bool = True,
) -> list[Episode]:
    """Converts metrics by name, each of shape (plants,), to the episodes that `evaluate` returns.

    Args:
        evaluation_set: the set with the plants.
        metrics: as those of `rollout`.
        training_seed: seed of the policy's training run, if any.
        shared: whether the policy acts under the optimum's torque limit, so that its share of the
            optimum is defined.
    """
    plants = evaluation_set.plants
    undisturbed = evaluation_set.env_kwargs["disturbances"] == "none"
    comparable = shared and undisturbed and evaluation_set.task == "speed"
    grid = find_grid(evaluation_set.capsule or NOMINAL) if comparable else None
    # The tables of optima cover only the speed task, one start, the plants of their grids, and
    # constant plants.
    if grid and not all(_is_covered(plant, grid) for plant in plants):
        grid = None
    label = {} if training_seed is None else {"training_seed": training_seed}
    episodes = []
    for i, plant in enumerate(plants):
        values = {name: float(column[i]) for name, column in metrics.items()}
        if grid:
            optimum = optimal_speed(plant.M, plant.mu, grid)
            values[SHARE_OF_OPTIMUM.name] = values["mean_speed"] / optimum
        fields = plant.to_dict()
        if not plant.changes:
            del fields["changes"]
        episodes.append({**fields, **values, **label})
    return episodes


def _is_covered(plant: PlantSpec, grid: PlantGrid) -> bool:
    return plant.theta == START_THETA and not plant.changes and (plant.M, plant.mu) in grid


def scores(episodes: Sequence[Episode], metric: str) -> np.ndarray:
    """The values of a metric in one policy's episodes on one set.

    None, which files contain instead of infinity, becomes infinity.

    Returns:
        Shape (training seeds, episodes of the set).
    """
    runs: dict[Any, list[float]] = {}
    for episode in episodes:
        value = episode[metric]
        run = runs.setdefault(episode.get("training_seed"), [])
        run.append(math.inf if value is None else value)
    sizes = [len(run) for run in runs.values()]
    accepted = "as many for every training seed, and at least one"
    require(len({*sizes}) == 1, "episodes", accepted, sizes)
    return np.array(list(runs.values()), dtype=np.float64)


def failures(episodes: Sequence[Episode]) -> int:
    """Counts the episodes that were terminated."""
    return int(scores(episodes, "failed").sum())


def summarise(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Summarises a policy's episodes on one set.

    Returns:
        For every metric but `failed` the interquartile mean with its interval, `iqm`, `low` and
        `high` (for shares `mean`, `low` and `high`); the mean with its interval, `mean`, `mean_low`
        and `mean_high`; and the mean of each training seed, `seeds`. Further `episodes` and
        `failures` as counts over all training seeds (a trimmed mean would hide a few failures), and
        `training_seeds`, empty for scripted policies.
    """
    failed = failures(episodes)
    summary: dict[str, Any] = {}
    for name in episodes[0]:
        if name in LABELS or name == "failed":
            continue
        values = scores(episodes, name)
        mean = estimate(values, mean=True)
        summary[name] = estimate(values, mean=name in SHARES).to_dict()
        summary[name] |= {
            "mean": mean.value,
            "mean_low": mean.low,
            "mean_high": mean.high,
            "seeds": values.mean(axis=1).tolist(),
        }
    summary["episodes"] = len(episodes)
    summary["failures"] = failed
    seeds = [each["training_seed"] for each in episodes if "training_seed" in each]
    summary["training_seeds"] = list(dict.fromkeys(seeds))
    return summary


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the packages that a result depends on."""
    found = {"capsule_gym": version("capsule-gym"), "python": platform.python_version()}
    for package in PACKAGES:
        # Scripted policies need neither torch nor Stable-Baselines3.
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
