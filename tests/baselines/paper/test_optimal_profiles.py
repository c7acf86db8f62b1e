"""The optimised profiles: the assessment compared with independent code, the committed optima, the
search itself."""

import numpy as np
import pytest

from baselines.paper import optimal_profiles
from baselines.paper.optimal_profiles import ProfileProblem, assess, load, problems, search
from capsule_gym.control.laws.profiles import P2, PROPOSED, TABLE_1, V1, reference_table
from capsule_gym.parameters import NOMINAL

SOLUTIONS = {each.problem: each for each in load()}


def test_assessment_agrees_with_the_reference_table():
    p = NOMINAL.plant()
    found = assess(ProfileProblem(1.5), TABLE_1, V1, P2)
    table = reference_table(PROPOSED, p)
    assert found.mean_speed == pytest.approx(table[-1, 3] / 6.6, rel=1e-4)
    theta, theta_dot, theta_ddot, _, _, x_ddot = table.T[:6]
    ml = p.m * p.l
    u = ml * p.l * theta_ddot - ml * np.cos(theta) * x_ddot
    u += -ml * p.g * np.sin(theta) + p.k * theta + p.c * theta_dot
    assert found.peak_torque == pytest.approx(np.abs(u).max(), rel=2e-3)
    cost = np.abs(u * theta_dot).sum() * 1e-3 / ((p.M + p.m) * p.g * table[-1, 3])
    assert found.cost_of_transport == pytest.approx(cost, rel=0.02)
    # The published profile defines the bounds of Principles 1 and 2.
    bounds = ("principle_1", "principle_2_velocity", "principle_2_acceleration")
    assert [found.shares[name] for name in bounds] == pytest.approx([1.0] * 3)
    assert found.excess == 0.0 < assess(ProfileProblem(1.0), TABLE_1, V1, P2).excess
    assert (
        0.97
        < found.shares["torque"]
        / assess(ProfileProblem(1.5), TABLE_1, V1, P2, reserve=True).shares["torque"]
        < 1.0
    )


def test_worst_plant_lies_at_a_corner_of_the_ranges(monkeypatch):
    worst = SOLUTIONS[ProfileProblem(1.0, "ranges")]
    inside = [
        NOMINAL.plant(M, mu)
        for M in np.linspace(0.45, 0.55, 3)
        for mu in np.linspace(0.009, 0.011, 3)
    ]
    monkeypatch.setattr(ProfileProblem, "plant_list", lambda self: inside)
    everywhere = assess(worst.problem, worst.times, worst.V1, worst.P2)
    assert everywhere.mean_speed == pytest.approx(worst.mean_speed, rel=1e-9)
    assert everywhere.shares == pytest.approx(worst.shares, rel=1e-9)


def test_committed_solutions_are_what_they_claim():
    assert list(SOLUTIONS) == problems()
    for problem, each in SOLUTIONS.items():
        again = assess(problem, each.times, each.V1, each.P2)
        assert (
            again.feasible
            and each.feasible
            and again.shares == pytest.approx(each.shares, rel=1e-9)
        )
        for name in ("mean_speed", "cost_of_transport", "peak_torque", "backward_ratio"):
            assert getattr(again, name) == pytest.approx(getattr(each, name), rel=1e-9)
        # The law's table needs whole milliseconds.
        np.testing.assert_allclose(each.times, np.round(each.times, 3), atol=1e-12)


def test_short_search_is_seeded_and_says_when_it_fails():
    pytest.importorskip("scipy")
    first, second = (
        search(ProfileProblem(1.5), seed=3, generations=1, members=1) for _ in range(2)
    )
    assert first == second
    # The published profile is in the first generation.
    assert first.feasible and first.found_by == "1.5 N m, nominal, seed 3"
    assert first.mean_speed >= assess(ProfileProblem(1.5), TABLE_1, V1, P2).mean_speed * 0.999
    hopeless = search(ProfileProblem(0.001), seed=3, generations=1, members=1)
    assert not hopeless.feasible and hopeless.excess > 1.0


def test_the_command_writes_the_best_profile_of_any_search(tmp_path, monkeypatch):
    def found(problem, known, **settings):
        assert (len(known), settings) == (problems().index(problem), {"seed": 1, "generations": 2})
        # The first search finds the published profile only, which its limit excludes.
        return SOLUTIONS[problem] if known else assess(problem, TABLE_1, V1, P2)

    monkeypatch.setattr(optimal_profiles, "search", found)
    path = tmp_path / "optima.json"
    optimal_profiles.main(["--json", str(path), "--seed", "1", "--generations", "2"])
    first, *others = load(path)
    assert [each.times for each in others] == [each.times for each in SOLUTIONS.values()][
        1:
    ] and first.feasible
    assert first.times in [each.times for each in others]
