"""The comparison of a trained agent with the paper's controller and its row of the leaderboard."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from agents.analysis.curves import read_evaluations
from agents.criteria import CRITERIA
from agents.evaluate import comparison_table
from agents.leaderboard.rows import RESULTS, load_row
from agents.training.config import EVALUATIONS, Config, read_config
from agents.training.presets import TRAINED_ROWS
from baselines.drawing import BLUE, DPI, MUTED, new_figure, style
from capsule_gym import CapsuleEnv, load_policy
from capsule_gym.evaluation.candidates import AnyPolicy, find_candidate
from capsule_gym.evaluation.episodes import Episode, drawn_from, evaluate, scores
from capsule_gym.evaluation.sets import NOMINAL_PLANT, EvaluationSet, PlantSpec, load_set
from capsule_gym.files import replacing

ROOT = Path(__file__).resolve().parents[1]
# Length of the shown part of angle and torque at the end of an episode, s.
SHOWN = 6.6
# Distance of the middle of a swing from 0, relative to its range, above which a gait is one-sided.
ONE_SIDED = 0.25
SAMPLES = ("t", "theta", "theta_dot", "x", "x_dot", "torque")
# First seed and number of the plants from the ranges of a rig.
RIG_SEED = 24_000_000
RIG_PLANTS = 100
# Settings that a run shares with the row of the leaderboard to which it is compared.
KIND = (
    "env",
    "action_mode",
    "algo",
    "controller",
    "randomization",
    "disturbances",
    "rig",
    "static_ratio",
    "energy_weight",
    "observe_parameters",
    "observe_estimates",
)


def compare(run: Path, set_name: str | None = None) -> None:
    """Compares a run's best model with the baseline on the same frozen episodes.

    Prints the comparison and, if the row of the same kind was evaluated on the set, that row.
    Writes comparison.png to the run's folder. The default set is the task's ranking set, or with an
    identified rig plants that are drawn from its ranges.
    """
    policy = load_policy(run, trust_controller=True)
    config = read_config(run)
    criteria = CRITERIA[config.task]
    if config.rig is not None and set_name is None:
        evaluation_set = rig_plants(config)
        plant = evaluation_set.plants[0]
    else:
        evaluation_set = load_set(set_name or criteria.ranking_set)
        plant = NOMINAL_PLANT if config.task == "speed" else evaluation_set.plants[0]
    (baseline,) = find_candidate(criteria.baseline).policies
    own = evaluate(policy, evaluation_set)
    theirs = evaluate(baseline, evaluation_set)
    episodes = f"{len(own)} episodes of {evaluation_set.horizon:g} s, the same for both"
    print(f"\nOn the set {evaluation_set.name} ({episodes}):\n")
    print(comparison_table("agent", own, criteria.baseline, theirs) + "\n", flush=True)
    recordings = {
        criteria.baseline: run_episode(baseline, plant, evaluation_set),
        "agent": run_episode(policy, plant, evaluation_set),
    }
    if text := compare_to_row(run, own, evaluation_set, recordings["agent"]["theta"]):
        print(text + "\n", flush=True)
    figure = run / "comparison.png"
    draw_comparison(recordings, figure, plant)
    print(f"Figure: {figure}")


def rig_plants(config: Config) -> EvaluationSet:
    """Plants from the ranges of a run's identified rig, with its disturbances."""
    name = "plants from the ranges of the rig"
    return drawn_from(config.env_kwargs(), name, RIG_SEED, RIG_PLANTS)


def compare_to_row(
    run: Path, own: Sequence[Episode], evaluation_set: EvaluationSet, theta: np.ndarray
) -> str:
    """Compares a run with the row of the same kind; names one likely reason if it is worse.

    Args:
        run: the run's folder.
        own: the episodes of its best policy on the set.
        evaluation_set: the set.
        theta: angle in an episode of that policy, rad.

    Returns:
        The comparison; empty if there is no such row, or the row was not evaluated on the set.
    """
    config = read_config(run)
    name = _row_of_kind(config)
    if name is None:
        return ""
    try:
        row = load_row(ROOT / RESULTS / f"{name}.npz")
        row.check_set(evaluation_set)
    except ValueError:
        return ""
    criteria = CRITERIA[evaluation_set.task]
    metric = criteria.metric.name
    sign = -1.0 if criteria.ascending else 1.0
    seeds = {each: row.score(evaluation_set.name, each).mean(axis=-1) for each in criteria.weights}
    worst_seed = int(np.argmin(sign * seeds[metric]))
    worst = {each: float(means[worst_seed]) for each, means in seeds.items()}
    mean = {each: float(means.mean()) for each, means in seeds.items()}
    found = {each: float(scores(own, each).mean()) for each in criteria.weights}
    text = (
        f"Published row {name}: mean of {len(seeds[metric])} seeds {criteria.describe(mean)}; "
        f"worst seed {criteria.describe(worst)}. This run: {criteria.describe(found)}."
    )
    if sign * found[metric] >= sign * worst[metric]:
        return text
    more_failures = found["failed"] > seeds["failed"].max()
    reason = _likely_reason(config, TRAINED_ROWS[name], run, theta, more_failures=more_failures)
    return f"{text}\nThis run is worse than the row's worst seed. A likely reason: {reason}."


