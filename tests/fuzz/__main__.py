"""The command line: `python -m tests.fuzz`. Cases run in processes of their own; one that ends or hangs is replaced."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from capsule_gym.command_line import Count, parse

SHORT_STEPS = 500_000
# Far above the duration of any case, compilation on a busy machine included.
HANG_SECONDS = 180.0
# Failures of a process after which it stops.
MOST_FAILURES = 20
# Prints number, steps and failure of each case; its arguments are the first case, the stride and the number of steps.
CHILD = """
import faulthandler, sys
from {module} import run
faulthandler.enable()
case, stride, steps = map(int, sys.argv[1:])
while steps > 0:
    done, failure = run(case)
    print(case, done, (failure or "").replace("\\n", " "), flush=True)
    case, steps = case + stride, steps - max(1, done)
"""


@dataclass(frozen=True)
class Args:
    """Calls environments with random and invalid arguments, options, states and actions, and reports what breaks.

    Examples:
      python -m tests.fuzz --short
      python -m tests.fuzz --first 1000 --steps 1e7
    """

    steps: Count = 1_000_000
    """Agent steps, over all environments."""

    short: bool = False
    """Half of the steps, which is what CI runs."""

    first: Count = 0
    """Number of the first case: other numbers, other cases."""

    jobs: Count = os.cpu_count() or 1
    """Number of processes."""

    replay: int | None = None
    """Run this case alone, in this process, with the traceback of an exception."""

    def check(self) -> None:
        """Raises an error where nothing would run."""
        for name in ("steps", "jobs"):
            if getattr(self, name) < 1:
                raise ValueError(f"--{name} must be >= 1, got {getattr(self, name)}")


def fuzz(
    first: int, stride: int, steps: int, *, module: str = "tests.fuzz.cases", hang_seconds: float = HANG_SECONDS
) -> tuple[int, int, dict[int, str]]:
    """Runs the cases first, first + stride, .. in a process until so many agent steps are done.

    Args:
        first: number of the first case.
        stride: between cases.
        steps: agent steps.
        module: whose `run` runs a case.
        hang_seconds: duration after which a case counts as hanging.

    Returns:
        The number of cases, that of their agent steps, and the failures by case.
    """
    cases, done, failures = 0, 0, {}
    while done < steps and len(failures) < MOST_FAILURES:
        command = [sys.executable, "-c", CHILD.format(module=module), str(first), str(stride), str(steps - done)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            watch = threading.Timer(hang_seconds, process.kill)
            watch.start()
            for line in process.stdout:
                watch.cancel()
                number, count, failure = line.rstrip("\n").split(" ", 2)
                cases, done, first = cases + 1, done + max(1, int(count)), int(number) + stride
                if failure:
                    failures[int(number)] = failure
                watch = threading.Timer(hang_seconds, process.kill)
                watch.start()
            hangs = not watch.is_alive()
            watch.cancel()
        if process.returncode:
            failures[first] = "hangs" if hangs else f"ends the interpreter (exit status {process.returncode})"
            cases, done, first = cases + 1, done + 1, first + stride
    return cases, done, failures


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 where something broke."""
    args = parse(Args, "python -m tests.fuzz", arguments)
    if args.replay is not None:
        # The help needs none of it.
        from tests.fuzz.cases import Case

        Case(args.replay).run()
        print(f"Case {args.replay}: nothing broke.")
        return 0
    began, steps = time.monotonic(), min(args.steps, SHORT_STEPS) if args.short else args.steps
    with ThreadPoolExecutor(args.jobs) as pool:
        shares = [(args.first + n, args.jobs, -(-steps // args.jobs)) for n in range(args.jobs)]
        found = list(pool.map(lambda share: fuzz(*share), shares))
    failures = {number: failure for _, _, each in found for number, failure in each.items()}
    for number, failure in sorted(failures.items()):
        print(f"case {number}: {failure}")
    cases, done = (sum(each[n] for each in found) for n in (0, 1))
    print(f"{done:,} steps in {cases:,} cases, {len(failures)} failures; {time.monotonic() - began:.0f} s")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
