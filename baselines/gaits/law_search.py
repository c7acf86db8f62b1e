"""Searches the parameters of `baselines:gait`, a law that is told nothing of the plant, all over `wide`.

How stands in `baselines.gaits.law_trials`.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from capsule_gym.command_line import Count, parse, refuse
from capsule_gym.files import write_atomically

PROG = "python -m baselines.gaits.law_search"


@dataclass(frozen=True)
class Options:
    """Searches the parameters of `baselines:gait`. Ctrl-C keeps the best so far.

    The file is written only where what is found scores better than what is in it.

    Examples:
      python -m baselines.gaits.law_search
      python -m baselines.gaits.law_search --seed 1 --generations 100 --file found.json
    """

    seed: int = 0
    """Of the search."""
    generations: Count = 700
    """Of the CMA-ES."""
    threads: int = os.cpu_count() or 1
    """For the batch."""
    file: Path | None = None
    """Where the parameters stand; if not given, where the law reads them."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, PROG, arguments)
    if options.threads < 1:
        refuse(PROG, f"--threads must be at least 1, got {options.threads}")
    # After the command line is known to be right: the help needs none of it.
    from baselines.gaits.law_trials import LOOK_EVERY, Search, judge, known_score
    from baselines.laws.gait import FILE, PARAMETERS

    file = options.file or FILE
    search, began, interrupted = Search(options.seed, options.threads), perf_counter(), False
    try:
        while search.generation < options.generations:
            fastest = search.advance()
            if search.generation % LOOK_EVERY == 0 or search.generation == options.generations:
                summary = search.look()
                print(
                    f"generation {search.generation}/{options.generations}, {perf_counter() - began:.0f} s: best "
                    f"{fastest:.2f}; mean of all in {summary['episodes']} episodes: {summary['mean_speed']:.2f} cm/s, "
                    f"{summary['failures']} failed",
                    flush=True,
                )
    except KeyboardInterrupt:
        interrupted = True
        print("interrupted: keeping the best so far")
    score, generation, found = search.best
    known = known_score(file, search.looks)
    if score > known:
        _, summary = judge(search.looks, found)
        provenance = {
            "command": f"{PROG} --seed {options.seed} --generations {options.generations}",
            "generation": generation,
            "seconds": round(perf_counter() - began),
        }
        content = {
            "parameters": dict(zip(PARAMETERS, found.tolist(), strict=True)),
            "found": {**provenance, **summary},
        }
        write_atomically(file, json.dumps(content, indent=1) + "\n")
        print(f"wrote {file}: {score:.3f}, was {known:.3f}")
    else:
        print(f"{file} stays as it is: {known:.3f}, found {score:.3f}")
    return 130 if interrupted else 0


if __name__ == "__main__":
    sys.exit(main())
