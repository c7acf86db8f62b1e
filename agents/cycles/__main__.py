"""Shows how policies move and where their speed comes from: `python -m agents.cycles`."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from agents.cycles.course import BACKWARD, FORWARD, STICK, WINDOW, Balance, Course, Cycle, balance, find_cycle, follow
from agents.cycles.picture import draw_cycles
from agents.evaluation.policies import BASELINE, Candidate, checkpoint_names, find_candidate
from agents.evaluation.statistics import interquartile_mean
from agents.leaderboard.page import RANKING_SET
from agents.leaderboard.rows import RESULTS, load_rows
from baselines.drawing import save, style
from baselines.policies import SCRIPTED
from baselines.tables import markdown_table, text_table
from capsule_gym.command_line import Positional, check_output, parse, refuse
from capsule_gym.files import write_atomically

PROG = "python -m agents.cycles"
ROOT = Path(__file__).resolve().parents[2]
BEST = 3
MOST = 6
# What stands for the fastest motion known, the first of these that there is.
OPTIMA = ("optimum-nominal", "gait-nominal")


@dataclass(frozen=True)
class Options:
    """Shows one steady cycle of each policy on the paper's plant, and where its speed comes from.

    Of several training seeds the one with the median speed is shown.

    Examples:
      python -m agents.cycles
      python -m agents.cycles adaptive residual-ppo direct-ppo/seed-2 --figure cycles.png
    """

    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME_OR_PATH")] = ()
    """As for python -m agents.evaluate; without any the paper's law, the best three that were trained, and the
    optimum."""
    figure: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write the figure to this PNG, and beside it as SVG."""
    markdown: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write the tables to this file."""
    trust: bool = False
    """Accept a policy given as module:attribute: importing it runs its code."""
    trust_controller: bool = False
    """Accept a policy with a control law from elsewhere: importing it runs its code."""

    def check(self) -> None:
        """Refuses too many policies, and files that cannot be written."""
        if len(self.names) > MOST:
            raise ValueError(f"names must be at most {MOST}, got {len(self.names)}")
        check_output("--figure", self.figure, overwrite=True)
        check_output("--markdown", self.markdown, overwrite=True)
        if self.figure is not None and self.figure.suffix != ".png":
            raise ValueError(f"--figure must name a PNG, got {str(self.figure)!r}")


def default_names(root: Path = ROOT) -> list[str]:
    """The paper's law, the policies that learnt from reward and are the fastest three, and the optimum.

    A network that copies the optimum moves as the optimum does.

    Raises:
        ValueError: if a checkpoint has no results.
    """
    # numba takes most of a second to import, which --help need not wait for.
    from capsule_gym.policy import IMITATION, load_policy

    learnt = [name for name in checkpoint_names() if load_policy(name).algorithm != IMITATION]
    rows = load_rows(root / RESULTS, learnt)
    speeds = {row.name: float(interquartile_mean(row.score(RANKING_SET, "mean_speed").ravel())) for row in rows}
    best = sorted(speeds, key=lambda name: (-speeds[name], name))[:BEST]
    return [BASELINE, *best, next(name for name in OPTIMA if name in SCRIPTED)]


def median_course(candidate: Candidate) -> Course:
    """The course of the run whose speed is the median of its training seeds'; the lower of two."""
    courses = [follow(candidate.name, policy) for policy in candidate.policies]
    order = sorted(range(len(courses)), key=lambda i: courses[i].x[-1])
    chosen = order[(len(order) - 1) // 2]
    several = f" (seed {candidate.trained[chosen].training_seed})" if len(courses) > 1 else ""
    return replace(courses[chosen], name=f"{candidate.name}{several}")


def tables(cycles: Sequence[Cycle]) -> tuple[list[list[str]], list[list[str]]]:
    """The cycles in numbers, and the balance of their phases."""
    first, speeds = balance(cycles[0]), ("speed (cm/s)", f"over {WINDOW:g} s (cm/s)")
    factors, centre = ("as often", "as far"), "centre of mass (cm/s)"
    shapes = [
        ["policy", "period (s)", "swings", "step (cm)", *factors, *speeds, centre, "at the limit", "closes within"]
    ]
    presses = ("N / ((M + m) g)", "the same over the way")
    phases = [["policy", "phase", "time", "travel (cm)", "speed (cm/s)", *presses, "friction (mN s)"]]
    for cycle in cycles:
        found, name = balance(cycle), cycle.course.name
        shapes.append(
            [
                name,
                f"{found.period:.2f}",
                str(cycle.swings),
                f"{found.period * found.speed:.2f}",
                f"x {first.period / found.period:.2f}",
                f"x {found.period * found.speed / (first.period * first.speed):.2f}",
                f"{found.speed:.2f}",
                f"{cycle.window_speed:.2f}",
                f"{found.glide[0]:.1f} to {found.glide[1]:.1f}",
                f"{100.0 * found.saturated:.0f} %",
                f"{cycle.mismatch:.3f}",
            ]
        )
        phases += _phases(name, found)
    return shapes, phases


def _phases(name: str, found: Balance) -> list[list[str]]:
    lines = []
    for label, key in (("forward", FORWARD), ("stick", STICK), ("backward", BACKWARD)):
        phase = found.phases[key]
        presses = ["-" if math.isnan(each) else f"{each:.2f}" for each in (phase.press, phase.press_over_way)]
        speed = "-" if phase.time == 0.0 else f"{100.0 * phase.travel / (phase.time * found.period):+.2f}"
        share, impulse = f"{100.0 * phase.time:.0f} %", f"{1e3 * phase.impulse:+.1f}"
        lines.append([name, label, share, f"{100.0 * phase.travel:+.2f}", speed, *presses, impulse])
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    try:
        candidates = [
            find_candidate(name, trust=options.trust, trust_controller=options.trust_controller)
            for name in (options.names or default_names())
        ]
        cycles = [find_cycle(median_course(candidate)) for candidate in candidates]
    except ValueError as error:
        refuse(PROG, str(error))
    shapes, phases = tables(cycles)
    # Written before anything is printed: a closed pipe must not cost the result.
    if options.markdown is not None:
        parts = [f"<!-- Written by {PROG}: do not edit. -->"]
        for name, table in (("shapes", shapes), ("phases", phases)):
            parts.append(f"<!-- --8<-- [start:{name}] -->\n{markdown_table(table)}\n<!-- --8<-- [end:{name}] -->")
        write_atomically(options.markdown, "\n\n".join(parts) + "\n")
    if options.figure is not None:
        with style():
            save(draw_cycles(cycles), options.figure.with_suffix(""))
    print(text_table(shapes, left=1), text_table(phases, left=2, last_left=False), sep="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
