"""Identification of a rig's plant from a log of torques and readings."""

import json
import math
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsule_gym.checks import check_number, nearest, require, short_repr
from capsule_gym.envs.config import DIRECT_PHYSICS_DT, EnvConfig
from capsule_gym.envs.contract import check_step, describe
from capsule_gym.files import replacing, write_atomically
from capsule_gym.identification.derivatives import PLANT, subset
from capsule_gym.identification.log import UNITS, read_log
from capsule_gym.identification.sampling import drop_repeats
from capsule_gym.parameters import SENSORS, Capsule, Disturbances, Randomization

if TYPE_CHECKING:
    from capsule_gym.identification.shooting import ShootingProblem

# Ranges of what a `Randomization` may leave open, SI units.
RANGES = {
    "viscous": (0.0, 0.5),
    "static_ratio": (1.0, 1.5),
    "motor_friction": (0.0, 0.1),
    "latency": (0.0, 0.02),
    "lag": (1e-3, 0.01),
    "theta_bias": (-0.1, 0.1),
    "theta_dot_bias": (-0.5, 0.5),
    "x_dot_bias": (-0.1, 0.1),
}
OTHERS = tuple(name for name in RANGES if name not in PLANT)
QUANTITIES = (*PLANT, *OTHERS)
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
LARGEST_CHI2 = 1.2
FIGURES = (".png", ".svg", ".pdf")
# Smallest square of a coefficient of an axis that is named.
SMALLEST_SHARE = 0.1
# The fields of a result that its file contains as they are.
SAVED = ("estimates", "chi2", "minima", "widths", "ranges")
# Width of an interval in units of the range's from which on it is the prior's.
OPEN = 0.8
# The same width, below which an estimate at the end of its range is one that the log determines.
NARROW = 0.1


