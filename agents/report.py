"""One HTML page about runs, policies or the leaderboard: `python -m agents.report`; the comparison after a training."""

from __future__ import annotations

import base64
import html
import io
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tabulate import tabulate

from agents.analysis.data import Learning, rank, read_learning
from agents.analysis.figures import draw_learning, draw_profiles, draw_transport
from agents.evaluate import comparison_table
from agents.evaluation.criteria import CRITERIA
from agents.leaderboard.rows import RESULTS, Row, load_row
from agents.leaderboard.rows import evaluate as evaluate_rows
from agents.training.config import BEST, CONFIG, EVALUATIONS, MODEL, NORMALISATION, Config, read_config
from agents.training.presets import ROWS
from baselines.drawing import BLUE, DPI, MUTED, new_figure, style
from baselines.evaluation.episodes import (
    SHARE_OF_OPTIMUM,
    TABLE_METRICS,
    TASK_METRICS,
    Episode,
    evaluate,
    scores,
    summarise,
)
from baselines.evaluation.policies import CHECKPOINTS, Candidate, Policy, all_candidates, find_candidate
from capsule_gym import CapsuleEnv
from capsule_gym.command_line import Positional, arg, check_output, parse, refuse
from capsule_gym.config import find_task
from capsule_gym.evaluation_sets import NOMINAL_PLANT, SET_NAMES, TASK_SET_NAMES, EvaluationSet, PlantSpec, load_set
from capsule_gym.files import replacing, write_atomically
from capsule_gym.policy import POLICY
from capsule_gym.rendering import FRAME_SECONDS, write_gif
from capsule_gym.task import CONTROL_DT

PROG = "python -m agents.report"
ROOT = Path(__file__).resolve().parents[1]
# Length of the animation, and of the shown part of angle and torque at the end of an episode, s.
SHOWN = 6.6
# Settings that a run shares with the row of the leaderboard to which it is compared.
KIND = (
    *("env", "task", "algo", "controller", "randomization", "disturbances", "static_ratio", "energy_weight"),
    *("observe_parameters", "observe_estimates"),
)
METRICS = (*TASK_METRICS, *TABLE_METRICS.values(), SHARE_OF_OPTIMUM)
STYLE = (
    ":root{color-scheme:light dark}body{font:16px/1.5 system-ui,sans-serif;margin:0 auto;max-width:72rem;padding:1rem}"
    "img{max-width:100%}.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.85rem;white-space:nowrap}"
    "td,th{border-bottom:1px solid #d9e0e9;padding:.2rem .6rem}"
)


@dataclass(frozen=True)
class Args:
    """Writes one self-contained page: learning curves, metrics on every set, speed and cost, profiles.

    Rows of the leaderboard are read from its results; other runs are evaluated on every frozen set of 400 plants.

    Examples:
      python -m agents.report -o report.html
      python -m agents.report runs/my-run direct-ppo -o report.html
    """

    policies: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME_OR_PATH")] = ()
    """Rows of the leaderboard, or paths of runs; the whole leaderboard by default."""
    output: Annotated[Path, arg(metavar="FILE", aliases=["-o"])] = Path("report.html")
    """The page."""
    overwrite: bool = False
    """Replace an existing file."""
    trust_controller: bool = False
    """Accept a policy with a control law that is not of this package: importing it runs its code."""
    trust_pickle: bool = False
    """Accept the folder of a run with an LSTM, whose agent is unpickled: that can run any code."""

    def check(self) -> None:
        """Checks that the file can be written."""
        check_output("--output", self.output, overwrite=self.overwrite)


