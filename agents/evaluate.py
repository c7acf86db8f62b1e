"""Evaluates one policy on one set, from the command line, beside a reference on the same episodes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from agents.evaluation.candidates import Candidate, checkpoint_names, find_candidate
from agents.evaluation.episodes import Episode, difference, failures, make_result, scores, summarise
from agents.evaluation.sets import SET_NAMES, EvaluationSet, load_set
from agents.evaluation.statistics import interquartile_mean
from agents.evaluation.tables import MEASURES
from baselines.policies import SCRIPTED
from baselines.tables import text_table
from capsule_gym.files import to_json, write_atomically

DEFAULT_REFERENCE = "adaptive"
RESAMPLED = {
    "seeds": "over training seeds, resampled whole (with few of them read the interval as a range)",
    "episodes": "over episodes (they say nothing about another training run)",
    "nothing": "absent: a single episode has none",
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m agents.evaluate",
        description="Evaluates a policy on a frozen set: interquartile means with 95 % bootstrap intervals, and the "
        "paired difference to a reference on the same episodes.",
        epilog="Stable-Baselines3 archives contain pickles, which can run any code when loaded: load only what you "
        f"trust. Scripted policies: {', '.join(SCRIPTED)}. Checkpoints: {', '.join(checkpoint_names()) or 'none'}.",
    )
    parser.add_argument(
        "policy",
        metavar="NAME_OR_PATH",
        help="a scripted policy, a checkpoint (all its training seeds), or the path of a run's folder or a .zip in it",
    )
    parser.add_argument(
        "--set", default="paper", help=f"{', '.join(SET_NAMES)}, or the path of a JSON file (default: paper)"
    )
    parser.add_argument(
        "--against",
        default=DEFAULT_REFERENCE,
        metavar="NAME_OR_PATH",
        help=f"the reference of the paired difference (default: {DEFAULT_REFERENCE})",
    )
    parser.add_argument("--seed-runs", action="store_true", help="also show every training seed by itself")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result, with all episodes, to this file")
    parser.add_argument("--overwrite", action="store_true", help="let --json replace an existing file")
    return parser


def run_all(candidate: Candidate, evaluation_set: EvaluationSet) -> list[Episode]:
    """Runs a candidate's training seeds, with a progress bar on a terminal where there are several."""
    progress = tqdm(candidate.runs, desc=candidate.name, unit="seed", file=sys.stderr, disable=_no_progress(candidate))
    return [episode for run in progress for episode in run.evaluate(evaluation_set)]


def _no_progress(candidate: Candidate) -> bool | None:
    # None lets tqdm find out whether stderr is a terminal.
    return True if len(candidate.runs) == 1 else None


def comparison_table(name: str, episodes: Sequence[Episode], reference: str, others: Sequence[Episode] | None) -> str:
    """Metrics as rows; the policy, the reference and the paired difference as columns.

    Args:
        name: of the policy.
        episodes: the policy's.
        reference: name of the reference.
        others: the reference's episodes on the same set; None leaves the last two columns out.
    """
    own = summarise(episodes)
    rows = [[measure.label, measure.with_interval(own[metric])] for metric, measure in MEASURES.items()]
    rows.append(["failures", f"{own['failures']}/{own['episodes']}"])
    header = ["", name]
    if others is not None:
        theirs = summarise(others)
        header += [reference, "difference"]
        for row, (metric, measure) in zip(rows, MEASURES.items(), strict=False):
            paired = difference(episodes, others, metric).to_dict()
            row += [measure.with_interval(theirs[metric]), measure.with_interval(paired, sign=True)]
        rows[-1] += [f"{theirs['failures']}/{theirs['episodes']}", ""]
    return text_table([header, *rows])


def seed_table(episodes: Sequence[Episode]) -> str:
    """Every training seed by itself: interquartile means over its episodes."""
    rows = [["training seed", *(measure.label for measure in MEASURES.values()), "failures"]]
    for seed in dict.fromkeys(episode["training_seed"] for episode in episodes):
        own = [episode for episode in episodes if episode["training_seed"] == seed]
        cells = [measure.format(float(interquartile_mean(scores(own, m)[0]))) for m, measure in MEASURES.items()]
        rows.append([str(seed), *cells, f"{failures(own)}/{len(own)}"])
    return text_table(rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        evaluation_set = load_set(options.set)
        candidate = find_candidate(options.policy)
        reference = find_candidate(options.against)
        # A broken archive is met here, before any work.
        for run in (*candidate.runs, *reference.runs):
            run.load()
    except ValueError as error:
        parser.error(str(error))
    # Before the work, so that nothing is computed in vain.
    if options.json is not None:
        if options.json.exists() and not options.overwrite:
            parser.error(f"--json must name a new file unless --overwrite is given, got {str(options.json)!r}")
        if options.json.is_dir() or not options.json.parent.is_dir():
            parser.error(f"--json must name a file in a folder that exists, got {str(options.json)!r}")

    episodes = run_all(candidate, evaluation_set)
    others = None if reference == candidate else run_all(reference, evaluation_set)
    result = make_result(candidate.name, evaluation_set, episodes)
    # Written before anything is printed: a closed pipe must not cost the result.
    if options.json is not None:
        write_atomically(options.json, to_json(result))
    plural = "" if len(evaluation_set.plants) == 1 else "s"
    print(
        f"{candidate.name} on the set {evaluation_set.name} ({len(evaluation_set.plants)} episode{plural}, "
        f"{evaluation_set.hash[:12]})\n"
    )
    print(comparison_table(candidate.name, episodes, reference.name, others))
    print(f"\nInterquartile means with 95 % intervals {RESAMPLED[result['summary']['resampled']]}.")
    if others is not None:
        print(f"Differences to {reference.name} are taken episode by episode.")
    if options.seed_runs and candidate.folder is not None:
        print("\n" + seed_table(episodes))
    if options.json is not None:
        print(f"\nWritten to {options.json}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