@dataclass(frozen=True)
class Fit:
    """The result of `identify`.

    Attributes:
        estimates: posterior mean of every estimated quantity, SI units.
        samples: samples of the posterior distribution, shape (samples, quantities), in the order of
            `estimates`.
        capsule: the plant with the estimates; its `motor_friction` is the motor's whole friction.
        disturbances: latency, lag, biases, noise and drift of the rig, as estimated.
        chi2: chi-square per degree of freedom of the residuals' dependence on torques and motion:
            about 1 where the model explains the log; above 1.2 a warning is issued.
        minima: sums of squares at the ends of the fits from the best starts, the best first; one if
            they agree.
        widths: standard deviation of each quantity over that of its range.
        ranges: ends of the ranges of the prior by quantity.
    """

    estimates: dict[str, float]
    samples: np.ndarray = field(repr=False)
    capsule: Capsule
    disturbances: Disturbances
    chi2: float
    minima: tuple[float, ...]
    widths: dict[str, float]
    ranges: dict[str, tuple[float, float]]
    # A result from a file has no log.
    _problem: "ShootingProblem | None" = field(default=None, repr=False)
    _found: np.ndarray | None = field(default=None, repr=False)

    @property
    def covariance(self) -> np.ndarray:
        """The covariance of the estimates, shape (quantities, quantities), SI units."""
        return np.atleast_2d(np.cov(self.samples.T))

    @property
    def identified(self) -> list[tuple[float, dict[str, float]]]:
        """What the log determines: the principal axes of the estimates in units of their ranges.

        Returns:
            For every axis its standard deviation over that of the ranges, and the largest
            coefficients by name, the best determined first. A value near 1 is the prior's.
        """
        ranges = np.ptp(list(self.ranges.values()), axis=1)
        relative = 12.0 * self.covariance / np.outer(ranges, ranges)
        variances, axes = np.linalg.eigh(relative)
        names = list(self.estimates)
        found = []
        for variance, axis in zip(variances, axes.T, strict=True):
            largest = {}
            for n in np.argsort(-np.abs(axis)):
                if axis[n] ** 2 > SMALLEST_SHARE:
                    largest[names[n]] = float(axis[n])
            found.append((math.sqrt(max(variance, 0.0)), largest))
        return found

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """The shortest interval that contains a share `level` of the posterior of each quantity."""
        level = check_number("level", level, "a number > 0 and <= 1", 0.0, 1.0, open_low=True)
        count = len(self.samples)
        inside = min(count - 1, math.ceil(level * count))
        found = {}
        for name, values in zip(self.estimates, np.sort(self.samples, axis=0).T, strict=True):
            lengths = values[inside:] - values[: count - inside]
            first = int(lengths.argmin())
            low, high = values[[first, first + inside]].tolist()
            found[name] = low, high
        return found

    def randomization(self, level: float = 0.95) -> Randomization:
        """The intervals of the plant's constants, from which a training can draw its plants."""
        return Randomization(**subset(self.intervals(level), PLANT))

    def env_kwargs(self, level: float = 0.95) -> dict[str, Any]:
        """Arguments of the environment that stands for the rig.

        Plants and disturbances are drawn from their intervals.
        """
        drawn = subset(self.intervals(level), OTHERS)
        return {
            "capsule": self.capsule,
            "randomization": self.randomization(level),
            "disturbances": replace(self.disturbances, **drawn),
        }

    def table(self) -> str:
        """Estimates, 95 % intervals, and their widths in units of the ranges, as text."""
        rows = [f"{'':16}{'estimate':>12}{'95 % interval':>26}{'width':>8}"]
        for name, (low, high) in self.intervals(0.95).items():
            limits = f"{low:.5g} to {high:.5g}"
            width = self.widths[name]
            note = "  not determined: the prior's" if width > OPEN else ""
            estimate = f"{self.estimates[name]:12.5g}"
            rows.append(f"{name:16}{estimate}{limits:>26}{width:8.2f}{note}")
        rows.append(f"chi2 {self.chi2:.2f}; minima of the fits: {self.minima}")
        return "\n".join(rows)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the result, without the log, to a JSON file that `load` reads.

        Args:
            path: path of the file, which is replaced atomically.
        """
        content: dict[str, Any] = {name: getattr(self, name) for name in SAVED}
        content["capsule"] = asdict(self.capsule)
        content["disturbances"] = asdict(self.disturbances)
        columns = self.samples.T.tolist()
        content["samples"] = dict(zip(self.estimates, columns, strict=True))
        write_atomically(Path(path), json.dumps(content) + "\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Fit":
        """Reads a result that `save` wrote; it cannot draw a report, which needs the log.

        Raises:
            OSError: if the file cannot be read.
            ValueError: if the file was not written by `save`.
        """
        path = Path(path)
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            # JSON has no tuples.
            content["minima"] = tuple(content["minima"])
            content["ranges"] = {name: tuple(ends) for name, ends in content["ranges"].items()}
            columns = [content["samples"][name] for name in content["estimates"]]
            content["samples"] = np.array(columns, np.float64).T
            content["capsule"] = Capsule(**content["capsule"])
            content["disturbances"] = Disturbances(**content["disturbances"])
            fit = cls(**content)
            fit.env_kwargs()
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
            reason = f"{type(error).__name__}: {short_repr(str(error))}"
            raise ValueError(f"{path} is not a result that Fit.save wrote: {reason}") from error
        return fit

    def report(self, path: str | os.PathLike[str]) -> None:
        """Draws measured and predicted readings, residuals, and correlations of the estimates.

        Args:
            path: a .png, .svg or .pdf.

        Raises:
            ValueError: if the path has another suffix, or the result is from a file.
        """
        from matplotlib.figure import Figure

        path = Path(path)
        accepted = f"the name of a file {' or '.join(FIGURES)}"
        require(path.suffix in FIGURES, "path", accepted, str(path))
        if self._problem is None or self._found is None:
            raise ValueError("a result from a file has no log: call report on that of identify")
        log, sensors = self._problem.log, self._problem.sensors
        t = log["t"]
        readings, _ = self._problem.predict(self._found, slopes=False)
        count = len(sensors)
        figure = Figure(figsize=(11.0, 2.2 * count + 4.5), layout="constrained")
        heights = [1.0] * count + [2.0]
        grid = figure.add_gridspec(count + 1, 2, height_ratios=heights)
        for n, name in enumerate(sensors):
            predicted = readings[:, n, 0]
            left = figure.add_subplot(grid[n, 0])
            left.plot(t, log[name], ".", markersize=2, label="measured")
            left.plot(t, predicted, linewidth=0.8, label="predicted")
            left.set_ylabel(f"{name} ({UNITS[name]})")
            left.set_xlim(t[0], t[0] + 5.0)
            right = figure.add_subplot(grid[n, 1])
            right.plot(t, log[name] - predicted, ".", markersize=2)
            right.set_ylabel("residual")
        figure.axes[0].legend(loc="upper right")
        axes = figure.add_subplot(grid[-1, :])
        names = list(self.estimates)
        correlations = np.atleast_2d(np.corrcoef(self.samples.T))
        image = axes.imshow(correlations, vmin=-1.0, vmax=1.0, cmap="RdBu")
        axes.set_xticks(range(len(names)), names, rotation=60)
        axes.set_yticks(range(len(names)), names)
        figure.colorbar(image, label="correlation")
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=110)


def identify(
    log: str | os.PathLike[str] | Mapping[str, Any],
    known: Mapping[str, float] | None = None,
    prior: str | Randomization = "real-wide",
    *,
    physics_dt: float = DIRECT_PHYSICS_DT,
) -> Fit:
    """Estimates a rig's plant, and the errors of its sensors and its motor, from a log.

    Needs scipy: `pip install "capsule-gym[identify]"`.

    Args:
        log: the path of a CSV file, or columns by name: "t" (s) in equal steps, "torque" (N m), the
            command that acts from t on, and the readings "theta", "theta_dot", "x", "x_dot" (SI
            units), at least one of the first two. A missing reading is NaN, masked, or an empty
            cell.
        known: quantities that are not estimated, such as {"lag": 0.005}: constants of the
            `Capsule`, "latency", "lag", or a sensor's bias.
        prior: ranges of the plant's constants, by name or as a `Randomization`. Where it leaves
            "viscous", "static_ratio" or "motor_friction" open, `RANGES` applies; other constants
            keep the values of the `Capsule`.
        physics_dt: largest step of the integrator, s. The lag and the motor's torque are those of
            an environment with this step.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if the log or an argument is invalid; the message names the column.

    Warns:
        UserWarning: if a sensor repeats its readings, if the model does not explain the log, if the
            log does not determine a constant of the prior, or if an estimate lies at the end of its
            range.
    """
    # These need scipy.
    from capsule_gym.identification.posterior import sample_posterior
    from capsule_gym.identification.shooting import ShootingProblem

    mapping = known is None or isinstance(known, Mapping)
    require(mapping, "known", "a dict of numbers by name", known, TypeError)
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
    fixed = check_known(known or {})
    check_plants(fixed, prior, physics_dt)
    ranges = {}
    for name, (low, high) in open_ranges(columns, fixed, prior).items():
        if low < high:
            ranges[name] = low, high
        else:
            fixed[name] = low
    if not ranges:
        raise ValueError(
            "known and prior must leave a quantity to estimate, "
            f"got known={fixed} and prior={prior}"
        )
    values = {**dict.fromkeys(OTHERS, 0.0), **fixed}
    problem = ShootingProblem(columns, ranges, prior.log_mu, values, physics_dt)
    unknowns, minima = search(problem)
    shares, unknowns = sample_posterior(problem, unknowns)
    fit = summarise(problem, shares, unknowns, minima)
    for doubt in doubts(fit, problem, unknowns):
        warnings.warn(doubt, UserWarning, stacklevel=2)
    return fit


def check_known(known: Mapping[str, float]) -> dict[str, float]:
    """Returns known quantities as floats, or raises an error."""
    found = {}
    for name, value in known.items():
        if name not in QUANTITIES:
            similar = nearest(str(name), QUANTITIES)
            raise ValueError(f"known must have keys out of {QUANTITIES}, got {name!r}{similar}")
        low, high = -math.inf, math.inf
        if name in OTHERS:
            low, high = Disturbances.limits(name)
        accepted = f"a finite number from {low:g} to {high:g}"
        found[name] = check_number(f"known[{name!r}]", value, accepted, low, high)
    return found


def check_plants(known: Mapping[str, float], prior: Randomization, physics_dt: float) -> None:
    """Raises an error unless all plants of the prior with known constants can be simulated."""
    settings = describe(EnvConfig(control_dt=physics_dt, physics_dt=physics_dt), None).settings
    constants = subset(known, PLANT)
    unknown: dict[str, Any] = dict.fromkeys(constants)
    for corner in replace(prior, **unknown).corners(Capsule(**constants)):
        check_step(corner, corner.M, corner.mu, settings)


def open_ranges(
    columns: Mapping[str, Any], known: Mapping[str, float], prior: Randomization
) -> dict[str, tuple[float, float]]:
    """The ranges of the quantities that are not known; a bias needs its sensor."""
    ranges = {}
    for name in QUANTITIES:
        limits = getattr(prior, name, None) or RANGES.get(name)
        sensed = not name.endswith("_bias") or name.removesuffix("_bias") in columns
        if limits and sensed and name not in known:
            ranges[name] = limits
    return ranges


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
    for _ in range(2):
        best, smallest = ends[0]
        smooth.estimate_noise(best)
        different = [end for end, cost in ends[1:] if cost > smallest + SAME]
        ends = fit_all([best, *different])
    best, _ = ends[0]
    problem.noise = smooth.noise
    problem.segments = smooth.segments
    if jumps:
        best = np.insert(best, problem.names.index("static_ratio"), RATIO)
    minima = [round(float(cost), 1) for _, cost in ends]
    return best, tuple(minima)


def summarise(
    problem: "ShootingProblem", shares: np.ndarray, unknowns: np.ndarray, minima: tuple[float, ...]
) -> Fit:
    """The result of samples of a problem's shares, and of its unknowns of largest likelihood."""
    drawn, _ = problem.values(shares)
    samples = np.transpose([drawn[name] for name in problem.names])
    means = samples.mean(axis=0)
    widths = math.sqrt(12.0) * shares.std(axis=0)
    estimates = dict(zip(problem.names, means.tolist(), strict=True))
    values = {**problem.known, **estimates}
    capsule = Capsule(**subset(values, PLANT))
    errors = subset(values, OTHERS)
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
        _problem=problem,
        _found=unknowns,
    )


def doubts(fit: Fit, problem: "ShootingProblem", found: np.ndarray) -> Iterator[str]:
    """The reasons to doubt a result; `found` are the unknowns of largest likelihood."""
    if fit.chi2 > LARGEST_CHI2:
        yield (
            f"chi2 is {fit.chi2:.2f}: the model does not explain the log, "
            "and the intervals are too short"
        )
    if not {"x", "x_dot"} & set(problem.sensors):
        yield "log has neither x nor x_dot: the intervals of M, mu, m, l and k may be too short"
    # The table shows what else is open.
    wide = [name for name, width in fit.widths.items() if width > OPEN]
    undetermined = [name for name in wide if name not in RANGES]
    if undetermined:
        names = ", ".join(undetermined)
        yield f"the log does not determine {names}: the intervals are the prior's"
    at_end = []
    for name, share in zip(problem.names, found, strict=False):
        if not 0.0 < share < 1.0 and fit.widths[name] < NARROW:
            at_end.append(name)
    if at_end:
        yield f"{', '.join(at_end)} lies at the end of its range: give a wider prior"
