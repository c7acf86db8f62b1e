"""Identifies a rig from a log: `python -m capsule_gym.identification log.csv`."""

import sys
from pathlib import Path

from capsule_gym.command_line import Positional, check_output, command
from capsule_gym.identification.fit import identify
from capsule_gym.identification.result import FIGURES
from capsule_gym.identification.sampling import on_grid


@command("python -m capsule_gym.identification", TypeError, ValueError)
def main(
    log: Positional[Path],
    prior: str = "real-wide",
    known: dict[str, float] | None = None,
    ranges: dict[str, tuple[float, float]] | None = None,
    period: float | None = None,
    report: Path | None = None,
    save: Path | None = None,
) -> None:
    """Estimates a rig's plant from a log.

    Its columns are t, torque and some of theta, theta_dot, x, x_dot (SI units).

    Examples:
      python -m capsule_gym.identification log.csv --known lag 0.005 --report fit.png
      python -m capsule_gym.identification log.csv --save fit.json

    Args:
        log: CSV file; torque is the command that acts from t on.
        prior: Ranges of the plant: a name of the environment's argument randomization.
        known: Quantities that are not estimated: --known lag 0.005
        ranges: Other ranges of single quantities: --ranges latency 0 0.05
        period: Period of a log with lost rows or uneven times, s, which are put on its grid.
        report: A new figure of readings, residuals and correlations.
        save: A new JSON file of the result, for the option --rig of trainings.
    """
    if not log.is_file():
        raise ValueError(f"log must be a file, got {str(log)!r}")
    check_output("--report", report, FIGURES)
    check_output("--save", save, (".json",))
    rows = log if period is None else on_grid(log, period)
    fit = identify(rows, known, prior, ranges=ranges)
    print(fit.table())
    if report:
        fit.report(report)
    if save:
        fit.save(save)


if __name__ == "__main__":
    sys.exit(main())
