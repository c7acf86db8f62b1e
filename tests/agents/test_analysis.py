import re

import numpy as np
import pytest

from agents.analysis import __main__ as analysis
from agents.analysis import goal, limit_cycle, sensitivity
from agents.analysis.data import read_learning
from baselines.evaluation.episodes import evaluate
from baselines.evaluation.policies import Candidate
from capsule_gym import Capsule, dynamics
from capsule_gym.evaluation_sets import EvaluationSet, PlantSpec
from capsule_gym.parameters import REAL, Disturbances
from tests.agents.fakes import Sine


def cells(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line[:1] == "|"]


def test_the_last_of_two_evaluations_at_the_same_step_counts(tmp_path):
    path = tmp_path / "seed-3" / "evaluations.csv"
    path.parent.mkdir()
    path.write_text("steps,mean_speed_cm_s,failed\n100,1.0,0.0\n200,2.0,0.0\n200,5.0,0.0\n")
    steps, speeds = read_learning(tmp_path)[3]
    assert (steps.tolist(), speeds.tolist()) == ([100, 200], [1.0, 5.0])
    path.write_text("steps,mean_speed_cm_s\n")
    with pytest.raises(ValueError, match=r"evaluations\.csv must be the log of a training run"):
        read_learning(tmp_path)


def test_sensitivity_shows_speed_and_failures_under_disturbances_of_each_size(monkeypatch):
    monkeypatch.setattr(sensitivity, "EPISODES", 2)
    conditions = sensitivity.conditions()
    assert conditions['all of "real"', 1.0] == REAL
    doubled = conditions['all of "real"', 2.0]
    assert (doubled.latency, doubled.lag, doubled.drift_time) == ((0.01, 0.03), 0.01, REAL.drift_time)
    assert conditions["latency", 0.5] == Disturbances(latency=0.005)
    results = sensitivity.run([Candidate("wild", (Sine(1.5, period=10.0, name="wild"),), "")], horizon=1.0)
    head, _, wild, still = cells(sensitivity.table({**results, "still": dict.fromkeys(conditions, (0.0, 0))}))
    assert head == ["policy", "none", *sensitivity.DISTURBED, "no x_dot"]
    assert wild[1].endswith(" (2)") and still[1:] == ["0.00"] * (len(head) - 1)
    assert len(sensitivity.draw(results).axes) == len(head)


def test_a_limit_cycle_is_the_steady_one_from_its_smallest_angle_on():
    t = np.arange(0.0, 33.0, limit_cycle.DT)
    # A period of 0.8 s that begins at 27 s; before, the motion decays.
    size = 1.0 + np.exp(-t) + np.where(t < 27.0, 0.2 * np.sin(0.7 * t), 0.0)
    phase = 2.0 * np.pi * t / 0.8
    samples = np.stack([size * np.sin(phase), size * np.cos(phase), 0.1 * t, size * np.sin(phase), t, t], axis=1)
    cycle = limit_cycle.find_cycle(samples)
    assert len(cycle) == 401 and cycle[0, 4] > 26.0
    assert cycle[0, 0] == pytest.approx(-1.0) and cycle[-1, 2] - cycle[0, 2] == pytest.approx(0.08)


def test_stale_tables_are_found(tmp_path, capsys):
    assert analysis.main(["statistics", "--check", "--output", str(tmp_path)]) == 1
    assert re.search(r"statistics_tables\.md is not up to date: run `python -m", capsys.readouterr().out)


def test_friction_bounds_what_moves_the_centre_of_mass():
    rng, n = np.random.default_rng(5), 2000
    p = Capsule(static_ratio=1.3).plant()._replace(M=rng.uniform(0.4, 0.6, n), mu=rng.uniform(0.0, 0.5, n))
    theta, theta_dot, u = rng.uniform(-1.5, 1.5, n), rng.uniform(-12.0, 12.0, n), rng.uniform(-1.5, 1.5, n)
    slip = dynamics.contact_phase(theta, theta_dot, rng.choice([-0.1, 0.0, 0.1], n), u, p)
    theta_ddot, x_ddot, normal = dynamics.accelerations(theta, theta_dot, 0.1 * slip, slip, u, p)
    sin, cos, s = np.sin(theta), np.cos(theta), p.m * p.l / (p.M + p.m)
    along = x_ddot - s * (cos * theta_ddot - sin * theta_dot**2)
    up = -s * (sin * theta_ddot + cos * theta_dot**2)
    assert ((normal == 0.0) | (np.abs(along) <= p.mu * p.static_ratio * (p.g + up) + 1e-9)).all()


def test_the_least_time_to_a_goal_is_that_of_a_mass_without_a_ball():
    # It accelerates by a = mu g and brakes to the velocity a / 2, which friction could remove within the final second.
    plant, capsule = PlantSpec(0.5, 0.01, 0, goal=-0.302), Capsule(m=1e-9)
    a = 0.01 * capsule.g
    fastest = np.sqrt(0.3 * a + 0.5 * (0.5 * a) ** 2)
    assert goal.least_time(plant, capsule) == pytest.approx((2.0 * fastest - 0.5 * a) / a + 1.0, abs=1e-3)


def test_no_episode_is_faster_than_the_least_time_to_its_goal():
    rng = np.random.default_rng(6)
    for capsule, mus, ratio in ((Capsule(static_ratio=1.3), (0.05, 0.5), 4.0), (Capsule(), (0.009, 0.011), 1.5)):
        drawn = [(rng.uniform(0.45, 0.55), rng.uniform(*mus), sign * rng.uniform(0.05, 0.5)) for sign in [-1, 1] * 50]
        plants = tuple(PlantSpec(M, mu, n, goal=d) for n, (M, mu, d) in enumerate(drawn))
        episodes = evaluate(goal.POLICY, EvaluationSet("own", plants, "goal", capsule))
        times = np.array([episode["goal_time"] for episode in episodes])
        bounds = np.array([goal.least_time(plant, capsule) for plant in plants])
        assert (times >= bounds).all() and np.median(times / bounds) < ratio
