"""Errors, coverage and time of `capsule_gym.identify`: `python -m benchmarks.identification`.

Plants are drawn from the prior's own ranges, and recorded for 20 s at 100 Hz with the sensors of
`real`.
"""

import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from capsule_gym import CapsuleEnv, Excitation, identify, record
from capsule_gym.checks import check_number
from capsule_gym.command_line import Count, PositiveCount, command
from capsule_gym.identification import on_grid
from capsule_gym.identification.ranges import OTHERS, RANGES
from capsule_gym.parameters import RANDOMIZATIONS, REAL, Capsule, Disturbances
from capsule_gym.tasks.task import THETA_LIMIT

CONTROL_DT = 0.01
PHYSICS_DT = 2e-3
# Duration that a log must have, s: `record` ends after 20 s.
WHOLE = 19.9
FREE: dict[str, Any] = {name: RANGES[name] for name in RANGES if name not in OTHERS}
DRAWN = replace(RANDOMIZATIONS["real-wide"], **FREE)
# All of the prior's lags and latencies, which stay inside its range when they are rounded to the
# integrator's steps.
ALL = replace(REAL, latency=(0.002, 0.018), lag=RANGES["lag"], motor_friction=0.0)
# White noise alone, or the noise, bias and drift of `real`, and what else a sensor does.
NONE: dict[str, Any] = {name: 0.0 for name in vars(REAL) if name.endswith(("_bias", "_drift"))}
SENSORS = {
    "white": replace(ALL, **NONE),
    "real": ALL,
    "lost": replace(ALL, lost=0.1),
    "held": replace(ALL, hold=2.0),
    "jitter": replace(ALL, jitter=0.1 * CONTROL_DT),
    "camera": replace(ALL, x_dot_latency=0.03),
}


def make_logs(
    count: int, seed: int, disturbances: Disturbances, amplitude: float
) -> Iterator[tuple[dict[str, np.ndarray], dict[str, float]]]:
    """Logs of random plants, and their quantities.

    Plants on which the excitation ends the episode, or brings a reading to the stop, are left out.
    """
    env = CapsuleEnv(
        randomization=DRAWN, disturbances=disturbances, control_dt=CONTROL_DT, physics_dt=PHYSICS_DT
    )
    while count:
        _, info = env.reset(seed=seed)
        log = record(env, Excitation(seed=seed, amplitude=amplitude), seed=seed)
        seed += 1
        stopped = np.nanmax(np.abs(log["theta"])) >= THETA_LIMIT
        if len(log["t"]) * CONTROL_DT > WHOLE and not stopped:
            count -= 1
            truth = {**info["disturbances"], **info["capsule"], "M": info["M"], "mu": info["mu"]}
            truth["latency"] = round(truth["latency"] / PHYSICS_DT) * PHYSICS_DT
            if disturbances.jitter:
                # Readings are taken early by up to the jitter.
                truth["latency"] += 0.5 * truth["jitter"]
                log = on_grid(log, CONTROL_DT)
            yield log, truth


def names_a_column(caught: list[warnings.WarningMessage]) -> bool:
    """Whether a warning names a column of the log."""
    return any("column '" in str(each.message) for each in caught)


@command("python -m benchmarks.identification", ValueError)
def main(
    plants: PositiveCount = 150,
    seed: Count = 0,
    sensors: Literal["white", "real", "lost", "held", "jitter", "camera"] = "real",
    amplitude: float = Excitation.amplitude,
) -> None:
    """Identifies random plants; prints errors, the coverage of the 95 % intervals, and the time.

    Examples:
      python -m benchmarks.identification --plants 150
      python -m benchmarks.identification --plants 40 --sensors white --amplitude 0.55

    Args:
        plants: Number of plants.
        seed: Seed of the first plant.
        sensors: Errors of the sensors: white noise; noise, bias and drift; these with a tenth of
            the readings lost, readings held for two further periods, a jitter of 10 % of the
            period, or a camera that measures x_dot 30 ms later.
        amplitude: Root mean square of the excitation, N m. With 0.55 it ends a quarter of the
            episodes.
    """
    check_number("--amplitude", amplitude, "a number from 0 to 1 (N m)", 0.0, 1.0)
    found, seconds = [], []
    warned = 0
    logs = make_logs(plants, seed, SENSORS[sensors], amplitude)
    for log, truth in tqdm(logs, total=plants, mininterval=10.0):
        start = time.process_time()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            fit = identify(log)
        warned += names_a_column(caught)
        seconds.append(time.process_time() - start)
        found.append((fit, truth))
    print_line("", "median error", "relative", "covered")
    delays = 0.0
    shares = []
    for name in found[0][0].estimates:
        truths = np.array([truth[name] for _, truth in found])
        errors = np.array([fit.estimates[name] for fit, _ in found]) - truths
        low, high = np.transpose([fit.intervals(0.95)[name] for fit, _ in found])
        covered = (low <= truths) & (truths <= high)
        shares.append(covered.mean())
        share = ""
        if name in Capsule.__dataclass_fields__:
            share = f"{np.median(np.abs(errors / truths)):.1%}"
        print_line(name, median_size(errors), share, f"{covered.mean():.1%}")
        if name in ("latency", "lag"):
            delays = delays + errors
    print_line("latency + lag", median_size(delays), "", "")
    print_line("all", "", "", f"{np.mean(shares):.1%}")
    print(f"a warning names a column in {warned} of {plants} logs")
    low, middle, high = np.percentile([fit.chi2 for fit, _ in found], (5.0, 50.0, 95.0))
    chi2 = f"{middle:.2f}, 90 % within {low:.2f} to {high:.2f}"
    print(f"chi2: {chi2}; {np.median(seconds):.1f} s a fit")


def median_size(errors: ArrayLike) -> str:
    """The median of the absolute errors."""
    return f"{np.median(np.abs(errors)):.2g}"


def print_line(name: str, error: str, relative: str, covered: str) -> None:
    """Prints a line of the table."""
    print(f"{name:16}{error:>14}{relative:>10}{covered:>9}")


if __name__ == "__main__":
    main()
