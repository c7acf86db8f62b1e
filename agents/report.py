"""One HTML page about runs, policies or the whole leaderboard: `python -m agents.report`."""

from __future__ import annotations

import base64
import html
import io
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from tabulate import tabulate

from agents.analysis.data import Learning, rank, read_learning
from agents.analysis.figures import draw_learning, draw_profiles, draw_transport
from agents.evaluation.criteria import CRITERIA
from agents.evaluation.episodes import SHARE_OF_OPTIMUM, TABLE_METRICS, TASK_METRICS, summarise
from agents.evaluation.policies import CHECKPOINTS, Candidate, all_candidates, find_candidate
from agents.leaderboard.rows import RESULTS, Row, evaluate_run, load_row, make_row, path_of
from agents.training.config import BEST, MODEL
from baselines.drawing import DPI, style
from capsule_gym.command_line import Positional, arg, check_output, parse, refuse
from capsule_gym.evaluation_sets import SET_NAMES, TASK_SET_NAMES, EvaluationSet, load_set
from capsule_gym.files import write_atomically
from capsule_gym.policy import POLICY

PROG = "python -m agents.report"
ROOT = Path(__file__).resolve().parents[1]
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
        ValueError: if the policy does not exist or a file is broken; if an agent with an LSTM must be unpickled, which
            can run any code, without `trust_pickle`; `trust_controller` is that of `capsule_gym.load_policy`.
    """
    path = Path(name)
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
        own = (results := path_of(ROOT / RESULTS, name)).is_file()
        rows.append(load_row(results) if own else _evaluate(candidate, sets))
        learning[candidate.name] = read_learning(CHECKPOINTS / name if own else Path(name), task)
    title = ", ".join(each.name for each in found.values() if each.name != criteria.baseline or len(found) == 1)
    return compose(title if names else "Leaderboard of capsule_gym", rank(rows, sets, task), sets, learning)


def _evaluate(candidate: Candidate, sets: Sequence[EvaluationSet]) -> Row:
    row = make_row(candidate, sets, [evaluate_run(policy, sets) for policy in candidate.policies])
    # A recurrent policy has no policy file with its seed.
    seeds = row.header["training_seeds"] or list(range(len(candidate.policies)))
    return replace(row, header={**row.header, "training_seeds": seeds})


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, PROG, arguments)
    try:
        page = render(args.policies, trust_controller=args.trust_controller, trust_pickle=args.trust_pickle)
    except ValueError as error:
        refuse(PROG, str(error))
    write_atomically(args.output, page)
    print(f"Written: {args.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
