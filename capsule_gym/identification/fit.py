"""Identification of a rig's plant from a log of torques and readings."""

import math
import os
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from capsule_gym.checks import check_number, require
from capsule_gym.envs.config import DIRECT_PHYSICS_DT
from capsule_gym.identification.derivatives import PLANT, subset
from capsule_gym.identification.log import read_log
from capsule_gym.identification.ranges import (
    DELAYS_AND_BIASES,
    OTHERS,
    check_known,
    check_plants,
    check_ranges,
    open_ranges,
)
from capsule_gym.identification.result import Fit, fitted_rows
from capsule_gym.identification.sampling import drop_repeats
from capsule_gym.parameters import SENSORS, Capsule, Disturbances, Randomization

if TYPE_CHECKING:
    from capsule_gym.identification.shooting import ShootingProblem

# Duration of a segment of the first fit, s.
SHORT = 0.2
# Starts of the first fit: shares of the ranges of latency and mu.
STARTS = ((0.3, 0.25), (0.3, 0.7), (0.7, 0.25), (0.7, 0.7))
# Number of its best ends with which the second fit begins.
KEPT = 2
# Difference of two sums of squares below which the ends of two fits are the same.
SAME = 3.0
# Share of the static ratio's range at which the search fixes it.
RATIO = 0.25
# Largest number of estimates of the noise.
MOST_ROUNDS = 10


def identify(
    log: str | os.PathLike[str] | Mapping[str, Any],
    known: Mapping[str, float] | None = None,
    prior: str | Randomization = "real-wide",
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    physics_dt: float = DIRECT_PHYSICS_DT,
) -> Fit:
    """Estimates a rig's plant, and the errors of its sensors and its motor, from a log.

    The last fifth of the log is not fitted: the result contains the errors with which it is
    predicted.

    Needs scipy: `pip install "capsule-gym[identify]"`.

    Args:
        log: the path of a CSV file, or columns by name: "t" (s) in equal steps, "torque" (N m), the
            command that acts from t on, and the readings "theta", "theta_dot", "x", "x_dot" (SI
            units), at least one of the first two. A missing reading is NaN, masked, or an empty
            cell.
        known: quantities that are not estimated, such as {"lag": 0.005}: constants of the
            `Capsule`, "latency", "lag", or a sensor's bias.
        ranges: other ranges of single quantities, such as {"latency": (0.0, 0.05)}. Latencies of
            single sensors, which add to "latency", are estimated only where they have one:
            "theta_latency", "theta_dot_latency", "x_dot_latency".
        prior: ranges of the plant's constants, by name or as a `Randomization`. Where it leaves
            "viscous", "static_ratio" or "motor_friction" open, `RANGES` applies; other constants
            keep the values of the `Capsule`.
        physics_dt: largest step of the integrator, s. Latency and lag are those of an environment
            with this step, which `Fit.env_kwargs` contains.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if the log or an argument is invalid; the message names the column.

    Warns:
        UserWarning: if a sensor repeats its readings, if the model does not explain the log, if the
            log does not determine a constant of the prior, if an estimate lies at the end of its
            range, or if one sensor is later than another.
    """
    # These need scipy.
    from capsule_gym.identification.doubts import doubts
    from capsule_gym.identification.posterior import sample_posterior
    from capsule_gym.identification.shooting import ShootingProblem

    columns = read_log(log)
    for name, count in drop_repeats(columns).items():
        warnings.warn(
            f"column {name!r} repeats {count} readings, which count as lost: leave the cells of "
            "readings that are not new empty",
            UserWarning,
            stacklevel=2,
        )
    prior = Randomization.named(prior, "prior")
    accepted = "a number of s from 1e-5 to 0.01"
    physics_dt = check_number("physics_dt", physics_dt, accepted, 1e-5, 0.01)
    fixed = check_known({} if known is None else known)
    given = check_ranges({} if ranges is None else ranges, fixed)
    constants: dict[str, Any] = subset(given, PLANT)
    prior = replace(prior, **constants)
    check_plants(fixed, prior, physics_dt)
    estimated = {}
    for name, (low, high) in open_ranges(columns, fixed, prior, given).items():
        if low < high:
            estimated[name] = low, high
        else:
            fixed[name] = low
    if not estimated:
        raise ValueError(
            "known and prior must leave a quantity to estimate, "
            f"got known={fixed} and prior={prior}"
        )
    values = {**dict.fromkeys(OTHERS, 0.0), **fixed}
    fitted = {}
    for name, column in columns.items():
        fitted[name] = column[: fitted_rows(columns)]
        known_there = bool(np.isfinite(fitted[name]).any())
        require(known_there, f"column {name!r}", "of readings in the first four fifths too", column)
    problem = ShootingProblem(fitted, estimated, prior.log_mu, values, physics_dt)
    unknowns, minima = search(problem)
    shares, unknowns = sample_posterior(problem, unknowns)
    whole = problem.extended(columns)
    fit = summarise(problem, whole, shares, unknowns, minima)
    for doubt in doubts(fit, problem, unknowns):
        warnings.warn(doubt, UserWarning, stacklevel=2)
    return fit


