"""Errors, coverage and time of `capsule_gym.identify`: `python -m benchmarks.identification`.

Plants are drawn from the prior's own ranges, and recorded for 20 s at 100 Hz.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from tqdm import tqdm

from capsule_gym import CapsuleEnv, Disturbances, Excitation, Fit, identify, record
from capsule_gym.command_line import Count, parse
from capsule_gym.identification import OTHERS, RANGES
from capsule_gym.parameters import RANDOMIZATIONS, REAL, Capsule

CONTROL_DT, PHYSICS_DT = 0.01, 2e-3
# Rounded to whole steps of the integrator, a latency stays inside the prior's range.
LATENCY = (0.002, 0.018)
FREE: dict[str, Any] = {name: RANGES[name] for name in RANGES if name not in OTHERS}
DRAWN = replace(RANDOMIZATIONS["real-wide"], **FREE)
# White noise alone, and the whole of `real`; both with all of the prior's latencies and lags.
ACTUATED: dict[str, Any] = {"latency": LATENCY, "lag": RANGES["lag"], "motor_friction": 0.0}
WHITE = {name: getattr(REAL, name) for name in ("theta_noise", "theta_dot_noise", "x_dot_noise")}
SENSORS: dict[str, Disturbances] = {"white": Disturbances(**WHITE, **ACTUATED), "real": replace(REAL, **ACTUATED)}


@dataclass(frozen=True)
class Args:
    """Identifies random plants, and prints errors, the coverage of the 95 % intervals, and the time.

    Examples:
      python -m benchmarks.identification --plants 150 --sensors real
    """

    plants: Count = 150
    """Number of plants."""
    seed: Count = 0
    """Seed of the first plant."""
    sensors: Literal["white", "real"] = "real"
    """Errors of the sensors: white noise, or noise, bias and drift."""


def make_logs(count: int, seed: int, sensors: str) -> Iterator[tuple[dict[str, np.ndarray], dict[str, float]]]:
    """Logs of random plants, and their quantities; plants on which the excitation ends the episode are left out."""
    options: dict[str, Any] = {"control_dt": CONTROL_DT, "physics_dt": PHYSICS_DT}
    env = CapsuleEnv(randomization=DRAWN, disturbances=SENSORS[sensors], capsule=Capsule(), **options)
    found = 0
    while found < count:
        _, info = env.reset(seed=seed)
        log = record(env, Excitation(seed=seed), seed=seed)
        seed += 1
        if len(log["t"]) * CONTROL_DT < 19.9:
            continue
        found += 1
        truth = {**info["disturbances"], **info["capsule"], "M": info["M"], "mu": info["mu"]}
        yield log, {**truth, "latency": round(truth["latency"] / PHYSICS_DT) * PHYSICS_DT}


def compare(fit: Fit, truth: dict[str, float]) -> dict[str, tuple[float, bool]]:
    """The error of every estimate, and whether its 95 % interval contains the truth."""
    found = {
        name: (fit.estimates[name] - truth[name], low <= truth[name] <= high)
        for name, (low, high) in fit.intervals(0.95).items()
    }
    found["latency + lag"] = found["latency"][0] + found["lag"][0], True
    return found


def main() -> None:
    """Prints the table."""
    args = parse(Args, "python -m benchmarks.identification")
    rows, truths, seconds, chi2 = [], [], [], []
    for log, truth in tqdm(make_logs(args.plants, args.seed, args.sensors), total=args.plants, mininterval=10.0):
        start = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            fit = identify(log)
        seconds.append(time.process_time() - start)
        rows.append(compare(fit, truth))
        truths.append(truth)
        chi2.append(fit.chi2)
    print(f"{'':16}{'median error':>14}{'relative':>10}{'covered':>9}")
    for name in rows[0]:
        errors = np.abs([row[name][0] for row in rows])
        sizes = np.abs([truth.get(name, np.inf) for truth in truths])
        relative = f"{np.median(errors / sizes):.1%}" if name in Capsule.__dataclass_fields__ else ""
        covered = f"{np.mean([row[name][1] for row in rows]):.1%}" if name in fit.estimates else ""
        print(f"{name:16}{np.median(errors):14.2g}{relative:>10}{covered:>9}")
    low, middle, high = np.percentile(chi2, (5.0, 50.0, 95.0))
    print(
        f"chi2: {middle:.2f}, 90 % within {low:.2f} to {high:.2f}; {np.median(seconds):.1f} s of processor time a fit"
    )


if __name__ == "__main__":
    main()
