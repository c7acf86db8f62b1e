"""Identifies a rig from a log: `python -m capsule_gym.identify log.csv`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from capsule_gym import identify
from capsule_gym.command_line import Positional, check_output, parse, refuse

PROG = "python -m capsule_gym.identify"


@dataclass(frozen=True, kw_only=True)
class Args:
    """Estimates a rig's plant from a log with columns t, torque and some of theta, theta_dot, x, x_dot (SI units).

    Examples:
      python -m capsule_gym.identify log.csv --known lag 0.005 --report fit.png
    """

    log: Positional[Path]
    """CSV file; torque is the command that acts from t on."""
    prior: str = "real-wide"
    """Ranges of the plant: a name of the environment's argument randomization."""
    known: dict[str, float] | None = None
    """Quantities that are not estimated: --known lag 0.005"""
    report: Path | None = None
    """A new figure of readings, residuals and correlations."""

    def check(self) -> None:
        """Raises a `ValueError` for a file that does not exist or cannot be written."""
        if not self.log.is_file():
            raise ValueError(f"log must be a file, got {str(self.log)!r}")
        check_output("--report", self.report)


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the estimates; returns the exit status."""
    args = parse(Args, PROG, arguments)
    try:
        fit = identify(args.log, args.known, args.prior)
    except (TypeError, ValueError) as error:
        refuse(PROG, str(error))
    print(fit.table())
    if args.report:
        fit.report(args.report)
    return 0


class _Callable(ModuleType):
    """This module where it is imported: it then hides the package's function of its name, and is called instead."""

    __call__ = staticmethod(identify)


if __name__ == "__main__":
    sys.exit(main())
sys.modules[__name__].__class__ = _Callable
