"""The likelihood of a log by multiple shooting (Bock, 1981).

The log is cut into segments, whose initial states are estimated together with the constants; the
end of a segment must meet the start of the next. Predictions and derivatives come from the core
(`derivatives`). The errors of a sensor are a bias, white noise and a Gauss-Markov drift, whose
sizes follow from the residuals.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from capsule_gym.core import _core
from capsule_gym.identification.derivatives import PLANT, STATE, simulate, trajectory_inputs
from capsule_gym.parameters import REAL, SENSORS, Capsule

try:
    from scipy.interpolate import Akima1DInterpolator, CubicHermiteSpline
    from scipy.linalg import LinAlgError, cho_factor, cho_solve
    from scipy.linalg.lapack import dpttrf, dtbtrs
    from scipy.optimize import minimize
    from scipy.signal import lfilter
except ImportError as error:
    raise ImportError('identify needs scipy: pip install "capsule-gym[identify]"') from error

# Standard deviations of noise and drift before they are estimated; the position's are this
# project's choice.
NOISE = {name: (getattr(REAL, f"{name}_noise"), getattr(REAL, f"{name}_drift")) for name in SENSORS}
NOISE["x"] = 0.01, 0.01
# The drift's time constant before it is estimated, s.
DRIFT_TIME = 0.05
# Distance between the starts of segments, s.
DISTANCE = 0.8
# Standard deviation of a gap over that of a reading.
GAP = 0.02
# Largest number of steps of a fit, and of attempts in each.
MOST_STEPS = 15
MOST_ATTEMPTS = 8
# The reduction of the sum of squares that ends the last fits.
FINEST = 0.03
# The number of samples of a posterior, and of the draws from which they are chosen.
SAMPLES = 5000
PROPOSALS = 200_000
# The quantities over which the others are fitted, and the shares of their ranges at which they are.
PROFILED = ("static_ratio", "lag")
NODES = np.linspace(0.0, 1.0, 7)
# The rows of a trajectory's inputs where its initial state and its torques begin.
FIRST_STATE = _core.TRAJECTORY.index(STATE[0])
FIRST_TORQUE = len(_core.TRAJECTORY)


@dataclass
class ShootingProblem:
    """The least-squares problem of a log.

    The unknowns are the shares of the ranges, then the states at the starts of the segments.
    """

    log: dict[str, np.ndarray]
    ranges: dict[str, tuple[float, float]]
    log_mu: bool
    known: dict[str, float]
    physics_dt: float
    # Deviation of the noise, deviation of the drift and its time constant (s), by sensor.
    noise: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    # The first reading of each segment, and the one behind its last.
    segments: list[tuple[int, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        t = self.log["t"]
        self.period = (t[-1] - t[0]) / (len(t) - 1)
        self.steps = math.ceil(self.period / self.physics_dt - 1e-6)
        self.h = self.period / self.steps
        self.names = list(self.ranges)
        self.sensors = [name for name in STATE if name in self.log]
        # The components of a segment's state that are unknown: x itself acts on nothing but its
        # sensor.
        self.components = [n for n, name in enumerate(STATE) if name != "x" or "x" in self.log]
        # The unknown quantities on which the motion depends.
        self.moving = [n for n, name in enumerate(self.names) if name in PLANT or name == "lag"]
        self.low, self.high = np.reshape(list(self.ranges.values()), (-1, 2)).T
        # Constants of the plant act by their products: on a logarithmic scale what a log leaves
        # open is straight.
        constant = np.array([name in PLANT for name in self.names], np.bool_)
        ones = np.ones(len(self.names))
        ratios = np.divide(self.high, self.low, out=ones, where=constant & (self.low > 0.0))
        self.growths = np.log(ratios)
        # The density of a prior that is uniform in the quantity itself grows with it.
        uniform_in_log = [name == "mu" and self.log_mu for name in self.names]
        self.densities = np.where(uniform_in_log, 0.0, self.growths)
        latest = self.ranges["latency"][1] if "latency" in self.ranges else self.known["latency"]
        # Readings before the first of a segment, which begins earlier by the longest latency.
        self.lead = math.ceil((latest + self.h) / self.period - 1e-9)
        self.commands = np.repeat(self.log["torque"], self.steps)
        self.noise = self.noise or {name: (*NOISE[name], DRIFT_TIME) for name in self.sensors}

    def values(self, shares: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
        """The quantities in SI units, and the derivatives of the unknown ones by their shares."""
        logarithmic = self.growths > 0.0
        widths = self.high - self.low
        exponential = self.low * np.exp(self.growths * shares)
        found = np.where(logarithmic, exponential, self.low + shares * widths)
        slopes = np.where(logarithmic, found * self.growths, widths)
        unknown = dict(zip(self.names, found.T.tolist(), strict=True))
        return {**self.known, **unknown}, slopes

    def cut(self, seconds: float = DISTANCE) -> np.ndarray:
        """Cuts the log into segments of a duration that begin every DISTANCE seconds.

        Returns:
            Their initial states, guessed from the readings, shape (segments * components,).
        """
        t = self.log["t"]
        size = round(seconds / self.period)
        starts = range(self.lead, len(t) - size // 2, round(DISTANCE / self.period))
        self.segments = [(first, min(first + size, len(t))) for first in starts]
        columns: list[np.ndarray] = []
        for name in STATE:
            if name in self.log:
                known = np.isfinite(self.log[name])
                columns.append(np.interp(t, t[known], self.log[name][known]))
            elif name.removesuffix("_dot") in self.log:
                # The column before is that of the position.
                columns.append(np.gradient(columns[-1], t))
            else:
                columns.append(np.zeros(len(t)))
        states = np.transpose(columns)[list(starts)]
        return states[:, self.components].ravel()

    def rows(self, name: str) -> np.ndarray:
        """The rows within the segments in which a sensor has a reading."""
        inside = np.concatenate([np.arange(*ends) for ends in self.segments])
        return inside[np.isfinite(self.log[name][inside])]

    def whiten(self, errors: np.ndarray) -> tuple[np.ndarray, float]:
        """Whitens errors, one sensor after the other.

        What remains of an error after the share of the last one that the drift keeps has a
        tridiagonal covariance.

        Returns:
            The whitened errors, and the logarithm of the determinant of the errors' covariance.
        """
        rows = [self.rows(name) for name in self.sensors]
        sizes = [self.noise[name] for name in self.sensors]
        noise, drift, time = np.repeat(sizes, [len(own) for own in rows], axis=0).T
        # The first reading of a sensor keeps nothing.
        distances = np.hstack([np.diff(own, prepend=-np.inf) for own in rows])
        kept = np.exp(-distances * self.period / time)
        changes = np.concatenate([errors[own, n] for n, own in enumerate(rows)])
        changes[1:] -= kept[1:, None] * changes[:-1]
        variances = drift**2 * (1.0 - kept**2) + noise**2 * (1.0 + kept**2)
        diagonal, below, _ = dpttrf(variances, -kept[1:] * noise[1:] ** 2)
        # `cholesky_banded` and `solve_banded` take twice as long.
        white, _ = dtbtrs([diagonal, np.append(below, 0.0)], changes, uplo="L", diag="U")
        return white / np.sqrt(diagonal)[:, None], np.log(diagonal).sum()

    def motor_torque(self, lag: float) -> tuple[np.ndarray, np.ndarray]:
        """The motor's torque at every step of the integrator, and its derivative by the lag.

        The torque is that of `Disturbed::drive`; without a lag it is the command. The derivative is
        the imaginary part after an imaginary step of the lag (Squire and Trapp, 1998).
        """
        share = 1.0 - np.exp(-self.h / (max(lag, 1e-9) + 1e-30j))
        torque = lfilter([share], [1.0, share - 1.0], self.commands)
        return torque.real, 1e30 * torque.imag

    def interpolation(self, latency: float) -> tuple[int, np.ndarray]:
        """Interpolates between two steps of the integrator by cubics with the rates at both.

        Returns:
            Steps from the first of the two to the reading; the weights of value and rate at each,
            for the interpolated value and its first two derivatives, shape (3, 2, 2).
        """
        late = math.ceil(latency / self.h)
        # Four cubics: of each, a value or a rate at one end is 1, and the others are 0.
        unit = np.eye(4)
        cubics = CubicHermiteSpline([0.0, 1.0], unit[::2], self.h * unit[1::2])
        place = late - latency / self.h
        weights = [cubics(place, order) / self.h**order for order in range(3)]
        return late, np.reshape(weights, (3, 2, 2))

    def partials(self, scale: np.ndarray, torque_by_lag: np.ndarray) -> np.ndarray:
        """The derivatives of a segment's inputs by `moving` shares, then by its unknown state."""
        moving, width = len(self.moving), len(self.components)
        found = np.zeros((FIRST_TORQUE + len(torque_by_lag), moving + width))
        for column, n in enumerate(self.moving):
            if self.names[n] == "lag":
                found[FIRST_TORQUE:, column] = torque_by_lag * scale[n]
            else:
                found[_core.TRAJECTORY.index(self.names[n]), column] = scale[n]
        rows = FIRST_STATE + np.array(self.components)
        found[rows, moving + np.arange(width)] = 1.0
        return found

    def predict(self, unknowns: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Predicts the readings of a log, and the gaps between its segments.

        Returns:
            Readings, shape (rows, sensors, 1 + unknowns), value first; NaN outside the segments.
            Gaps, shape (gaps, components, 1 + unknowns).
        """
        count, width = len(self.names), len(self.components)
        values, scale = self.values(unknowns[:count])
        starts = unknowns[count:].reshape(-1, width)
        constants: dict[str, Any] = {name: values[name] for name in PLANT if name in values}
        capsule = Capsule(**constants)
        torque, torque_by_lag = self.motor_torque(values["lag"])
        late, weights = self.interpolation(values["latency"])
        sensed = [STATE.index(name) for name in self.sensors]
        columns = 1 + len(unknowns) * slopes
        readings = np.full((len(self.log["t"]), len(sensed), columns), np.nan)
        gaps = np.zeros((len(self.segments) - 1, width, columns))
        for n, (first, last) in enumerate(self.segments):
            begin = (first - self.lead) * self.steps
            end = (last - 1) * self.steps + 1
            state = np.zeros(4)
            state[self.components] = starts[n]
            inputs = trajectory_inputs(capsule, state, torque[begin:end])
            partials = self.partials(scale, torque_by_lag[begin:end])
            own = count + n * width + np.arange(width)
            filled = np.concatenate([[0], 1 + np.array(self.moving, int), 1 + own])
            if not slopes:
                partials, filled = partials[:, :0], filled[:1]
            grid, rates, _ = simulate(inputs, partials, 1, self.h)
            motion = np.concatenate([grid[:, :4, None], rates], axis=2)
            places = np.arange(first, last) * self.steps - begin - late
            states, speeds = interpolate(motion, places, weights)
            inside = readings[first:last]
            inside[...] = 0.0
            inside[..., filled] = states[:, sensed]
            if slopes and "latency" in self.names:
                latency = self.names.index("latency")
                inside[..., 1 + latency] = -speeds[:, sensed] * scale[latency]
            if n < len(gaps) and self.segments[n + 1][0] == last:
                met = motion[(last - self.lead) * self.steps - begin]
                gaps[n][:, filled] = met[self.components]
                gaps[n, :, 0] -= starts[n + 1]
                if slopes:
                    gaps[n, np.arange(width), 1 + own + width] -= 1.0
        for n, name in enumerate(self.sensors):
            bias = f"{name}_bias"
            readings[:, n, 0] += values.get(bias, 0.0)
            if slopes and bias in self.names:
                unknown = self.names.index(bias)
                readings[:, n, 1 + unknown] = scale[unknown]
        return readings, gaps

    def errors(self, unknowns: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Predicted minus measured readings, and the gaps, as `predict` returns them."""
        errors, gaps = self.predict(unknowns, slopes)
        errors[..., 0] -= np.transpose([self.log[name] for name in self.sensors])
        return errors, gaps

    def residuals(self, unknowns: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals, then the gaps in units of their deviations; and their Jacobian."""
        errors, gaps = self.errors(unknowns, slopes)
        sizes = []
        for n in self.components:
            noise, drift, *_ = self.noise.get(STATE[n], NOISE[STATE[n]])
            sizes.append(noise + drift)
        scaled = gaps / (GAP * np.array(sizes)[:, None])
        white, _ = self.whiten(errors)
        whole = np.concatenate([white, scaled.reshape(-1, gaps.shape[2])])
        return whole[:, 0], whole[:, 1:]

    def free(self, unknowns: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Whether the sum of squares falls within the ranges along each unknown."""
        at_low = (unknowns <= 0.0) & (gradient > 0.0)
        at_high = (unknowns >= 1.0) & (gradient < 0.0)
        state = np.arange(len(unknowns)) >= len(self.names)
        return state | ~(at_low | at_high)

    def fit(self, unknowns: np.ndarray, tolerance: float) -> tuple[np.ndarray, float]:
        """Minimises the sum of squares, until a step reduces it by less than the tolerance.

        The method of Levenberg and Marquardt on the normal equations, within the ranges:
        `scipy.optimize.least_squares` decomposes the Jacobian of all readings in every step, which
        takes ten times as long.

        Returns:
            The unknowns and the sum.
        """
        count = len(self.names)
        damping = 1e-3
        for _ in range(MOST_STEPS):
            r, jacobian = self.residuals(unknowns)
            cost = r @ r
            gradient = jacobian.T @ r
            normal = jacobian.T @ jacobian
            free = self.free(unknowns, gradient)
            for _ in range(MOST_ATTEMPTS):
                damped = normal + np.diag(damping * np.diag(normal) + 1e-6)
                step = np.zeros(len(unknowns))
                try:
                    factor = cho_factor(damped[np.ix_(free, free)])
                    step[free] = -cho_solve(factor, gradient[free])
                except LinAlgError:
                    damping *= 10.0
                    continue
                if -gradient @ step < tolerance:  # the reduction of a linear problem
                    return unknowns, cost
                trial = unknowns + step
                trial[:count] = np.clip(trial[:count], 0.0, 1.0)
                r, _ = self.residuals(trial, slopes=False)
                if r @ r < cost:
                    break
                damping *= 10.0
            else:
                return unknowns, cost
            unknowns = trial
            damping = max(damping / 3.0, 1e-9)
            if cost - r @ r < tolerance:
                break
        return unknowns, r @ r

    def estimate_noise(self, unknowns: np.ndarray) -> None:
        """Sets sizes of noise and drift, and the drift's time, to those of largest likelihood."""
        errors, _ = self.errors(unknowns, slopes=False)

        def set_noise(logarithms: np.ndarray) -> None:
            *sizes, time = np.exp(logarithms)
            pairs = np.reshape(sizes, (-1, 2))
            self.noise = {
                name: (*pair, time) for name, pair in zip(self.sensors, pairs, strict=True)
            }

        def likelihood(logarithms: np.ndarray) -> float:
            set_noise(logarithms)
            r, determinant = self.whiten(errors)
            return np.sum(r**2) + determinant

        # Half of the variance is the noise's, half the drift's.
        sizes = np.repeat(0.5 * np.log(np.nanvar(errors, axis=0) / 2.0), 2)
        bounds = [(size - 7.0, size + 2.0) for size in sizes]
        bounds.append((math.log(0.5 * self.period), 0.0))
        start = np.append(sizes, math.log(DRIFT_TIME))
        set_noise(minimize(likelihood, start, method="L-BFGS-B", bounds=bounds).x)

    def at(self, name: str, share: float) -> "ShootingProblem":
        """The problem in which a quantity is known, with the value at this share of its range."""
        values, _ = self.values(np.full(len(self.names), share))
        ranges = {other: limits for other, limits in self.ranges.items() if other != name}
        return replace(self, ranges=ranges, known={**self.known, name: values[name]})

    def posterior(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Samples the posterior distribution of the shares, from unknowns near its largest density.

        The likelihood is approximated as normal in the ranges, but for two quantities, over which
        the others are fitted. With the static ratio it jumps; the others are those of its best
        value. Lag and latency act alike along a curve; the others are interpolated between several
        lags.

        Returns:
            Samples, shape (samples, shares), and the unknowns of the largest likelihood.
        """
        name = next((each for each in PROFILED if each in self.names), None)
        if name is None:
            unknowns, _ = self.fit(unknowns, FINEST)
            return self.laplace(unknowns), unknowns
        place = self.names.index(name)
        problems = [self.at(name, node) for node in NODES]
        found, costs = fit_nodes(problems, unknowns, place)
        best = np.argmin(costs)
        generator = np.random.default_rng(0)
        drawn = self.draw_profiled(place, costs, generator)
        if name == "lag":
            samples = sample_between(problems, found, drawn)
            unknowns, _ = self.fit(np.insert(found[best], place, NODES[best]), FINEST)
        else:
            samples, end = problems[best].posterior(found[best])
            # The other draws have the same seed: in their order all would rise with the static
            # ratio.
            samples = generator.permutation(samples)
            unknowns = np.insert(end, place, NODES[best])
        return np.insert(np.clip(samples, 0.0, 1.0), place, drawn, axis=1), unknowns

    def draw_profiled(
        self, place: int, costs: np.ndarray, generator: np.random.Generator
    ) -> np.ndarray:
        """Samples of the share of a profiled quantity, from the sums of squares at the nodes."""
        shares = (np.arange(1000) + 0.5) / 1000.0
        if self.names[place] == "lag":
            cost = Akima1DInterpolator(NODES, costs)(shares)
        else:
            # Where the likelihood jumps, it may be as large in between as at the better end.
            intervals = (shares * (len(NODES) - 1)).astype(int)
            cost = np.minimum(costs[:-1], costs[1:])[intervals]
        density = np.exp(-0.5 * (cost - cost.min()) + shares * self.densities[place])
        return generator.choice(shares, SAMPLES, p=density / density.sum())

    def laplace(self, unknowns: np.ndarray) -> np.ndarray:
        """Samples the normal approximation of the likelihood in the ranges.

        Returns:
            Shares, shape (samples, shares).
        """
        r, jacobian = self.residuals(unknowns)
        count = len(self.names)
        # Drawn with a normal prior as wide as the ranges, which the weights take back.
        prior = np.where(np.arange(len(unknowns)) < count, 1.0, 1e-6)
        covariance = np.linalg.inv(jacobian.T @ jacobian + np.diag(prior))
        middle = unknowns + covariance @ (prior * (0.5 - unknowns) - jacobian.T @ r)
        factor = np.linalg.cholesky(covariance[:count, :count])
        generator = np.random.default_rng(0)
        drawn = middle[:count] + generator.standard_normal((PROPOSALS, count)) @ factor.T
        inside = ((drawn >= 0.0) & (drawn <= 1.0)).all(axis=1)
        # A likelihood far outside of the ranges, which hardly any sample meets.
        drawn = drawn[inside] if inside.sum() > 500 else np.clip(drawn, 0.0, 1.0)
        undone = 0.5 * np.sum((drawn - 0.5) ** 2, axis=1)
        weights = np.exp(undone + (drawn - 1.0) @ self.densities)
        return drawn[generator.choice(len(drawn), SAMPLES, p=weights / weights.sum())]

    def statistic(self, unknowns: np.ndarray) -> float:
        """How much of the whitened residuals past torques and the predicted motion explain.

        It is a chi-square per degree of freedom (Ljung, System Identification, Sect. 16.6), about 1
        for noise.
        """
        predicted, _ = self.predict(unknowns, slopes=False)
        motion = np.nan_to_num(predicted[..., 0])
        torque = self.log["torque"]
        regressors = [np.ones(len(torque))]
        # The present torque may follow from the present reading.
        for lag in range(1, round(1.0 / self.period), max(1, round(0.01 / self.period))):
            regressors.append(np.append(np.zeros(lag), torque[: len(torque) - lag]))
        for column in motion.T:
            regressors += [np.sign(column), np.abs(column)]
        X = np.transpose(regressors)
        r, _ = self.residuals(unknowns, slopes=False)
        total = 0.0
        for name in self.sensors:
            rows = self.rows(name)
            own, r = np.split(r, [len(rows)])
            solution, _, rank, _ = np.linalg.lstsq(X[rows], own, rcond=1e-3)
            total += np.sum((X[rows] @ solution) ** 2) / (rank * len(self.sensors))
        return total


def interpolate(
    motion: np.ndarray, places: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolates between the integrator's steps at `places` and their next ones.

    Args:
        motion: states and their derivatives by step, shape (steps, 4, columns).
        places: the steps, shape (readings,).
        weights: those of `ShootingProblem.interpolation`.

    Returns:
        States, shape (readings, 4, columns), and the rates of their first column.
    """
    # Axes: reading, end, angle or position, value or rate, column.
    ends = motion[places[:, None] + [0, 1]].reshape(len(places), 2, 2, 2, -1)
    # Axes: order of the derivative, reading, angle or position, column.
    orders = np.tensordot(weights, ends, ((1, 2), (1, 3)))
    states = np.moveaxis(orders[:2], 0, 2).reshape(len(places), 4, -1)
    rates = np.moveaxis(orders[1:, ..., 0], 0, 2).reshape(len(places), 4)
    return states, rates


def fit_nodes(
    problems: list[ShootingProblem], unknowns: np.ndarray, place: int
) -> tuple[np.ndarray, np.ndarray]:
    """The unknowns and the sum of squares at each node, each fit from the nearest end."""
    ends = [(unknowns[place], np.delete(unknowns, place))]
    found = np.empty((len(NODES), len(unknowns) - 1))
    costs = np.empty(len(NODES))
    for n in np.argsort(np.abs(NODES - unknowns[place])):
        # The last of equally near ones: a fit at this very place.
        _, start = min(reversed(ends), key=lambda end: abs(end[0] - NODES[n]))
        found[n], costs[n] = problems[n].fit(start, FINEST)
        ends.append((NODES[n], found[n]))
    return found, costs


def sample_between(
    problems: list[ShootingProblem], found: np.ndarray, drawn: np.ndarray
) -> np.ndarray:
    """Samples of the other shares at drawn shares of the lag, from the fits at the nodes.

    Their mean is interpolated; their deviations from it are those at the nearest node.
    """
    parts = np.array([problem.laplace(end) for problem, end in zip(problems, found, strict=True)])
    middles = parts.mean(axis=1)
    deviations = parts - middles[:, None]
    nearest = np.abs(np.subtract.outer(drawn, NODES)).argmin(axis=1)
    return Akima1DInterpolator(NODES, middles)(drawn) + deviations[nearest, range(SAMPLES)]
