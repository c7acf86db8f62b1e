"""Evaluates one policy on one set, from the command line, beside a reference on the same episodes."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tqdm import tqdm
from tyro.conf import arg

from agents.evaluation import outside
from agents.evaluation.candidates import BASELINE, Candidate, checkpoint_names
from agents.evaluation.episodes import Episode, difference, failures, make_result, scores, summarise
from agents.evaluation.sets import SET_NAMES, EvaluationSet, load_set
from agents.evaluation.statistics import interquartile_mean
from agents.evaluation.tables import MEASURES
from baselines.policies import SCRIPTED
from baselines.tables import text_table
from capsule_gym.command_line import Positional, check_output, parse, refuse
from capsule_gym.files import to_json, write_atomically

PROG = "python -m agents.evaluate"
RESAMPLED = {
    "seeds": "over training seeds, resampled whole (with few of them read the interval as a range)",
    "episodes": "over episodes (they say nothing about another training run)",
    "nothing": "absent: a single episode has none",
}


@dataclass(frozen=True)
class Options:
    """Evaluates a policy on a frozen set, beside a reference on the same episodes.

    Prints interquartile means with 95 % bootstrap intervals, and the paired difference to the reference.

    Examples:
      python -m agents.evaluate adaptive --set paper
      python -m agents.evaluate residual-ppo --set drift --seed-runs
      python -m agents.evaluate runs/my-run --set wide --json result.json
      python -m agents.evaluate my_module:policy --trust
    """

    policy: Annotated[Positional[str], arg(metavar="NAME_OR_PATH")]
    """A scripted policy, a checkpoint (all training seeds; one as NAME/seed-0), the path of a run or policy file, or
    module:attribute for a policy from outside."""
    set: Annotated[str, arg(metavar="NAME_OR_PATH")] = "paper"
    """A frozen set, or the path of a JSON file of the same form."""
    against: Annotated[str, arg(metavar="NAME_OR_PATH")] = BASELINE
    """The reference of the paired difference."""
    seed_runs: bool = False
    """Also show every training seed by itself."""
    json: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write the result, with all episodes, to this file."""
    overwrite: bool = False
    """Let --json replace an existing file."""
    trust: bool = False
    """Accept a policy given as module:attribute: importing it runs its code."""
    trust_controller: bool = False
    """Accept a policy with a control law from elsewhere: importing it runs its code."""

    def check(self) -> None:
        """Refuses a file that cannot be written."""
        check_output("--json", self.json, overwrite=self.overwrite)


# The names are not known before the program runs.
Options.__doc__ = (
    f"{inspect.getdoc(Options)}\n\nSets: {', '.join(SET_NAMES)}.\n\nScripted policies: {', '.join(SCRIPTED)}.\n\n"
    f"Checkpoints: {', '.join(checkpoint_names()) or 'none'}."
)


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
    options = parse(Options, PROG, arguments)
    try:
        evaluation_set = load_set(options.set)
        candidate, reference = (
            outside.find(name, trust=options.trust, trust_controller=options.trust_controller)
            for name in (options.policy, options.against)
        )
    except ValueError as error:
        refuse(PROG, str(error))
    episodes = run_all(candidate, evaluation_set)
    others = None if reference == candidate else run_all(reference, evaluation_set)
    # Written before anything is printed: a closed pipe must not cost the result.
    if options.json is not None:
        write_atomically(options.json, to_json(make_result(candidate.name, evaluation_set, episodes)))
    plural = "" if len(evaluation_set.plants) == 1 else "s"
    print(
        f"{candidate.name} on the set {evaluation_set.name} ({len(evaluation_set.plants)} episode{plural}, "
        f"{evaluation_set.hash[:12]})\n"
    )
    print(comparison_table(candidate.name, episodes, reference.name, others))
    print(f"\nInterquartile means with 95 % intervals {RESAMPLED[summarise(episodes)['resampled']]}.")
    if others is not None:
        print(f"Differences to {reference.name} are taken episode by episode.")
    if options.seed_runs and candidate.folder is not None:
        print("\n" + seed_table(episodes))
    if options.json is not None:
        print(f"\nWritten to {options.json}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
