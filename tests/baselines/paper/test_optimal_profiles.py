"""The optimised profiles: their assessment by independent code, the optima on file, the search."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.paper import optimal_profiles
from baselines.paper.optimal_profiles import (
    ProfileProblem,
    _decode,
    _encode,
    assess,
    load,
    problems,
    search,
)
from capsule_gym.control.laws.profiles import P2, PROPOSED, TABLE_1, V1, reference_table
from capsule_gym.parameters import NOMINAL

SOLUTIONS = {solution.problem: solution for solution in load()}
PUBLISHED = (TABLE_1, V1, P2)
EASY = ProfileProblem(1.5)


def test_assessment_agrees_with_the_reference_table():
    p = NOMINAL.plant()
    ml = p.m * p.l
    table = reference_table(PROPOSED, p)
    theta, theta_dot, theta_ddot, x, _, x_ddot, *_ = table.T
    u = ml * p.l * theta_ddot - ml * np.cos(theta) * x_ddot
    u += -ml * p.g * np.sin(theta) + p.k * theta + p.c * theta_dot
    energy = np.abs(u * theta_dot).sum() * 1e-3
    cost = energy / ((p.M + p.m) * p.g * x[-1])

    found = assess(EASY, *PUBLISHED)

    assert found.mean_speed == pytest.approx(x[-1] / 6.6, rel=1e-4)
    assert found.peak_torque == pytest.approx(np.abs(u).max(), rel=2e-3)
    assert found.cost_of_transport == pytest.approx(cost, rel=0.02)


def test_a_profile_too_slow_to_move_the_platform_is_feasible():
    still = assess(EASY, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0), 0.1, 0.05)
    assert still.feasible
    assert (still.mean_speed, still.backward_ratio) == (0.0, 0.0)
    assert still.cost_of_transport is None
    assert still.shares["principle_4_rest"] == 0.0


def test_the_published_profile_defines_the_bounds_of_principles_1_and_2():
    shares = assess(EASY, *PUBLISHED).shares
    for name in ("principle_1", "principle_2_velocity", "principle_2_acceleration"):
        assert shares[name] == pytest.approx(1.0)


def test_excess_is_positive_beyond_the_torque_limit():
    assert assess(EASY, *PUBLISHED).excess == 0.0
    assert assess(ProfileProblem(1.0), *PUBLISHED).excess > 0.0


def test_the_search_keeps_a_reserve_of_torque():
    share = assess(EASY, *PUBLISHED).shares["torque"]
    reserved = assess(EASY, *PUBLISHED, reserve=True).shares["torque"]
    assert 0.97 < share / reserved < 1.0


def test_worst_plant_lies_at_a_corner_of_the_ranges(monkeypatch):
    worst = SOLUTIONS[ProfileProblem(1.0, "ranges")]
    masses = np.linspace(0.45, 0.55, 3)
    frictions = np.linspace(0.009, 0.011, 3)
    inside = [NOMINAL.plant(M, mu) for M in masses for mu in frictions]
    monkeypatch.setattr(ProfileProblem, "plant_list", lambda self: inside)
    everywhere = assess(worst.problem, worst.times, worst.V1, worst.P2)
    assert everywhere.mean_speed == pytest.approx(worst.mean_speed, rel=1e-9)
    assert everywhere.shares == pytest.approx(worst.shares, rel=1e-9)


def test_every_problem_has_a_solution_on_file():
    assert list(SOLUTIONS) == problems()


@pytest.mark.parametrize("filed", SOLUTIONS.values(), ids=lambda filed: filed.problem.label)
def test_solutions_on_file_are_what_they_claim(filed):
    again = assess(filed.problem, filed.times, filed.V1, filed.P2)
    assert filed.feasible
    assert again.feasible
    assert again.shares == pytest.approx(filed.shares, rel=1e-9)
    for name in ("mean_speed", "cost_of_transport", "peak_torque", "backward_ratio"):
        assert getattr(again, name) == pytest.approx(getattr(filed, name), rel=1e-9)
    # The law's table needs whole milliseconds.
    np.testing.assert_allclose(filed.times, np.round(filed.times, 3), atol=1e-12)


@pytest.mark.parametrize("filed", SOLUTIONS.values(), ids=lambda filed: filed.problem.label)
def test_solutions_on_file_are_points_of_the_search(filed):
    point = np.array(_encode(filed.times, filed.V1, filed.P2))
    times, *rates = _decode(point, filed.problem)
    assert times == pytest.approx(filed.times, abs=1e-12)
    assert rates == pytest.approx([filed.V1, filed.P2], rel=1e-12)


def test_the_search_keeps_to_whole_milliseconds_and_the_largest_velocity():
    times, velocity, _ = _decode(np.array([-3.4, -2.81] + [0.0] * 5 + [20.0, -1.0]), EASY)
    assert times[:3] == (0.001, 0.003, 1.003)
    assert velocity == V1


def test_a_platform_that_only_moves_backwards_has_no_ratio_of_distances():
    back = assess(EASY, (2.0, 4.0, 6.0, 6.05, 8.0, 9.0, 12.0), 0.4, 0.39)
    assert back.mean_speed < 0.0
    assert back.backward_ratio is None
    assert back.cost_of_transport is None


def short_search(problem, known=()):
    pytest.importorskip("scipy")
    return search(problem, known, seed=3, generations=1, members=1)


def test_a_search_is_seeded_and_starts_from_the_published_profile():
    found = short_search(EASY)
    assert found == short_search(EASY)
    assert found.found_by == "1.5 N m, nominal, seed 3"
    assert found.feasible
    assert found.mean_speed >= assess(EASY, *PUBLISHED).mean_speed * 0.999


def test_a_search_starts_from_the_best_known_solution():
    best = SOLUTIONS[EASY]
    found = short_search(EASY, [SOLUTIONS[ProfileProblem(0.54)], best])
    assert found.mean_speed >= 0.999 * best.mean_speed


def test_a_search_says_when_it_fails():
    problem = ProfileProblem(0.001)
    hopeless = short_search(problem)
    assert not hopeless.feasible
    assert 1.0 < hopeless.excess <= 1.02 * assess(problem, *PUBLISHED).excess


def test_a_search_lasts_its_generations(monkeypatch):
    pytest.importorskip("scipy")
    good = SOLUTIONS[EASY]
    evaluated = []

    def assessed(problem, times, V1, P2, *_, reserve=False):
        evaluated.append(reserve)
        # Nearly alike, as at the end of a search.
        return replace(good, mean_speed=1.0 + 1e-9 * V1)

    monkeypatch.setattr(optimal_profiles, "assess", assessed)
    counts = []
    for generations in (1, 2, 5):
        evaluated.clear()
        search(EASY, seed=0, generations=generations, members=1)
        counts.append(sum(evaluated))
    first, second, fifth = counts
    assert fifth - second == 3 * (second - first) > 0


def test_the_command_does_not_replace_results(tmp_path, refused):
    path = tmp_path / "optima.json"
    path.touch()
    assert "--json" in refused(optimal_profiles.main, ["--json", str(path)])


def test_the_command_writes_the_best_profile_of_any_search(tmp_path, monkeypatch, capsys):
    def found(problem, known, **settings):
        assert len(known) == problems().index(problem)
        assert settings == {"seed": 1, "generations": 2}
        # The first search finds the published profile only, which its limit excludes.
        return SOLUTIONS[problem] if known else assess(problem, *PUBLISHED)

    monkeypatch.setattr(optimal_profiles, "search", found)
    path = tmp_path / "optima.json"
    optimal_profiles.main(["--json", str(path), "--seed", "1", "--generations", "2"])

    *progress, last = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in progress] == [each.label for each in problems()]
    assert last == f"{len(problems())} solutions written to {path}"
    first, *others = (solution.times for solution in load(path))
    _, *expected = (solution.times for solution in SOLUTIONS.values())
    assert others == expected
    assert first in others
    assert load(path)[0].feasible
