"""Compares a finished run with the paper's controller: table, figure, animation and report."""

from __future__ import annotations

from pathlib import Path

from agents.evaluate import comparison_table
from agents.evaluation.episodes import evaluate, make_result, scores
from agents.evaluation.policies import BASELINE
from agents.evaluation.statistics import interquartile_mean
from agents.recording import NOMINAL_TITLE, draw_comparison, record
from agents.report.page import write as write_report
from agents.training.export import load_best
from baselines.policies import SCRIPTED
from capsule_gym.evaluation_sets import load_set
from capsule_gym.files import to_json, write_atomically
from capsule_gym.rendering import write_gif
from capsule_gym.task import HORIZON

# The part of an episode that the animation shows, s.
ANIMATION_START, ANIMATION_SECONDS = 10.0, 6.0


def compare(run: Path, set_name: str = "paper") -> None:
    """Evaluates a run's best model and the baseline on the same frozen episodes; prints and draws the comparison.

    Args:
        run: the run's folder; gets comparison.json, comparison.png, animation.gif and report.html.
        set_name: a frozen set, or the path of one.
    """
    evaluation_set = load_set(set_name)
    policy, baseline = load_best(run), SCRIPTED[BASELINE]
    own, theirs = (evaluate(each, evaluation_set) for each in (policy, baseline))
    print(f"\nOn the set {evaluation_set.name} ({len(own)} episodes of {HORIZON:g} s, the same for both):\n")
    print(comparison_table("agent", own, BASELINE, theirs))
    speed, reference = (float(interquartile_mean(scores(each, "mean_speed"))[0]) for each in (own, theirs))
    ratio = f"{speed / reference:.2f} times that of {BASELINE}, the paper's controller"
    print(f"\nThe agent's interquartile mean speed is {ratio}.")
    result = {
        "agent": make_result(run.name, evaluation_set, own),
        BASELINE: make_result(BASELINE, evaluation_set, theirs),
    }
    write_atomically(run / "comparison.json", to_json(result))

    print("Drawing, and evaluating the agent on every set for its report, takes some seconds.\n", flush=True)
    recordings = [record(baseline), record(policy, name="agent")]
    draw_comparison(recordings, run / "comparison.png", NOMINAL_TITLE)
    moving = record(policy, seconds=ANIMATION_START + ANIMATION_SECONDS, frames_from=ANIMATION_START, name="agent")
    if moving.frames:
        write_gif(moving.frames, run / "animation.gif")
    write_report(run / "report.html", [str(run)], trust_controller=True)
    names = {"Episodes": "comparison.json", "Figure": "comparison.png"}
    names |= {"Animation": "animation.gif", "Report": "report.html"}
    print("\n".join(f"{what + ':':10} {run / name}" for what, name in names.items()))