def _row_of_kind(config: Config) -> str | None:
    """The name of the row that shares a run's `KIND`, if any."""
    for name, row in TRAINED_ROWS.items():
        if all(getattr(row, each) == getattr(config, each) for each in KIND):
            return name
    return None


def _likely_reason(
    config: Config, row: Config, run: Path, theta: np.ndarray, *, more_failures: bool
) -> str:
    """One likely reason for a run that is worse than its row."""
    given = config.to_dict()
    changed = []
    for name, value in row.to_dict().items():
        if name != "seed" and given.get(name) != value:
            changed.append(f"{name} {given.get(name)!r}")
    if changed:
        return f"other settings than the row, {', '.join(changed)}"
    # The gait of the second half, after the start.
    theta = theta[len(theta) // 2 :]
    middle = 0.5 * (theta.max() + theta.min())
    one_sided = abs(middle) > ONE_SIDED * np.ptp(theta)
    if config.task == "speed" and one_sided:
        gait = f"a one-sided gait about {np.degrees(middle):.0f} degrees"
        return f"{gait}, a local optimum that another --seed may avoid"
    if more_failures:
        excess = "more failures than in any run of the row"
        return f"{excess}, so that the policy is close to a limit of the plant"
    steps, values = read_evaluations(run / EVALUATIONS, config.task)
    best = np.argmin(values) if CRITERIA[config.task].ascending else np.argmax(values)
    if best == len(steps) - 1:
        return "the last evaluation was the best, so that more --total-steps may help"
    other = "another processor or version of torch"
    return f"the spread of seeds; rounding errors of {other} act as another seed"


def run_episode(
    policy: AnyPolicy, plant: PlantSpec, evaluation_set: EvaluationSet
) -> dict[str, np.ndarray]:
    """Runs a policy's episode on one plant of a set.

    Returns:
        Samples per agent step, each of shape (steps + 1,): t (s), theta (rad), theta_dot (rad/s), x
        (m), x_dot (m/s) and torque (N m).
    """
    env = CapsuleEnv(**{**policy.env_kwargs, **evaluation_set.env_kwargs})
    control_dt = env.simulation.options.control_dt
    act = policy.start([plant.seed])
    observation, info = env.reset(seed=plant.seed, options=plant.reset_options())
    samples = [(0.0, *info["state"], info["torque"])]
    for step in range(1, round(evaluation_set.horizon / control_dt) + 1):
        observation, _, terminated, _, info = env.step(act(observation[None])[0])
        samples.append((step * control_dt, *info["state"], info["torque"]))
        if terminated:
            break
    return dict(zip(SAMPLES, np.array(samples).T, strict=True))


def draw_comparison(
    recordings: Mapping[str, Mapping[str, np.ndarray]], path: Path, plant: PlantSpec
) -> None:
    """Draws displacement over the episode, and angle and torque over its last seconds, as a PNG.

    Args:
        recordings: samples of two recordings on the plant by the policies' names, the baseline
            first.
        path: the PNG; written atomically.
        plant: the plant.
    """
    name = "Nominal plant" if plant == NOMINAL_PLANT else "Plant"
    title = f"{name} (M = {plant.M:g} kg, μ = {plant.mu:g})"
    end = max(each["t"][-1] for each in recordings.values())
    with style():
        figure = new_figure(5.5)
        displacement, angle, torque = figure.subplots(3)
        for (name, each), colour in zip(recordings.items(), (MUTED, BLUE), strict=True):
            t, x = each["t"], each["x"]
            speed = 100.0 * (x[-1] - x[0]) / t[-1]
            displacement.plot(t, 100.0 * x, color=colour, label=f"{name}: {speed:.2f} cm/s")
            angle.plot(t, np.degrees(each["theta"]), color=colour)
            torque.step(t, each["torque"], color=colour)
        if plant.goal is not None:
            displacement.axhline(100.0 * plant.goal, color=MUTED, linestyle=":", label="goal")
        displacement.set(title=title, ylabel="displacement x (cm)", xlim=(0.0, end))
        displacement.legend(loc="upper left")
        last_seconds = (max(0.0, end - SHOWN), end)
        angle.set(ylabel="angle θ (deg)", xlim=last_seconds)
        torque.set(xlabel="time (s)", ylabel="torque u (N m)", xlim=last_seconds)
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=DPI)
