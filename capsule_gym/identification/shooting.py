"""The likelihood of a log by multiple shooting (Bock, 1981).

The log is cut into segments, whose initial states are estimated together with the constants; the
end of a segment must meet the start of the next. Predictions and derivatives come from the core
(`derivatives`). The errors of a sensor are a bias, white noise and a Gauss-Markov drift, whose
sizes follow from the residuals.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from capsule_gym.core import _core
from capsule_gym.core.layout import STATE
from capsule_gym.identification.derivatives import (
    NUM_INPUTS,
    PLANT,
    simulate,
    subset,
    trajectory_inputs,
)
from capsule_gym.parameters import REAL, SENSORS, Capsule

try:
    from scipy.interpolate import CubicHermiteSpline
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
# Smallest size of noise, SI units: that of rounding errors in a log without noise.
SMALLEST_NOISE = 1e-6
# Mean delay of the motor's torque, s, below which there is no lag.
SHORTEST_DELAY = 1e-6
# Largest number of steps of a fit, and of attempts in each.
MOST_STEPS = 15
MOST_ATTEMPTS = 8


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
        begin, *_, end = self.log["t"]
        self.period = (end - begin) / (len(self.log["t"]) - 1)
        self.steps = math.ceil(self.period / self.physics_dt - 1e-6)
        self.h = self.period / self.steps
        self.names = list(self.ranges)
        self.sensors = [name for name in STATE if name in self.log]
        # The components of a segment's state that are unknown: x itself acts on nothing but its
        # sensor.
        self.components = [n for n, name in enumerate(STATE) if name != "x" or "x" in self.log]
        # The unknown quantities on which the motion depends.
        self.moving = [n for n, name in enumerate(self.names) if name in PLANT or name == "lag"]
        limits = np.reshape(list(self.ranges.values()), (-1, 2))
        self.low, self.high = limits.T
        if "lag" in self.names:
            n = self.names.index("lag")
            self.low[n], self.high[n] = map(self.delay, self.ranges["lag"])
        # Constants of the plant act by their products: on a logarithmic scale what a log leaves
        # open is straight.
        ratios = np.ones(len(self.names))
        for n, name in enumerate(self.names):
            if name in PLANT and self.low[n] > 0.0:
                ratios[n] = self.high[n] / self.low[n]
        self.growths = np.log(ratios)
        # The density of a prior that is uniform in the quantity itself grows with it.
        uniform_in_log = [name == "mu" and self.log_mu for name in self.names]
        self.densities = np.where(uniform_in_log, 0.0, self.growths)
        longest = dict(self.known)
        for name, (_, high) in self.ranges.items():
            longest[name] = high
        latest = max(self.latency(name, longest) for name in self.sensors)
        # Readings before the first of a segment, which begins earlier by the longest latency.
        self.lead = math.ceil((latest + self.h) / self.period - 1e-9)
        self.commands = np.repeat(self.log["torque"], self.steps)
        if not self.noise:
            self.noise = {name: (*NOISE[name], DRIFT_TIME) for name in self.sensors}

    def delay(self, lag: float) -> float:
        """The mean delay, s, of a motor's torque with this lag in the integrator's steps."""
        kept = math.exp(-self.h / lag) if lag > 0.0 else 0.0
        return self.h * kept / (1.0 - kept)

    @staticmethod
    def latency(sensor: str, values: dict[str, float]) -> float:
        """The age of a sensor's readings, s."""
        return values["latency"] + values.get(f"{sensor}_latency", 0.0)

    def values(self, shares: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
        """The quantities in SI units, and the derivatives of the unknown ones by their shares.

        That of the lag is the derivative of its mean delay, on which the motion depends as on a
        latency; by the lag itself the derivative would be 0 at a lag of 0.
        """
        logarithmic = self.growths > 0.0
        widths = self.high - self.low
        exponential = self.low * np.exp(self.growths * shares)
        found = np.where(logarithmic, exponential, self.low + shares * widths)
        slopes = np.where(logarithmic, found * self.growths, widths)
        if "lag" in self.names:
            n = self.names.index("lag")
            delays = np.maximum(found[..., n], SHORTEST_DELAY)
            lags = self.h / np.log1p(self.h / delays)
            found[..., n] = np.where(found[..., n] > SHORTEST_DELAY, lags, 0.0)
        unknown = dict(zip(self.names, found.T.tolist(), strict=True))
        return {**self.known, **unknown}, slopes

    def cut(self, seconds: float = DISTANCE) -> np.ndarray:
        """Cuts the log into segments of a duration that begin every DISTANCE seconds.

        Returns:
            Their initial states, guessed from the readings, shape (segments * components,).
        """
        t = self.log["t"]
        count = len(t)
        size = round(seconds / self.period)
        stride = round(DISTANCE / self.period)
        starts = range(self.lead, count - size // 2, stride)
        self.segments = [(first, min(first + size, count)) for first in starts]
        columns: list[np.ndarray] = []
        for name in STATE:
            if name in self.log:
                readings = self.log[name]
                known = np.isfinite(readings)
                columns.append(np.interp(t, t[known], readings[known]))
            elif name.removesuffix("_dot") in self.log:
                # The column before is that of the position.
                columns.append(np.gradient(columns[-1], t))
            else:
                columns.append(np.zeros(count))
        states = np.transpose(columns)[list(starts)]
        return states[:, self.components].ravel()

    def extended(self, log: dict[str, np.ndarray]) -> "ShootingProblem":
        """The problem of a longer log, whose further rows belong to the last segment."""
        whole = replace(self, log=log)
        first, _ = self.segments[-1]
        whole.segments = [*self.segments[:-1], (first, len(log["t"]))]
        return whole

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
        counts = [len(own) for own in rows]
        sizes = [self.noise[name] for name in self.sensors]
        noise, drift, time = np.repeat(sizes, counts, axis=0).T
        # The first reading of a sensor keeps nothing.
        distances = np.hstack([np.diff(own, prepend=-np.inf) for own in rows])
        kept = np.exp(-distances * self.period / time)
        changes = np.concatenate([errors[own, n] for n, own in enumerate(rows)])
        changes[1:] -= kept[1:, None] * changes[:-1]
        variances = drift**2 * (1.0 - kept**2) + noise**2 * (1.0 + kept**2)
        covariances = -kept[1:] * noise[1:] ** 2
        # `cholesky_banded` and `solve_banded` take twice as long.
        diagonal, below, _ = dpttrf(variances, covariances)
        factor = [diagonal, np.append(below, 0.0)]
        white, _ = dtbtrs(factor, changes, uplo="L", diag="U")
        deviations = np.sqrt(diagonal)
        return white / deviations[:, None], np.log(diagonal).sum()

    def motor_torque(self, lag: float) -> tuple[np.ndarray, np.ndarray]:
        """The motor's torque at every step of the integrator, and its derivative by the mean delay.

        The torque is that of `Disturbed::drive`; without a lag it is the command. The derivative is
        the imaginary part after an imaginary step of the delay (Squire and Trapp, 1998).
        """
        share = self.h / (self.h + self.delay(lag) + 1e-30j)
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

    def partials(self, scale: np.ndarray, torque_by_delay: np.ndarray) -> np.ndarray:
        """The derivatives of a segment's inputs by `moving` shares, then by its unknown state."""
        inputs = NUM_INPUTS + len(torque_by_delay)
        moving = np.zeros((inputs, len(self.moving)))
        for column, n in enumerate(self.moving):
            name = self.names[n]
            if name == "lag":
                moving[NUM_INPUTS:, column] = torque_by_delay * scale[n]
            else:
                moving[_core.TRAJECTORY.index(name), column] = scale[n]
        state = np.zeros((inputs, len(self.components)))
        for column, component in enumerate(self.components):
            state[_core.TRAJECTORY.index(STATE[component]), column] = 1.0
        return np.hstack([moving, state])

    def predict(self, unknowns: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Predicts the readings of a log, and the gaps between its segments.

        Returns:
            Readings, shape (rows, sensors, 1 + unknowns), value first; NaN outside the segments.
            Gaps, shape (gaps, components, 1 + unknowns).
        """
        count, width = len(self.names), len(self.components)
        values, scale = self.values(unknowns[:count])
        starts = unknowns[count:].reshape(-1, width)
        capsule = Capsule(**subset(values, PLANT))
        torque, torque_by_delay = self.motor_torque(values["lag"])
        rows = len(self.log["t"])
        columns = 1 + len(unknowns) * slopes
        readings = np.full((rows, len(self.sensors), columns), np.nan)
        gaps = np.zeros((len(self.segments) - 1, width, columns))
        speeds = np.zeros((rows, len(self.sensors)))
        clocks = self.clocks(values)
        for n, (first, last) in enumerate(self.segments):
            begin = (first - self.lead) * self.steps
            end = (last - 1) * self.steps + 1
            state = np.zeros(4)
            state[self.components] = starts[n]
            inputs = trajectory_inputs(capsule, state, torque[begin:end])
            partials = self.partials(scale, torque_by_delay[begin:end])
            own = 1 + count + n * width + np.arange(width)
            filled = np.concatenate([[0], 1 + np.array(self.moving, int), own])
            if not slopes:
                partials = partials[:, :0]
                filled = filled[:1]
            grid, rates, _ = simulate(inputs, partials, 1, self.h)
            motion = np.concatenate([grid[:, :4, None], rates], axis=2)
            places = np.arange(first, last) * self.steps - begin
            inside = readings[first:last]
            inside[...] = 0.0
            for late, weights, sensors, sensed in clocks:
                states, state_rates = interpolate(motion, places - late, weights)
                inside[:, sensors[:, None], filled] = states[:, sensed]
                speeds[first:last, sensors] = state_rates[:, sensed]
            if n < len(gaps) and self.segments[n + 1][0] == last:
                met = motion[(last - self.lead) * self.steps - begin]
                gaps[n][:, filled] = met[self.components]
                gaps[n, :, 0] -= starts[n + 1]
                if slopes:
                    gaps[n, np.arange(width), own + width] -= 1.0
        for n, name in enumerate(self.sensors):
            readings[:, n, 0] += values.get(f"{name}_bias", 0.0)
        if slopes:
            self.add_slopes_of_sensors(readings, speeds, scale)
        return readings, gaps

    def clocks(
        self, values: dict[str, float]
    ) -> list[tuple[int, np.ndarray, np.ndarray, list[int]]]:
        """The sensors by their latency.

        Returns:
            For each latency the steps and weights of `interpolation`, its sensors by number, and
            their components of the state.
        """
        latencies = np.array([self.latency(name, values) for name in self.sensors])
        found = []
        for latency in np.unique(latencies):
            sensors = np.flatnonzero(latencies == latency)
            sensed = [STATE.index(self.sensors[n]) for n in sensors]
            found.append((*self.interpolation(latency), sensors, sensed))
        return found

    def add_slopes_of_sensors(
        self, readings: np.ndarray, speeds: np.ndarray, scale: np.ndarray
    ) -> None:
        """Adds the derivatives of predicted readings by biases and latencies.

        Args:
            readings: those of `predict`.
            speeds: their rates, shape (rows, sensors).
            scale: derivatives of the quantities by their shares.
        """
        for n, name in enumerate(self.sensors):
            slopes = {f"{name}_bias": 1.0, "latency": -speeds[:, n]}
            slopes[f"{name}_latency"] = slopes["latency"]
            for quantity in slopes.keys() & set(self.names):
                unknown = self.names.index(quantity)
                readings[:, n, 1 + unknown] = slopes[quantity] * scale[unknown]

    def errors(self, unknowns: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Predicted minus measured readings, and the gaps, as `predict` returns them."""
        errors, gaps = self.predict(unknowns, slopes)
        measured = [self.log[name] for name in self.sensors]
        errors[..., 0] -= np.transpose(measured)
        return errors, gaps

    def residuals(self, unknowns: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals, then the gaps in units of their deviations; and their Jacobian."""
        errors, gaps = self.errors(unknowns, slopes)
        sizes = []
        for n in self.components:
            name = STATE[n]
            noise, drift, *_ = self.noise.get(name, NOISE[name])
            sizes.append([noise + drift])
        scaled = gaps / (GAP * np.array(sizes))
        white, _ = self.whiten(errors)
        whole = np.vstack([white, *scaled])
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

    def estimate_noise(self, unknowns: np.ndarray) -> bool:
        """Sets sizes of noise and drift, and the drift's time, to those of largest likelihood.

        Returns:
            Whether the errors of a sensor fall by more than half.
        """
        before = np.array([*self.noise.values()])
        errors, _ = self.errors(unknowns, slopes=False)

        def set_noise(logarithms: np.ndarray) -> None:
            *sizes, time = np.exp(logarithms)
            pairs = np.reshape(sizes, (-1, 2))
            self.noise = {}
            for name, (noise, drift) in zip(self.sensors, pairs, strict=True):
                self.noise[name] = noise, drift, time

        def likelihood(logarithms: np.ndarray) -> float:
            set_noise(logarithms)
            r, determinant = self.whiten(errors)
            return np.sum(r**2) + determinant

        # Half of the variance is the noise's, half the drift's.
        deviations = np.sqrt(np.nanvar(errors, axis=0).ravel() / 2.0)
        smallest = math.log(SMALLEST_NOISE)
        sizes = np.repeat(np.log(np.maximum(deviations, SMALLEST_NOISE)), 2)
        bounds = [(max(size - 7.0, smallest), size + 2.0) for size in sizes]
        bounds.append((math.log(0.5 * self.period), 0.0))
        start = np.append(sizes, math.log(DRIFT_TIME))
        set_noise(minimize(likelihood, start, method="L-BFGS-B", bounds=bounds).x)
        after = np.array([*self.noise.values()])
        sizes_before, sizes_after = (np.hypot(*each[:, :2].T) for each in (before, after))
        return bool((sizes_after < 0.5 * sizes_before).any())

    def at(self, name: str, share: float) -> "ShootingProblem":
        """The problem in which a quantity is known, with the value at this share of its range."""
        values, _ = self.values(np.full(len(self.names), share))
        known = {**self.known, name: values[name]}
        ranges = dict(self.ranges)
        del ranges[name]
        return replace(self, ranges=ranges, known=known)

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
            past = torque[: len(torque) - lag]
            regressors.append(np.append(np.zeros(lag), past))
        for column in motion.T:
            regressors += [np.sign(column), np.abs(column)]
        X = np.transpose(regressors)
        r, _ = self.residuals(unknowns, slopes=False)
        total = 0.0
        for name in self.sensors:
            own_X = X[self.rows(name)]
            own, r = np.split(r, [len(own_X)])
            solution, _, rank, _ = np.linalg.lstsq(own_X, own, rcond=1e-3)
            explained = np.sum((own_X @ solution) ** 2)
            total += explained / (rank * len(self.sensors))
        return total


def interpolate(
    motion: np.ndarray, places: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolates between the integrator's steps at `places` and their next ones.

    Args:
        motion: states (theta, theta_dot, x, x_dot) by step, shape (steps, 4, columns). The first
            column is the state; the others are its derivatives by the parameters.
        places: the steps, shape (readings,). All readings lie at the same share of a step.
        weights: those of `ShootingProblem.interpolation` for that share, shape (orders of the
            derivative 0 to 2, end of the step, value or rate).

    Returns:
        States, shape (readings, 4, columns), and the rates of their first column.
    """
    count = len(places)
    both_ends = motion[places[:, None] + [0, 1]]
    # Axes: reading, end, angle or position, value or rate, column.
    both_ends = both_ends.reshape(count, 2, 2, 2, -1)
    # Axes: order of the derivative by time, reading, angle or position, column.
    by_order = np.tensordot(weights, both_ends, ((1, 2), (1, 3)))
    # Axes: reading, angle or position, order of the derivative by time, column.
    derivatives = np.moveaxis(by_order, 0, 2)
    values_and_rates = derivatives[:, :, :2]
    states = values_and_rates.reshape(count, 4, -1)
    rates_and_accelerations = derivatives[:, :, 1:, 0]
    rates = rates_and_accelerations.reshape(count, 4)
    return states, rates
