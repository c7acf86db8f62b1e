"""Compares a finished run with the paper's controller: table, figure, animation and report."""

from __future__ import annotations

from pathlib import Path

from agents.analysis.recording import draw_comparison, record
from agents.evaluate import comparison_table
from agents.evaluation.episodes import evaluate
from agents.evaluation.policies import BASELINE
from agents.report.page import ANIMATION, write
from agents.training.export import load_best
from baselines.policies import SCRIPTED
from capsule_gym.evaluation_sets import load_set
from capsule_gym.rendering import write_gif
from capsule_gym.task import HORIZON

# The part of an episode that the animation shows, s.
ANIMATION_START, ANIMATION_SECONDS = 10.0, 6.0


def compare(run: Path, set_name: str = "paper") -> None:
    """Evaluates a run's best model and the baseline on the same frozen episodes; prints and draws the comparison.

    Args:
        run: the run's folder; gets comparison.png, animation.gif and report.html.
        set_name: a frozen set, or the path of one.
    """
    evaluation_set = load_set(set_name)
    policy, baseline = load_best(run), SCRIPTED[BASELINE]
    own, theirs = (evaluate(each, evaluation_set) for each in (policy, baseline))
    print(f"\nOn the set {evaluation_set.name} ({len(own)} episodes of {HORIZON:g} s, the same for both):\n")
    print(comparison_table("agent", own, BASELINE, theirs) + "\n")
    print("Drawing, and evaluating the agent on every set for its report, takes some seconds.\n", flush=True)
    draw_comparison([record(baseline), record(policy, name="agent")], run / "comparison.png")
    moving = record(policy, seconds=ANIMATION_START + ANIMATION_SECONDS, frames_from=ANIMATION_START, name="agent")
    if moving.frames:
        write_gif(moving.frames, run / ANIMATION)
    write(run / "report.html", [str(run)], trust_controller=True, trust_pickle=True)
    for what, name in {"Figure": "comparison.png", "Animation": ANIMATION, "Report": "report.html"}.items():
        print(f"{what + ':':10} {run / name}")
