"""The result of an identification: estimates, intervals, files and figures."""

import json
import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsule_gym.checks import check_number, require, short_repr
from capsule_gym.envs.config import DIRECT_PHYSICS_DT
from capsule_gym.files import replacing, write_atomically
from capsule_gym.identification.derivatives import PLANT, subset
from capsule_gym.identification.log import UNITS
from capsule_gym.identification.ranges import DELAYS_AND_BIASES
from capsule_gym.parameters import Capsule, Disturbances, Randomization

if TYPE_CHECKING:
    from capsule_gym.identification.shooting import ShootingProblem

FIGURES = (".png", ".svg", ".pdf")
# Smallest square of a coefficient of an axis that is named.
SMALLEST_SHARE = 0.1
# The fields of a result that its file contains as they are.
SAVED = ("estimates", "chi2", "minima", "widths", "ranges", "physics_dt", "held_out")
# Width of an interval in units of the range's from which on it is the prior's.
OPEN = 0.8
# Share of an interval's length by which it may miss an end of the range.
MARGIN = 0.1
# Share of a log's rows that are fitted.
FITTED = 0.8


def fitted_rows(log: Mapping[str, np.ndarray]) -> int:
    """The number of a log's first rows that are fitted; the others are predicted."""
    return round(FITTED * len(log["t"]))


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
        physics_dt: integrator's step, s, of the environment whose latency and lag are estimated.
        held_out: root mean square of the errors of predicted readings in the last fifth of the log,
            which the fit does not use, by sensor.
    """

    estimates: dict[str, float]
    samples: np.ndarray = field(repr=False)
    capsule: Capsule
    disturbances: Disturbances
    chi2: float
    minima: tuple[float, ...]
    widths: dict[str, float]
    ranges: dict[str, tuple[float, float]]
    physics_dt: float = DIRECT_PHYSICS_DT
    held_out: dict[str, float] = field(default_factory=dict)
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
            # It would miss by chance an end at which a quantity may lie, such as no lag.
            least, most = self.ranges[name]
            margin = MARGIN * (high - low)
            if level < 1.0 and low - least <= margin:
                low = least
            if level < 1.0 and most - high <= margin:
                high = most
            found[name] = low, high
        return found

    def randomization(self, level: float = 0.95) -> Randomization:
        """The intervals of the plant's constants, from which a training can draw its plants."""
        return Randomization(**subset(self.intervals(level), PLANT))

    def env_kwargs(self, level: float = 0.95) -> dict[str, Any]:
        """Arguments of the environment that stands for the rig.

        Plants and disturbances are drawn from their intervals.
        """
        drawn = subset(self.intervals(level), DELAYS_AND_BIASES)
        kwargs = {
            "capsule": self.capsule,
            "randomization": self.randomization(level),
            "disturbances": replace(self.disturbances, **drawn),
        }
        if self.physics_dt != DIRECT_PHYSICS_DT:
            kwargs["physics_dt"] = self.physics_dt
        return kwargs

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
        for name, error in self.held_out.items():
            size = f"{error:.3g} {UNITS[name]}"
            rows.append(f"last fifth, not fitted: {name} is predicted with an error of {size}")
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

        The readings are those of the last fifth, which the fit does not use and which the residuals
        have behind a line.

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
        log = self._problem.log
        sensors = self._problem.sensors
        t = log["t"]
        held = fitted_rows(log)
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
            left.set_xlim(t[held], t[-1])
            right = figure.add_subplot(grid[n, 1])
            right.plot(t, log[name] - predicted, ".", markersize=2)
            right.axvline(t[held], color="black", linewidth=0.8)
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
