"""The comparison at the end of a training: with the paper's controller, and with the published row
of the same kind.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

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
from capsule_gym.evaluation.episodes import Episode, evaluate, scores
from capsule_gym.evaluation.sets import NOMINAL_PLANT, EvaluationSet, PlantSpec, load_set
from capsule_gym.files import replacing

ROOT = Path(__file__).resolve().parents[1]
# Length of the shown part of angle and torque at the end of an episode, s.
SHOWN = 6.6
# Settings that a run shares with the row of the leaderboard to which it is compared.
KIND = (
    "env",
    "action_mode",
    "algo",
    "controller",
    "randomization",
    "disturbances",
    "static_ratio",
    "energy_weight",
    "observe_parameters",
    "observe_estimates",
)


def compare(run: Path, set_name: str | None = None) -> None:
    """Evaluates a run's best model and the baseline on the same frozen episodes; prints and draws
    the comparison.

    Also prints the published row of the same kind, if there is one and it was evaluated on the set.
    Writes comparison.png to the run's folder. The default set is the task's ranking set.
    """
    policy = load_policy(run, trust_controller=True)
    criteria = CRITERIA[policy.env_kwargs.get("task", "speed")]
    evaluation_set, (baseline,) = (
        load_set(set_name or criteria.ranking_set),
        find_candidate(criteria.baseline).policies,
    )
    own, theirs = (evaluate(each, evaluation_set) for each in (policy, baseline))
    episodes = f"{len(own)} episodes of {evaluation_set.horizon:g} s, the same for both"
    print(f"\nOn the set {evaluation_set.name} ({episodes}):\n")
    print(comparison_table("agent", own, criteria.baseline, theirs) + "\n", flush=True)
    plant = NOMINAL_PLANT if evaluation_set.task == "speed" else evaluation_set.plants[0]
    names = {criteria.baseline: baseline, "agent": policy}
    recordings = {name: run_episode(each, plant, evaluation_set) for name, each in names.items()}
    if text := compare_to_row(run, own, evaluation_set, recordings["agent"]["theta"]):
        print(text + "\n", flush=True)
    draw_comparison(recordings, run / "comparison.png", plant)
    print(f"Figure: {run / 'comparison.png'}")


def compare_to_row(
    run: Path, own: Sequence[Episode], evaluation_set: EvaluationSet, theta: np.ndarray
) -> str:
    """Compares a run with the row of the leaderboard of the same kind; names one likely reason if
    the run is worse.

    Args:
        run: the run's folder.
        own: the episodes of its best policy on the set.
        evaluation_set: the set.
        theta: angle in an episode of that policy, rad.

    Returns:
        The comparison; empty if there is no such row, or the row was not evaluated on the set.
    """
    config, criteria = read_config(run), CRITERIA[evaluation_set.task]
    name = next(
        (row for row, settings in TRAINED_ROWS.items() if _kind(settings) == _kind(config)), None
    )
    try:
        row = load_row(ROOT / RESULTS / f"{name}.npz")
        row.check_set(evaluation_set)
    except ValueError:
        return ""
    published = {
        each: row.score(evaluation_set.name, each).mean(axis=-1) for each in criteria.weights
    }
    found = {each: float(scores(own, each).mean()) for each in criteria.weights}
    metric, sign = criteria.metric.name, -1.0 if criteria.ascending else 1.0
    seed = int(np.argmin(sign * published[metric]))
    worst = {each: float(values[seed]) for each, values in published.items()}
    mean = {each: float(values.mean()) for each, values in published.items()}
    text = f"Published row {name}: mean of {len(published[metric])} seeds {criteria.describe(mean)}; worst seed "
    text += f"{criteria.describe(worst)}. This run: {criteria.describe(found)}."
    if sign * found[metric] >= sign * worst[metric]:
        return text
    more_failures = found["failed"] > published["failed"].max()
    reason = _likely_reason(
        config, TRAINED_ROWS[str(name)], run, theta, more_failures=more_failures
    )
    return f"{text}\nThis run is worse than the row's worst seed. A likely reason: {reason}."


def _kind(config: Config) -> list[Any]:
    """The settings that a run shares with the row to which it is compared."""
    return [getattr(config, name) for name in KIND]


def _likely_reason(
    config: Config, row: Config, run: Path, theta: np.ndarray, *, more_failures: bool
) -> str:
    """One likely reason for a run that is worse than its row."""
    given, tuned = config.to_dict(), row.to_dict()
    changed = [name for name in tuned if name != "seed" and given.get(name) != tuned[name]]
    if changed:
        return f"other settings than the row, {', '.join(f'{each} {given.get(each)!r}' for each in changed)}"
    theta = theta[len(theta) // 2 :]
    middle = 0.5 * (theta.max() + theta.min())
    if config.task == "speed" and abs(middle) > 0.25 * np.ptp(theta):
        return f"a one-sided gait about {np.degrees(middle):.0f} degrees, a local optimum that another --seed may avoid"
    if more_failures:
        return "more failures than in any run of the row, so that the policy is close to a limit of the plant"
    steps, values = read_evaluations(run / EVALUATIONS, config.task)
    best = np.argmin(values) if CRITERIA[config.task].ascending else np.argmax(values)
    if best == len(steps) - 1:
        return "the last evaluation was the best, so that more --total-steps may help"
    return "the spread of seeds; rounding errors of another processor or version of torch act as another seed"


def run_episode(
    policy: AnyPolicy, plant: PlantSpec, evaluation_set: EvaluationSet
) -> dict[str, np.ndarray]:
    """Runs a policy's episode on one plant of a set.

    Returns:
        Samples per agent step, each of shape (steps + 1,): t (s), theta (rad), theta_dot (rad/s), x
        (m), x_dot (m/s) and torque (N m).
    """
    env = CapsuleEnv(**{**policy.env_kwargs, **evaluation_set.env_kwargs})
    act, dt, ended = policy.start([plant.seed]), env.simulation.options.control_dt, False
    observation, info = env.reset(seed=plant.seed, options=plant.reset_options())
    samples = [(0.0, *info["state"], info["torque"])]
    while not ended and len(samples) <= round(evaluation_set.horizon / dt):
        observation, _, ended, _, info = env.step(act(observation[None])[0])
        samples.append((len(samples) * dt, *info["state"], info["torque"]))
    return dict(
        zip(("t", "theta", "theta_dot", "x", "x_dot", "torque"), np.array(samples).T, strict=True)
    )


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
    title = f"{'Nominal plant' if plant == NOMINAL_PLANT else 'Plant'} (M = {plant.M:g} kg, μ = {plant.mu:g})"
    end = max(each["t"][-1] for each in recordings.values())
    with style():
        figure = new_figure(5.5)
        displacement, angle, torque = figure.subplots(3)
        for (name, each), colour in zip(recordings.items(), (MUTED, BLUE), strict=True):
            speed = 100.0 * (each["x"][-1] - each["x"][0]) / each["t"][-1]
            displacement.plot(
                each["t"], 100.0 * each["x"], color=colour, label=f"{name}: {speed:.2f} cm/s"
            )
            angle.plot(each["t"], np.degrees(each["theta"]), color=colour)
            torque.step(each["t"], each["torque"], color=colour)
        if plant.goal is not None:
            displacement.axhline(100.0 * plant.goal, color=MUTED, linestyle=":", label="goal")
        displacement.set(title=title, ylabel="displacement x (cm)", xlim=(0.0, end))
        displacement.legend(loc="upper left")
        window: dict[str, Any] = {"xlim": (max(0.0, end - SHOWN), end)}
        angle.set(ylabel="angle θ (deg)", **window)
        torque.set(xlabel="time (s)", ylabel="torque u (N m)", **window)
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=DPI)
