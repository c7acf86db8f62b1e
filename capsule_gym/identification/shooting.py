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

from capsule_gym.identification.derivatives import PLANT, STATE, constant_inputs, simulate
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
# Distance between the starts of segments, s, and the standard deviation of a gap over that of a
# reading.
DISTANCE, GAP = 0.8, 0.02
MOST_STEPS = 15
# The reduction of the sum of squares that ends the last fits; the number of samples of a posterior,
# and of the draws from which they are chosen.
FINEST, SAMPLES, PROPOSALS = 0.03, 5000, 200_000
# The quantities over which the others are fitted, and the shares of their ranges at which they are.
PROFILED, NODES = ("static_ratio", "lag"), np.linspace(0.0, 1.0, 7).tolist()


@dataclass
class ShootingProblem:
    """The least-squares problem of a log: unknowns are the shares of the ranges, then the states of
    the segments.
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
        self.low, self.high = np.reshape(list(self.ranges.values()), (-1, 2)).T
        # Constants of the plant act by their products: on a logarithmic scale what a log leaves
        # open is straight.
        scaled = np.array([name in PLANT for name in self.names], np.bool_) & (self.low > 0.0)
        self.growths = np.log(
            np.divide(self.high, self.low, out=np.ones(len(scaled)), where=scaled)
        )
        # The density of a prior that is uniform in the quantity itself grows with it.
        self.densities = np.where(
            [name == "mu" and self.log_mu for name in self.names], 0.0, self.growths
        )
        latest = self.ranges["latency"][1] if "latency" in self.ranges else self.known["latency"]
        # Readings before the first of a segment, which begins earlier by the longest latency.
        self.lead = math.ceil((latest + self.h) / self.period - 1e-9)
        self.commands = np.repeat(self.log["torque"], self.steps)
        self.noise = self.noise or {name: (*NOISE[name], 0.05) for name in self.sensors}

    def values(self, shares: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
        """The quantities in SI units, and the derivatives of the unknown ones by their shares."""
        logarithmic, widths = self.growths > 0.0, self.high - self.low
        found = np.where(
            logarithmic, self.low * np.exp(self.growths * shares), self.low + shares * widths
        )
        slopes = np.where(logarithmic, found * self.growths, widths)
        return {**self.known, **dict(zip(self.names, found.T.tolist(), strict=True))}, slopes

    def cut(self, seconds: float) -> np.ndarray:
        """Cuts the log into segments that begin every DISTANCE seconds; guesses their initial
        states from the readings.

        Returns:
            Shape (segments * components,).
        """
        size, stride = round(seconds / self.period), round(DISTANCE / self.period)
        t, columns = self.log["t"], []
        self.segments = [
            (first, min(first + size, len(t)))
            for first in range(self.lead, len(t) - size // 2, stride)
        ]
        for name in STATE:
            other = {"theta_dot": "theta", "x_dot": "x"}.get(name)
            if name in self.log:
                known = np.isfinite(self.log[name])
                columns.append(np.interp(t, t[known], self.log[name][known]))
            else:
                columns.append(
                    np.gradient(columns[-1], t) if other in self.log else np.zeros(len(t))
                )
        return (
            np.array(columns).T[[first for first, _ in self.segments]][:, self.components].ravel()
        )

    def rows(self, name: str) -> np.ndarray:
        """The rows within the segments in which a sensor has a reading."""
        inside = np.concatenate([np.arange(*ends) for ends in self.segments])
        return inside[np.isfinite(self.log[name][inside])]

    def whiten(self, errors: np.ndarray) -> tuple[np.ndarray, float]:
        """Whitens errors, one sensor after the other; also returns the logarithm of their
        covariance's determinant.

        What remains of an error after the share of the last one that the drift keeps has a
        tridiagonal covariance.
        """
        rows = [self.rows(name) for name in self.sensors]
        sizes = [self.noise[name] for name in self.sensors]
        noise, drift, time = np.repeat(sizes, [len(own) for own in rows], axis=0).T
        # 0.0 at a sensor's first reading.
        kept = np.exp(
            -np.hstack([np.diff(own, prepend=-np.inf) for own in rows]) * self.period / time
        )
        changes = np.concatenate([errors[own, n] for n, own in enumerate(rows)])
        changes[1:] -= kept[1:, None] * changes[:-1]
        variances = drift**2 * (1.0 - kept**2) + noise**2 * (1.0 + kept**2)
        diagonal, below, _ = dpttrf(variances, -kept[1:] * noise[1:] ** 2)
        # `cholesky_banded` and `solve_banded` take twice as long.
        white, _ = dtbtrs([diagonal, np.append(below, 0.0)], changes, uplo="L", diag="U")
        return white / np.sqrt(diagonal)[:, None], np.log(diagonal).sum()

    def predict(self, unknowns: np.ndarray, slopes: bool = True) -> tuple[Any, ...]:
        """Predicted readings of a log, shape (rows, sensors, 1 + unknowns), value first; NaN
        outside the segments.

        Also the gaps between segments, shape (gaps, components, 1 + unknowns).
        """
        count, width = len(self.names), len(self.components)
        (values, scale), states = self.values(unknowns[:count]), unknowns[count:].reshape(-1, width)
        constants: dict[str, Any] = {name: values[name] for name in PLANT if name in values}
        inputs = constant_inputs(Capsule(**constants))
        # The motor's torque, as `Disturbed::drive` computes it; its derivative by the lag is the
        # imaginary part (Squire and Trapp, 1998). Without a lag the share is 1.
        share = 1.0 - np.exp(-self.h / (max(values["lag"], 1e-9) + 1e-30j))
        motor = lfilter([share], [1.0, share - 1.0], self.commands)
        directions = [n for n, name in enumerate(self.names) if name in PLANT or name == "lag"]
        out = np.full((len(self.log["t"]), len(self.sensors), 1 + len(unknowns) * slopes), np.nan)
        gaps = np.zeros((len(self.segments) - 1, width, out.shape[2]))
        shown = [STATE.index(name) for name in self.sensors]
        # Between the steps of the integrator: angle and position by the cubics with their rates at
        # both ends.
        late = math.ceil(values["latency"] / self.h)
        cubics = CubicHermiteSpline([0.0, 1.0], np.eye(4)[::2], self.h * np.eye(4)[1::2])
        weights = [
            cubics(late - values["latency"] / self.h, order) / self.h**order for order in range(3)
        ]
        for n, (first, last) in enumerate(self.segments):
            begin, end = (first - self.lead) * self.steps, (last - 1) * self.steps + 1
            state = np.zeros(4)
            state[self.components] = states[n]
            given = np.concatenate([inputs, state, motor.real[begin:end]])
            partials = np.zeros((len(given), len(directions) + width))
            for column, which in enumerate(directions):
                if (name := self.names[which]) == "lag":
                    partials[len(inputs) + 4 :, column] = (
                        1e30 * motor.imag[begin:end] * scale[which]
                    )
                else:
                    partials[PLANT.index(name), column] = scale[which]
            partials[
                len(inputs) + np.array(self.components), len(directions) + np.arange(width)
            ] = 1.0
            grid, rates, _ = simulate(given, partials if slopes else partials[:, :0], 1, self.h)
            own = count + n * width + np.arange(width)
            columns = np.append(0, 1 + np.append(directions, own).astype(int)) if slopes else [0]
            whole = np.concatenate([grid[:, :4, None], rates], axis=2)
            at = np.arange(first, last)[:, None] * self.steps - begin - late + [0, 1]
            ends = whole[at].reshape(len(at), 2, 2, 2, -1)
            orders = np.moveaxis(
                np.tensordot(np.reshape(weights, (3, 2, 2)), ends, ((1, 2), (1, 3))), 0, 2
            )
            out[first:last] = 0.0
            out[first:last][:, :, columns] = orders[:, :, :2].reshape(len(at), 4, -1)[:, shown]
            if slopes and "latency" in self.names:
                which = self.names.index("latency")
                speeds = orders[:, :, 1:, 0].reshape(len(at), 4)[:, shown]
                out[first:last, :, 1 + which] = -speeds * scale[which]
            if n < len(gaps) and self.segments[n + 1][0] == last:
                gaps[n][:, columns] = whole[(last - self.lead) * self.steps - begin][
                    self.components
                ]
                gaps[n, :, 0] -= states[n + 1]
                if slopes:
                    gaps[n, np.arange(width), 1 + own + width] -= 1.0
        for n, name in enumerate(self.sensors):
            out[:, n, 0] += values.get(f"{name}_bias", 0.0)
            if slopes and f"{name}_bias" in self.names:
                which = self.names.index(f"{name}_bias")
                out[:, n, 1 + which] = scale[which]
        return out, gaps

    def residuals(self, unknowns: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals and, in units of their deviations, the gaps between adjacent segments;
        their Jacobian.
        """
        predicted, gaps = self.predict(unknowns, slopes)
        predicted[..., 0] -= np.transpose([self.log[name] for name in self.sensors])
        sizes = [sum(self.noise.get(STATE[n], NOISE[STATE[n]])[:2]) for n in self.components]
        scaled = (gaps / (GAP * np.array(sizes)[:, None])).reshape(-1, gaps.shape[2])
        whole = np.concatenate([self.whiten(predicted)[0], scaled])
        return whole[:, 0], whole[:, 1:]

    def fit(self, unknowns: np.ndarray, tolerance: float) -> tuple[np.ndarray, float]:
        """Minimises the sum of squares within the ranges, until a step reduces it by less than the
        tolerance.

        Returns the unknowns and the sum.

        The method of Levenberg and Marquardt on the normal equations:
        `scipy.optimize.least_squares` decomposes the Jacobian of all readings in every step, which
        takes ten times as long.
        """
        count, damping = len(self.names), 1e-3
        for _ in range(MOST_STEPS):
            r, jacobian = self.residuals(unknowns)
            cost, gradient, normal = r @ r, jacobian.T @ r, jacobian.T @ jacobian
            shares = unknowns[:count]
            blocked = ((shares <= 0.0) & (gradient[:count] > 0.0)) | (
                (shares >= 1.0) & (gradient[:count] < 0.0)
            )
            free = np.append(~blocked, np.ones(len(unknowns) - count, bool))
            for _ in range(8):
                damped = normal + np.diag(damping * np.diag(normal) + 1e-6)
                step = np.zeros(len(unknowns))
                try:
                    step[free] = -cho_solve(cho_factor(damped[np.ix_(free, free)]), gradient[free])
                except LinAlgError:
                    damping *= 10.0
                    continue
                if -gradient @ step < tolerance:  # the reduction of a linear problem
                    return unknowns, cost
                trial = unknowns + step
                trial[:count] = np.clip(trial[:count], 0.0, 1.0)
                r = self.residuals(trial, slopes=False)[0]
                if r @ r < cost:
                    break
                damping *= 10.0
            else:
                return unknowns, cost
            gain, damping, unknowns = cost - r @ r, max(damping / 3.0, 1e-9), trial
            if gain < tolerance:
                return unknowns, r @ r
        return unknowns, r @ r

    def estimate_noise(self, unknowns: np.ndarray) -> None:
        """Sizes of white noise and drift, and the drift's time constant, of the largest likelihood
        of the errors.
        """
        predicted, _ = self.predict(unknowns, slopes=False)
        errors = predicted - np.transpose([self.log[name] for name in self.sensors])[..., None]

        def likelihood(logs: np.ndarray) -> float:
            sizes = np.exp(logs)
            self.noise = {
                name: (*sizes[2 * n : 2 * n + 2], sizes[-1]) for n, name in enumerate(self.sensors)
            }
            r, determinant = self.whiten(errors)
            return np.sum(r**2) + determinant

        sizes = np.repeat(0.5 * np.log(np.nanvar(errors, axis=0) / 2.0), 2)
        bounds = [(size - 7.0, size + 2.0) for size in sizes] + [(math.log(0.5 * self.period), 0.0)]
        likelihood(
            minimize(likelihood, [*sizes, math.log(0.05)], method="L-BFGS-B", bounds=bounds).x
        )

    def at(self, name: str, share: float) -> "ShootingProblem":
        """The problem in which a quantity is known, with the value at this share of its range."""
        value = self.values(np.full(len(self.names), share))[0][name]
        ranges = {other: limits for other, limits in self.ranges.items() if other != name}
        return replace(self, ranges=ranges, known={**self.known, name: value})

    def posterior(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Samples of the shares, shape (samples, shares), and the unknowns of the largest
        likelihood, from those given.

        The likelihood is approximated as normal in the ranges, but for two quantities, over which
        the others are fitted. With the static ratio it jumps; the others are those of its best
        value. Lag and latency act alike along a curve; the others are interpolated between several
        lags.
        """
        name = next((each for each in PROFILED if each in self.names), None)
        if name is None:
            unknowns, _ = self.fit(unknowns, FINEST)
            return self.laplace(unknowns), unknowns
        place = self.names.index(name)
        problems, ends = (
            [self.at(name, node) for node in NODES],
            {unknowns[place]: (np.delete(unknowns, place), 0.0)},
        )
        for n in np.argsort(np.abs(np.array(NODES) - unknowns[place])):
            nearest = min(ends, key=lambda end: abs(end - NODES[n]))
            ends[NODES[n]] = problems[n].fit(ends[nearest][0], FINEST)
        found, costs = map(np.array, zip(*(ends[node] for node in NODES), strict=True))
        best, shares, generator = (
            np.argmin(costs),
            (np.arange(1000) + 0.5) / 1000.0,
            np.random.default_rng(0),
        )
        # Where the likelihood jumps, it may be as large in between as at the better end.
        jumping = np.minimum(costs[:-1], costs[1:])[(shares * (len(NODES) - 1)).astype(int)]
        cost = Akima1DInterpolator(NODES, costs)(shares) if name == "lag" else jumping
        density = np.exp(-0.5 * (cost - cost.min()) + shares * self.densities[place])
        drawn = generator.choice(shares, SAMPLES, p=density / density.sum())
        if name == "lag":
            parts = np.array(
                [problem.laplace(each) for problem, each in zip(problems, found, strict=True)]
            )
            middles, near = (
                parts.mean(axis=1),
                np.abs(np.subtract.outer(drawn, NODES)).argmin(axis=1),
            )
            samples = (
                Akima1DInterpolator(NODES, middles)(drawn)
                + (parts - middles[:, None])[near, range(SAMPLES)]
            )
            unknowns, _ = self.fit(np.insert(found[best], place, NODES[best]), FINEST)
        else:
            samples, end = problems[best].posterior(found[best])
            # The other draws have the same seed: in their order all would rise with the static
            # ratio.
            samples = generator.permutation(samples)
            unknowns = np.insert(end, place, NODES[best])
        return np.insert(np.clip(samples, 0.0, 1.0), place, drawn, axis=1), unknowns

    def laplace(self, unknowns: np.ndarray) -> np.ndarray:
        """Samples of the shares, shape (samples, shares): the normal approximation of the
        likelihood in the ranges.
        """
        r, jacobian = self.residuals(unknowns)
        count = len(self.names)
        # Drawn with a normal prior as wide as the ranges, which the weights take back.
        prior = np.where(np.arange(len(unknowns)) < count, 1.0, 1e-6)
        covariance = np.linalg.inv(jacobian.T @ jacobian + np.diag(prior))
        middle = unknowns + covariance @ (prior * (0.5 - unknowns) - jacobian.T @ r)
        factor, generator = np.linalg.cholesky(covariance[:count, :count]), np.random.default_rng(0)
        drawn = middle[:count] + generator.standard_normal((PROPOSALS, count)) @ factor.T
        inside = ((drawn >= 0.0) & (drawn <= 1.0)).all(axis=1)
        # A likelihood far outside of the ranges, which hardly any sample meets.
        drawn = drawn[inside] if inside.sum() > 500 else np.clip(drawn, 0.0, 1.0)
        weights = np.exp(0.5 * np.sum((drawn - 0.5) ** 2, axis=1) + (drawn - 1.0) @ self.densities)
        return drawn[generator.choice(len(drawn), SAMPLES, p=weights / weights.sum())]

    def statistic(self, unknowns: np.ndarray) -> float:
        """The share of the whitened residuals that past torques and the predicted motion explain,
        over that of noise.

        It is a chi-square per degree of freedom (Ljung, System Identification, Sect. 16.6).
        """
        motion, torque = (
            np.nan_to_num(self.predict(unknowns, slopes=False)[0][..., 0]),
            self.log["torque"],
        )
        # The present torque may follow from the present reading.
        lags = range(1, round(1.0 / self.period), max(1, round(0.01 / self.period)))
        regressors = [
            np.ones(len(torque)),
            *(np.append(np.zeros(lag), torque[: len(torque) - lag]) for lag in lags),
        ]
        regressors += [
            function(motion[:, n])
            for n in range(len(self.sensors))
            for function in (np.sign, np.abs)
        ]
        X, r, total = np.transpose(regressors), self.residuals(unknowns, slopes=False)[0], 0.0
        for name in self.sensors:
            rows = self.rows(name)
            solution, _, rank, _ = np.linalg.lstsq(X[rows], r[: len(rows)], rcond=1e-3)
            total += np.sum((X[rows] @ solution) ** 2) / (rank * len(self.sensors))
            r = r[len(rows) :]
        return total
