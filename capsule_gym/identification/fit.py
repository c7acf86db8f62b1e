"""Identification of a rig's plant from a log of torques and readings."""

import math
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsule_gym.checks import check_number, nearest, require
from capsule_gym.envs.config import DIRECT_PHYSICS_DT, EnvConfig
from capsule_gym.envs.contract import check_step, describe
from capsule_gym.files import replacing
from capsule_gym.identification.derivatives import PLANT
from capsule_gym.identification.log import UNITS, read_log
from capsule_gym.parameters import SENSORS, Capsule, Disturbances, Randomization

if TYPE_CHECKING:
    from capsule_gym.identification.shooting import ShootingProblem

# Ranges of what a `Randomization` may leave open, SI units.
RANGES = {
    **{"viscous": (0.0, 0.5), "static_ratio": (1.0, 1.5), "motor_friction": (0.0, 0.1)},
    **{"latency": (0.0, 0.02), "lag": (1e-3, 0.01)},
    **{"theta_bias": (-0.1, 0.1), "theta_dot_bias": (-0.5, 0.5), "x_dot_bias": (-0.1, 0.1)},
}
OTHERS = tuple(name for name in RANGES if name not in PLANT)
QUANTITIES = (*PLANT, *OTHERS)
# Duration of a segment of the first fit, s.
SHORT = 0.2
# Starts of the fit: shares of the ranges of latency and mu; the best ones of the first fit begin
# the second.
STARTS, KEPT = (
    tuple({"latency": latency, "mu": mu} for latency in (0.3, 0.7) for mu in (0.25, 0.7)),
    2,
)
# Share of the static ratio's range at which the search fixes it.
RATIO = 0.25
LARGEST_CHI2 = 1.2
FIGURES = (".png", ".svg", ".pdf")
# Width of an interval in units of the range's from which on it is the prior's.
OPEN = 0.8


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
    """

    estimates: dict[str, float]
    samples: np.ndarray = field(repr=False)
    capsule: Capsule
    disturbances: Disturbances
    chi2: float
    minima: tuple[float, ...]
    widths: dict[str, float]
    _problem: "ShootingProblem" = field(repr=False)
    _found: np.ndarray = field(repr=False)

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
        ranges = self._problem.high - self._problem.low
        sizes, axes = np.linalg.eigh(12.0 * self.covariance / np.outer(ranges, ranges))
        names, found = list(self.estimates), []
        for size, axis in zip(sizes, axes.T, strict=True):
            largest = {
                names[n]: float(axis[n]) for n in np.argsort(-np.abs(axis)) if axis[n] ** 2 > 0.1
            }
            found.append((math.sqrt(max(size, 0.0)), largest))
        return found

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """The shortest interval that contains a share `level` of the posterior of each quantity."""
        level = check_number("level", level, "a number > 0 and <= 1", 0.0, 1.0, open_low=True)
        count = len(self.samples)
        inside = min(count - 1, math.ceil(level * count))
        found = {}
        for name, values in zip(self.estimates, np.sort(self.samples, axis=0).T, strict=True):
            first = int(np.argmin(values[inside:] - values[: count - inside]))
            found[name] = float(values[first]), float(values[first + inside])
        return found

    def randomization(self, level: float = 0.95) -> Randomization:
        """The intervals of the plant's constants, from which a training can draw its plants."""
        ranges: dict[str, Any] = {
            name: ends for name, ends in self.intervals(level).items() if name in PLANT
        }
        return Randomization(**ranges)

    def env_kwargs(self, level: float = 0.95) -> dict[str, Any]:
        """Arguments of the environment that stands for the rig: plant and disturbances, drawn from
        their intervals.
        """
        drawn: dict[str, Any] = {
            name: value for name, value in self.intervals(level).items() if name in OTHERS
        }
        disturbances = replace(self.disturbances, **drawn)
        return {
            "capsule": self.capsule,
            "randomization": self.randomization(level),
            "disturbances": disturbances,
        }

    def table(self) -> str:
        """Estimates, 95 % intervals, and their widths in units of the ranges, as text."""
        rows = [f"{'':16}{'estimate':>12}{'95 % interval':>26}{'width':>8}"]
        for name, (low, high) in self.intervals(0.95).items():
            note = "  not determined: the prior's" if self.widths[name] > OPEN else ""
            limits = f"{low:.5g} to {high:.5g}"
            rows.append(
                f"{name:16}{self.estimates[name]:12.5g}{limits:>26}{self.widths[name]:8.2f}{note}"
            )
        return "\n".join([*rows, f"chi2 {self.chi2:.2f}; minima of the fits: {self.minima}"])

    def report(self, path: str | os.PathLike[str]) -> None:
        """Draws measured and predicted readings, residuals and correlations of the estimates: a
        .png, .svg or .pdf.
        """
        from matplotlib.figure import Figure

        path = Path(path)
        require(
            path.suffix in FIGURES, "path", f"the name of a file {' or '.join(FIGURES)}", str(path)
        )
        problem, t = self._problem, self._problem.log["t"]
        predicted, _ = problem.predict(self._found, slopes=False)
        figure = Figure(figsize=(11.0, 2.2 * len(problem.sensors) + 4.5), layout="constrained")
        grid = figure.add_gridspec(
            len(problem.sensors) + 1, 2, height_ratios=[1.0] * len(problem.sensors) + [2.0]
        )
        for n, name in enumerate(problem.sensors):
            left, right = figure.add_subplot(grid[n, 0]), figure.add_subplot(grid[n, 1])
            left.plot(t, problem.log[name], ".", markersize=2, label="measured")
            left.plot(t, predicted[:, n, 0], linewidth=0.8, label="predicted")
            left.set(ylabel=f"{name} ({UNITS[name]})", xlim=(t[0], t[0] + 5.0))
            right.plot(t, problem.log[name] - predicted[:, n, 0], ".", markersize=2)
            right.set(ylabel="residual")
        figure.axes[0].legend(loc="upper right")
        axes = figure.add_subplot(grid[-1, :])
        names = list(self.estimates)
        image = axes.imshow(
            np.atleast_2d(np.corrcoef(self.samples.T)), vmin=-1.0, vmax=1.0, cmap="RdBu"
        )
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
            units), at least one of the first two. A reading may be missing: NaN, or an empty cell.
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
        UserWarning: if the model does not explain the log, if the log does not determine a constant
            of the prior, or if an estimate lies at the end of its range.
    """
    from capsule_gym.identification.shooting import DISTANCE, ShootingProblem  # needs scipy

    require(
        known is None or isinstance(known, Mapping),
        "known",
        "a dict of numbers by name",
        known,
        TypeError,
    )
    columns, prior, known = read_log(log), Randomization.named(prior, "prior"), dict(known or {})
    physics_dt = check_number(
        "physics_dt", physics_dt, "a number of s from 1e-5 to 0.01", 1e-5, 0.01
    )
    for name, value in known.items():
        if name not in QUANTITIES:
            raise ValueError(
                f"known must have keys out of {QUANTITIES}, got {name!r}{nearest(str(name), QUANTITIES)}"
            )
        low, high = Disturbances.limits(name) if name in OTHERS else (-math.inf, math.inf)
        known[name] = check_number(
            f"known[{name!r}]", value, f"a finite number from {low:g} to {high:g}", low, high
        )
    constants: dict[str, Any] = {name: value for name, value in known.items() if name in PLANT}
    settings = describe(EnvConfig(control_dt=physics_dt, physics_dt=physics_dt), None).settings
    unknown: dict[str, Any] = dict.fromkeys(constants)
    for corner in replace(prior, **unknown).corners(Capsule(**constants)):
        check_step(corner, corner.M, corner.mu, settings)
    ranges = {}
    for name in QUANTITIES:
        given = getattr(prior, name, None) or RANGES.get(name)
        if given and name not in known and (name[-5:] != "_bias" or name[:-5] in columns):
            if given[0] < given[1]:
                ranges[name] = given
            else:
                known[name] = given[0]
    if not ranges:
        raise ValueError(
            f"known and prior must leave a quantity to estimate, got known={known} and prior={prior}"
        )
    problem = ShootingProblem(
        columns, ranges, prior.log_mu, {**dict.fromkeys(OTHERS, 0.0), **known}, physics_dt
    )
    # With an unknown static ratio, at which the likelihood jumps, a search would end anywhere.
    smooth = problem.at("static_ratio", RATIO) if "static_ratio" in ranges else problem
    states = smooth.cut(SHORT)
    starts = [np.array([start.get(name, 0.5) for name in smooth.names]) for start in STARTS]
    fits = sorted(
        (smooth.fit(np.append(shares, states), tolerance=1.0) for shares in starts),
        key=itemgetter(1),
    )
    states = smooth.cut(DISTANCE)
    fits = [
        smooth.fit(np.append(end[: len(smooth.names)], states), tolerance=1.0)
        for end, _ in fits[:KEPT]
    ]
    for _ in range(2):
        fits.sort(key=itemgetter(1))
        smooth.estimate_noise(fits[0][0])
        # Equal ends are one.
        fits = [end for end in fits if end is fits[0] or end[1] > fits[0][1] + 3.0]
        fits = [smooth.fit(unknowns, tolerance=1.0) for unknowns, _ in fits]
    fits.sort(key=itemgetter(1))
    problem.noise, problem.segments = smooth.noise, smooth.segments
    found = (
        fits[0][0]
        if smooth is problem
        else np.insert(fits[0][0], problem.names.index("static_ratio"), RATIO)
    )
    shares, found = problem.posterior(found)
    drawn, _ = problem.values(shares)
    samples = np.transpose([drawn[name] for name in problem.names])
    estimates = dict(zip(problem.names, samples.mean(axis=0).tolist(), strict=True))
    values = {**problem.known, **estimates}
    constants = {name: values[name] for name in PLANT if name in values}
    errors: dict[str, Any] = {name: values[name] for name in OTHERS}
    if "x" in columns:
        errors["x_noise"] = math.hypot(*problem.noise["x"][:2])
    for name in set(SENSORS) & set(columns):
        errors[f"{name}_noise"], errors[f"{name}_drift"], errors["drift_time"] = problem.noise[name]
    fit = Fit(
        estimates=estimates,
        samples=samples,
        capsule=Capsule(**constants),
        disturbances=Disturbances(
            **errors, unmeasured=tuple(name for name in SENSORS if name not in columns)
        ),
        chi2=problem.statistic(found),
        minima=tuple(round(float(cost), 1) for _, cost in fits),
        widths=dict(
            zip(problem.names, (math.sqrt(12.0) * shares.std(axis=0)).tolist(), strict=True)
        ),
        _problem=problem,
        _found=found,
    )
    doubts = []
    if fit.chi2 > LARGEST_CHI2:
        doubts.append(
            f"chi2 is {fit.chi2:.2f}: the model does not explain the log, and the intervals are too short"
        )
    if not {"x", "x_dot"} & set(columns):
        doubts.append(
            "log has neither x nor x_dot: the intervals of M, mu, m, l and k may be too short"
        )
    # The table shows what else is open.
    if open_ones := [
        name for name, width in fit.widths.items() if width > OPEN and name not in RANGES
    ]:
        doubts.append(
            f"the log does not determine {', '.join(open_ones)}: the intervals are the prior's"
        )
    names, best = np.array(problem.names), found[: len(problem.names)]
    at_end = ((best <= 0.0) | (best >= 1.0)) & (np.array(list(fit.widths.values())) < 0.1)
    if at_end.any():
        doubts.append(
            f"{', '.join(names[at_end])} lies at the end of its range: give a wider prior"
        )
    for doubt in doubts:
        warnings.warn(doubt, UserWarning, stacklevel=2)
    return fit
