"""The certified upper bound on the mean speed: its bounds on accelerations, and the motions that it must exceed."""

import numpy as np

from baselines.dynamic_programming.archive import known_results
from baselines.dynamic_programming.problem import Problem
from baselines.paper import speed_bound
from capsule_gym import Capsule, dynamics


def test_accelerations_lie_between_their_bounds(monkeypatch):
    monkeypatch.setattr(speed_bound, "CELLS", 300)
    capsule, rng = Capsule(M=0.4, mu=0.2), np.random.default_rng(0)
    bounds, q = speed_bound.bound_accelerations(capsule), capsule.m * capsule.l / (capsule.M + capsule.m)
    plant, closest = capsule.plant(), np.inf
    for theta in rng.uniform(-1.5, 1.5, 3000).tolist():
        rate = rng.uniform(-1.0, 1.0) * np.interp(theta, bounds.theta, bounds.envelope)
        u = float(rng.choice([-1.5, 1.5]))
        _, x_ddot, normal = dynamics.accelerations(theta, rate, 1.0, 1.0, u, plant)
        if normal > 0.0 and abs(rate) < np.interp(-theta, bounds.theta, bounds.envelope):
            cell = int(np.searchsorted(bounds.rates, np.cos(theta) * rate)) - 1
            margins = bounds.highest[cell] - x_ddot / q, x_ddot / q - bounds.lowest[cell]
            assert min(margins) >= 0.0
            closest = min(closest, *margins)
    assert closest < 15.0


def test_no_motion_that_is_known_exceeds_the_bound(monkeypatch):
    monkeypatch.setattr(speed_bound, "CELLS", 600)
    monkeypatch.setattr(speed_bound, "STEP", 0.2)
    for problem, loosest in ((Problem(), 1.45), (Problem(M=0.75, mu=0.005), 1.45)):
        steady, episode = speed_bound.bound_speed(Capsule(M=problem.M, mu=problem.mu))
        known = known_results().results[problem.key]
        assert known.mean_speed < episode and max(known.steady) < steady < loosest * max(known.steady)
        assert steady < episode < steady + 0.5