def find_run(name: str, *, trust_controller: bool = False, trust_pickle: bool = False) -> Candidate:
    """Finds a policy by its name, or by the path of a run, whose last part becomes its name.

    Raises:
        OSError: if a file cannot be read.
        ValueError: if the policy does not exist or a file is broken or a link out of the folder; if an agent with an
            LSTM must be unpickled, which can run any code, without `trust_pickle`; `trust_controller` is that of
            `capsule_gym.load_policy`.
    """
    path = Path(name)
    for file in (file for read in (CONFIG, EVALUATIONS, MODEL, NORMALISATION, POLICY) for file in path.rglob(read)):
        if not (target := file.resolve()).is_relative_to(path.resolve()):
            raise ValueError(f"{file} must be a file in the run's folder, got a link to {target}")
    if (path / BEST / MODEL).is_file() and not (path / BEST / POLICY).is_file():
        if not trust_pickle:
            raise ValueError(
                f"{path} contains an agent with an LSTM, and unpickling it can run any code; --trust-pickle allows it"
            )
        # Imported here, since torch takes seconds to import.
        from agents.training.export import load_best

        return Candidate(path.name, (load_best(path),), "a recurrent agent")
    return replace(find_candidate(name, trust_controller=trust_controller), name=path.resolve().name)


def render(names: Sequence[str], **trust: bool) -> str:
    """Renders the page of policies, given as for `find_run`, next to their task's baseline; of all rows if empty.

    Rows of the leaderboard are read from its results, other policies are evaluated.

    Raises:
        OSError: if a file cannot be read.
        ValueError: as in `find_run`; if two policies have the same name or different tasks.
    """
    found = {name: find_run(name, **trust) for name in names} or {each.name: each for each in all_candidates()}
    task = next(iter(found.values())).task
    if others := [each for each in found.values() if each.task != task]:
        first = next(iter(found))
        raise ValueError(f"policies must be for the same task, got {first} for {task} and {others[0].name}")
    criteria = CRITERIA[task]
    found |= {criteria.baseline: find_candidate(criteria.baseline)}
    if twins := [name for name, count in Counter(each.name for each in found.values()).items() if count > 1]:
        raise ValueError(f"policies must have different names, got {twins[0]} more than once")
    sets = [each for each in map(load_set, SET_NAMES + TASK_SET_NAMES) if each.task == task]
    rows, learning = [], {}
    for name, candidate in found.items():
        own = (results := ROOT / RESULTS / f"{name}.npz").is_file()
        rows.append(load_row(results) if own else next(evaluate_rows([candidate], sets, disturbed=False)))
        learning[candidate.name] = read_learning(CHECKPOINTS / name if own else Path(name), task)
    title = ", ".join(each.name for each in found.values() if each.name != criteria.baseline or len(found) == 1)
    return compose(title if names else "Leaderboard of capsule_gym", rank(rows, sets, task), sets, learning)


def compose(title: str, rows: Sequence[Row], sets: Sequence[EvaluationSet], learning: dict[str, Learning]) -> str:
    """The page of ranked rows as HTML."""
    task = sets[0].task
    learning = {row.name: runs for row in rows if (runs := learning[row.name])}
    parts = [f"<h1>{html.escape(title)}</h1>"]
    parts += [f"<p><strong>{html.escape(row.name)}</strong>: {html.escape(row.header['description'])}" for row in rows]
    if learning:
        parts.append(_figure("Learning curves on validation plants", draw_learning, learning, CRITERIA[task].metric))
    for each in sets:
        summaries = {row.name: summarise(row.episodes(each)) for row in rows}
        shown = [metric for metric in METRICS if any(metric.name in summary for summary in summaries.values())]
        lines = [["policy", "failed", *(metric.label for metric in shown)]]
        for name, summary in summaries.items():
            cells = (metric.with_interval(summary[metric.name]) if metric.name in summary else "-" for metric in shown)
            lines.append([name, f"{summary['failures']}/{summary['episodes']}", *cells])
        table = tabulate(lines, headers="firstrow", tablefmt="html", disable_numparse=True, stralign="right")
        parts.append(f"<h2>Set {html.escape(each.name)}</h2>\n<div class='wide'>\n{table}\n</div>")
    if task == "speed":
        parts.append(_figure("Speed against cost of transport on nominal", draw_transport, rows))
        parts.append(_figure("Performance profiles on paper and wide", draw_profiles, rows))
    parts.append(
        "<p>Interquartile means, of shares means, with 95 % intervals for other training runs on other plants."
    )
    head = f"<meta charset='utf-8'>\n<title>{html.escape(title)}</title>\n<style>{STYLE}</style>"
    return "\n".join(["<!doctype html>", head, *parts, ""])


