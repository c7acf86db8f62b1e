"""Identifies a rig from a log: `python -m capsule_gym.identify log.csv`."""

import sys
from pathlib import Path
from types import ModuleType

from capsule_gym import identify
from capsule_gym.command_line import Positional, check_output, command
from capsule_gym.identification import FIGURES


@command("python -m capsule_gym.identify", TypeError, ValueError)
def main(
    log: Positional[Path],
    prior: str = "real-wide",
    known: dict[str, float] | None = None,
    report: Path | None = None,
) -> None:
    """Estimates a rig's plant from a log with columns t, torque and some of theta, theta_dot, x, x_dot (SI units).

    Examples:
      python -m capsule_gym.identify log.csv --known lag 0.005 --report fit.png

    Args:
        log: CSV file; torque is the command that acts from t on.
        prior: Ranges of the plant: a name of the environment's argument randomization.
        known: Quantities that are not estimated: --known lag 0.005
        report: A new figure of readings, residuals and correlations.
    """
    if not log.is_file():
        raise ValueError(f"log must be a file, got {str(log)!r}")
    check_output("--report", report, FIGURES)
    fit = identify(log, known, prior)
    print(fit.table())
    if report:
        fit.report(report)


class _Callable(ModuleType):
    """This module where it is imported: it then hides the package's function of its name, and is called instead."""

    __call__ = staticmethod(identify)


if __name__ == "__main__":
    sys.exit(main())
sys.modules[__name__].__class__ = _Callable
