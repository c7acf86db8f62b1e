"""Evaluates a policy, and compares it with a reference: `python -m agents.evaluate`."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from tqdm import tqdm

from agents.criteria import CRITERIA
from baselines.tables import text_table
from capsule_gym.command_line import Positional, arg, check_output, command
from capsule_gym.evaluation.candidates import find_candidate
from capsule_gym.evaluation.episodes import (
    TABLE_METRICS,
    TASK_METRICS,
    Episode,
    TableMetric,
    check_task,
    evaluate,
    failures,
    scores,
    summarise,
    versions,
)
from capsule_gym.evaluation.sets import load_set
from capsule_gym.evaluation.statistics import estimate, paired_difference
from capsule_gym.files import to_json, write_atomically


def comparison_table(
    name: str, episodes: Sequence[Episode], reference: str, others: Sequence[Episode]
) -> str:
    """A table for one set.

    Rows are metrics; columns are the policy, the reference and their paired difference.
    """
    known = (*TASK_METRICS, *TABLE_METRICS.values())
    metrics = [metric for metric in known if metric.name in episodes[0]]
    headline = headline_metric(metrics)
    # The leaderboard ranks by the mean.
    mean = replace(headline, label=f"{headline.label}, mean", share=True)
    rows = [["", name, reference, "difference"]]
    for metric in (mean, *metrics):
        trimmed = metric == headline and not metric.share
        cells = [f"{metric.label}, interquartile mean" if trimmed else metric.label]
        both = [scores(each, metric.name) for each in (episodes, others)]
        for values in both:
            interval = estimate(values, mean=metric.share).to_dict().values()
            cells.append(metric.with_interval(interval))
        difference = paired_difference(*both, mean=metric.share).to_dict().values()
        cells.append(metric.with_interval(difference, sign=True))
        rows.append(cells)
    rows.append(["failures", *(f"{failures(each)}/{len(each)}" for each in (episodes, others))])
    return text_table(rows)


def headline_metric(metrics: Sequence[TableMetric]) -> TableMetric:
    """The metric by which policies are ranked, of those that the episodes of a task have."""
    ranking = {criteria.metric.name for criteria in CRITERIA.values()}
    return next(metric for metric in metrics if metric.name in ranking)


@command("python -m agents.evaluate", ValueError)
def main(
    policy: Annotated[Positional[str], arg(metavar="NAME_OR_PATH")],
    set: Annotated[str | None, arg(metavar="NAME_OR_PATH")] = None,
    against: Annotated[str | None, arg(metavar="NAME_OR_PATH")] = None,
    json: Annotated[Path | None, arg(metavar="FILE")] = None,
    overwrite: bool = False,
    trust: bool = False,
    trust_controller: bool = False,
) -> int:
    """Evaluates a policy on a frozen set, and compares it with a reference on the same episodes.

    Prints interquartile means with 95 % intervals, and the paired difference to the reference.

    Examples:
      python -m agents.evaluate pd --set paper
      python -m agents.evaluate residual-ppo/seed-0 --set drift --against residual-ppo
      python -m agents.evaluate runs/my-run --set wide --json result.json
      python -m agents.evaluate goal
      python -m agents.evaluate my_module:policy --trust

    Args:
        policy: A scripted policy, a checkpoint (all training seeds; one as NAME/seed-0), the path
            of a run or policy file, or module:attribute for a policy of another project.
        set: A frozen set, or the path of a JSON file of the same form; by default the set that
            ranks the policy's task.
        against: The reference of the paired difference; by default adaptive, or the scripted policy
            of the policy's task.
        json: Write the result, with all episodes, to this file.
        overwrite: Let --json replace an existing file.
        trust: Accept a policy given as module:attribute: importing it runs its code.
        trust_controller: Accept a policy with a control law that is not of this package: importing
            it runs its code.
    """
    check_output("--json", json, overwrite=overwrite)
    trusted = {"trust": trust, "trust_controller": trust_controller}
    candidate = find_candidate(policy, **trusted)
    evaluation_set = load_set(set or CRITERIA[candidate.task].ranking_set)
    reference = find_candidate(against or CRITERIA[evaluation_set.task].baseline, **trusted)
    check_task(candidate, evaluation_set)
    check_task(reference, evaluation_set)
    count = f"{len(evaluation_set.plants)} episodes, {evaluation_set.hash[:12]}"
    print(f"{candidate.name} on the set {evaluation_set.name} ({count})\n", flush=True)
    episodes: list[Episode] = []
    for each in tqdm(candidate.policies, unit=" seeds", disable=None, leave=False):
        episodes += evaluate(each, evaluation_set)
    others = episodes if candidate.name == reference.name else evaluate(reference, evaluation_set)
    # Written before printing, so that a closed pipe does not lose the result.
    if json is not None:
        result = {
            "policy": candidate.name,
            "set": evaluation_set.name,
            "set_hash": evaluation_set.hash,
            "versions": versions(),
            "episodes": episodes,
            "summary": summarise(episodes),
        }
        write_atomically(json, to_json(result))
    print(comparison_table(candidate.name, episodes, reference.name, others))
    runs = "other training runs and " if len(candidate.policies) > 1 else ""
    print("\nInterquartile means unless stated, of shares means; the intervals of 95 % are")
    print(f"for {runs}other plants.")
    print(f"Differences to {reference.name} are taken episode by episode; their intervals are not")
    print("adjusted for the number of metrics.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