def _figure(heading: str, draw: Callable[..., Any], *arguments: Any) -> str:
    content = io.BytesIO()
    with style():
        draw(*arguments).savefig(content, format="png", dpi=DPI)
    source = base64.b64encode(content.getvalue()).decode()
    return f"<h2>{heading}</h2>\n<img alt='{heading}' src='data:image/png;base64,{source}'>"


def compare(run: Path, set_name: str | None = None) -> None:
    """Evaluates a run's best model and the baseline on the same frozen episodes; prints and draws the comparison.

    Also prints the published row of the same kind, if there is one and it was evaluated on the set. Writes
    comparison.png, animation.gif and report.html to the run's folder. The default set is the task's ranking set.
    """
    # Imported here, since torch takes seconds to import.
    from agents.training.export import load_best

    policy = load_best(run)
    criteria = CRITERIA[policy.env_kwargs.get("task", "speed")]
    evaluation_set, (baseline,) = load_set(set_name or criteria.ranking_set), find_candidate(criteria.baseline).policies
    own, theirs = (evaluate(each, evaluation_set) for each in (policy, baseline))
    seconds = find_task(evaluation_set.task).episode_steps * CONTROL_DT
    print(f"\nOn the set {evaluation_set.name} ({len(own)} episodes of {seconds:g} s, the same for both):\n")
    print(comparison_table("agent", own, criteria.baseline, theirs) + "\n")
    print("Drawing, and evaluating the agent on every set for its report, takes some seconds.\n", flush=True)
    plant = NOMINAL_PLANT if evaluation_set.task == "speed" else evaluation_set.plants[0]
    names = {criteria.baseline: baseline, "agent": policy}
    recordings = {name: record(each, plant, evaluation_set, seconds)[0] for name, each in names.items()}
    if text := compare_to_row(run, own, evaluation_set, recordings["agent"]["theta"]):
        print(text + "\n", flush=True)
    draw_comparison(recordings, run / "comparison.png", plant)
    write_gif(record(policy, plant, evaluation_set, SHOWN, frames=True)[1], run / "animation.gif")
    write_atomically(run / "report.html", render([str(run)], trust_controller=True, trust_pickle=True))
    for what, name in {"Figure": "comparison.png", "Animation": "animation.gif", "Report": "report.html"}.items():
        print(f"{what + ':':10} {run / name}")


def compare_to_row(run: Path, own: Sequence[Episode], evaluation_set: EvaluationSet, theta: np.ndarray) -> str:
    """Compares a run with the row of the leaderboard of the same kind; names one likely reason if the run is worse.

    Args:
        run: the run's folder.
        own: the episodes of its best policy on the set.
        evaluation_set: the set.
        theta: angle in an episode of that policy, rad.

    Returns:
        The comparison; empty if there is no such row, or the row was not evaluated on the set.
    """
    config, criteria = read_config(run), CRITERIA[evaluation_set.task]
    kind = [getattr(config, name) for name in KIND]
    name = next((row for row, each in ROWS.items() if [getattr(each, field) for field in KIND] == kind), None)
    try:
        row = load_row(ROOT / RESULTS / f"{name}.npz")
        row.check_set(evaluation_set)
    except ValueError:
        return ""
    published = {each: row.score(evaluation_set.name, each).mean(axis=-1) for each in criteria.weights}
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
    reason = _likely_reason(config, ROWS[str(name)], run, theta, more_failures=more_failures)
    return f"{text}\nThis run is worse than the row's worst seed. A likely reason: {reason}."