def search(problem: "ShootingProblem") -> tuple[np.ndarray, tuple[float, ...]]:
    """Fits a problem from several starts; sets its noise and its segments.

    Returns:
        The unknowns of the best end, and the sums of squares at all ends, the best first.
    """
    # With an unknown static ratio, at which the likelihood jumps, a search would end anywhere.
    jumps = "static_ratio" in problem.names
    smooth = problem.at("static_ratio", RATIO) if jumps else problem

    def fit_all(unknowns: Iterable[np.ndarray]) -> list[tuple[np.ndarray, float]]:
        ends = [smooth.fit(start, tolerance=1.0) for start in unknowns]
        return sorted(ends, key=itemgetter(1))

    states = smooth.cut(SHORT)
    starts = []
    for latency, mu in STARTS:
        given = {"latency": latency, "mu": mu}
        shares = [given.get(name, 0.5) for name in smooth.names]
        starts.append(np.append(shares, states))
    best_first = fit_all(starts)[:KEPT]
    states = smooth.cut()
    count = len(smooth.names)
    ends = fit_all([np.append(end[:count], states) for end, _ in best_first])
    for n in range(MOST_ROUNDS):
        best, smallest = ends[0]
        falls = smooth.estimate_noise(best)
        different = [end for end, cost in ends[1:] if cost > smallest + SAME]
        ends = fit_all([best, *different])
        # In a log without noise, it falls to rounding errors.
        if n > 0 and not falls:
            break
    best, _ = ends[0]
    problem.noise = smooth.noise
    problem.segments = smooth.segments
    if jumps:
        best = np.insert(best, problem.names.index("static_ratio"), RATIO)
    minima = [round(float(cost), 1) for _, cost in ends]
    return best, tuple(minima)


def summarise(
    problem: "ShootingProblem",
    whole: "ShootingProblem",
    shares: np.ndarray,
    unknowns: np.ndarray,
    minima: tuple[float, ...],
) -> Fit:
    """The result of samples of a problem's shares, and of its unknowns of largest likelihood.

    `whole` is the problem of the whole log.
    """
    drawn, _ = problem.values(shares)
    samples = np.transpose([drawn[name] for name in problem.names])
    means = samples.mean(axis=0)
    widths = math.sqrt(12.0) * shares.std(axis=0)
    estimates = dict(zip(problem.names, means.tolist(), strict=True))
    values = {**problem.known, **estimates}
    capsule = Capsule(**subset(values, PLANT))
    errors = subset(values, DELAYS_AND_BIASES)
    predictions, _ = whole.errors(unknowns, slopes=False)
    held_out = {}
    for n, name in enumerate(problem.sensors):
        unseen = predictions[len(problem.log["t"]) :, n, 0]
        squares = unseen[np.isfinite(unseen)] ** 2
        if squares.size:
            held_out[name] = float(np.sqrt(squares.mean()))
    for name in problem.sensors:
        noise, drift, time = problem.noise[name]
        if name == "x":
            errors["x_noise"] = math.hypot(noise, drift)
        else:
            errors[f"{name}_noise"] = noise
            errors[f"{name}_drift"] = drift
            errors["drift_time"] = time
    errors["unmeasured"] = [name for name in SENSORS if name not in problem.sensors]
    return Fit(
        estimates=estimates,
        samples=samples,
        capsule=capsule,
        disturbances=Disturbances(**errors),
        chi2=problem.statistic(unknowns),
        minima=minima,
        widths=dict(zip(problem.names, widths.tolist(), strict=True)),
        ranges=problem.ranges,
        physics_dt=problem.physics_dt,
        held_out=held_out,
        _problem=whole,
        _found=unknowns,
    )