def _likely_reason(config: Config, row: Config, run: Path, theta: np.ndarray, *, more_failures: bool) -> str:
    """One likely reason for a run that is worse than its row."""
    given, tuned = config.to_dict(), row.to_dict()
    changed = [name for name in tuned if name != "seed" and given.get(name) != tuned[name]]
    if changed:
        return f"other settings than the row, {', '.join(f'{each} {given.get(each)!r}' for each in changed)}"
    theta = theta[len(theta) // 2 :]
    middle = 0.5 * (theta.max() + theta.min())
    if config.env_task == "speed" and abs(middle) > 0.25 * np.ptp(theta):
        return f"a one-sided gait about {np.degrees(middle):.0f} degrees, a local optimum that another --seed may avoid"
    if more_failures:
        return "more failures than in any run of the row, so that the policy is close to a limit of the plant"
    ((steps, values),) = read_learning(run, config.env_task).values()
    best = np.argmin(values) if CRITERIA[config.env_task].ascending else np.argmax(values)
    if best == len(steps) - 1:
        return "the last evaluation was the best, so that more --total-steps may help"
    return "the spread of seeds; rounding errors of another processor or version of torch act as another seed"


def record(
    policy: Policy, plant: PlantSpec, evaluation_set: EvaluationSet, seconds: float, *, frames: bool = False
) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    """Runs a policy on one plant of a set for `seconds`, or until its episode ends.

    Returns:
        Samples per agent step, each of shape (steps + 1,): t (s), theta (rad), theta_dot (rad/s), x (m), x_dot (m/s),
        torque (N m); and pictures in intervals of `FRAME_SECONDS`, each (height, width, 3), uint8, if asked for.
    """
    env = CapsuleEnv(**{**policy.env_kwargs, **evaluation_set.env_kwargs}, render_mode="rgb_array")
    act, dt = policy.start([plant.seed]), env.simulation.options.control_dt
    observation, info = env.reset(seed=plant.seed, options=plant.reset_options())
    samples, ended = [(0.0, *info["state"], info["torque"])], False
    pictures: list[Any] = []
    while not ended and len(samples) <= round(seconds / dt):
        if frames and samples[-1][0] + 0.5 * dt > len(pictures) * FRAME_SECONDS:
            pictures.append(env.render())
        observation, _, ended, _, info = env.step(act(observation[None])[0])
        samples.append((len(samples) * dt, *info["state"], info["torque"]))
    env.close()
    return dict(zip(("t", "theta", "theta_dot", "x", "x_dot", "torque"), np.array(samples).T, strict=True)), pictures


def draw_comparison(recordings: Mapping[str, Mapping[str, np.ndarray]], path: Path, plant: PlantSpec) -> None:
    """Draws displacement over the episode, and angle and torque over its last seconds, as a PNG.

    Args:
        recordings: samples of two recordings on the plant by the policies' names, the baseline first.
        path: the PNG; written atomically.
        plant: the plant.
    """
    title = f"{'Nominal plant' if plant == NOMINAL_PLANT else 'Plant'} (M = {plant.M:g} kg, μ = {plant.mu:g})"
    end = max(each["t"][-1] for each in recordings.values())
    with style():
        figure = new_figure(5.5)
        displacement, angle, torque = figure.subplots(3, 1, height_ratios=(1.5, 1.0, 1.0))
        for (name, each), colour in zip(recordings.items(), (MUTED, BLUE), strict=True):
            speed = 100.0 * (each["x"][-1] - each["x"][0]) / each["t"][-1]
            displacement.plot(each["t"], 100.0 * each["x"], color=colour, label=f"{name}: {speed:.2f} cm/s")
            angle.plot(each["t"], np.degrees(each["theta"]), color=colour)
            torque.step(each["t"], each["torque"], color=colour, linewidth=1.0, where="pre")
        if plant.goal is not None:
            displacement.axhline(100.0 * plant.goal, color=MUTED, linestyle=":", label="goal")
        displacement.set(title=title, ylabel="displacement x (cm)", xlim=(0.0, end))
        displacement.legend(loc="upper left")
        window: dict[str, Any] = {"xlim": (max(0.0, end - SHOWN), end)}
        angle.set(ylabel="angle θ (deg)", **window)
        torque.set(xlabel="time (s)", ylabel="torque u (N m)", **window)
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=DPI)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    try:
        page = render(args.policies, trust_controller=args.trust_controller, trust_pickle=args.trust_pickle)
        write_atomically(args.output, page)
    except (OSError, ValueError) as error:
        refuse(PROG, str(error))
    print(f"Written: {args.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
