import dataclasses

import numpy as np
import pytest

from agents.distillation import plants
from agents.distillation.config import STUDENTS
from agents.distillation.plants import draw_changes, draw_disturbances, draw_groups, solve_groups
from baselines.dynamic_programming.archive import known_results, solve_near
from capsule_gym.parameters import DISTURBANCES, NOMINAL, RANDOMIZATIONS, REAL
from capsule_gym.parameters.disturbances import SAMPLING
from tests.agents.distillation.conftest import RECURRENT

STUDENT = STUDENTS["dp-distilled"]
GROUPS = draw_groups(STUDENT)


def group_of(severity):
    return next(group for group in GROUPS if group.severity == severity)


def test_half_of_the_groups_has_the_sensors_of_real_and_a_quarter_perfect_ones():
    severities = [group.severity for group in GROUPS]
    quarter = len(GROUPS) // 4
    assert severities.count(1.0) == 2 * quarter
    assert severities.count(0.0) == severities.count(None) == quarter


def test_without_severity_the_pendulum_is_nominal():
    for problem in group_of(0.0).problems:
        for name in plants.PENDULUM:
            assert getattr(problem, name) == getattr(NOMINAL, name)
        assert problem.motor_friction == 0.0


def test_at_full_severity_the_pendulum_is_drawn_as_in_real():
    groups = [group for group in GROUPS if group.severity == 1.0]
    problems = [problem for group in groups for problem in group.problems]
    for name in plants.PENDULUM:
        low, high = getattr(RANDOMIZATIONS["real"], name)
        values = {getattr(problem, name) for problem in problems}
        assert len(values) == len(groups)
        assert low <= min(values) < getattr(NOMINAL, name) < max(values) <= high
    assert {problem.motor_friction for problem in problems} == {REAL.motor_friction}


def test_static_ratios_are_1_and_1_3():
    ratios = [group.problems[0].static_ratio for group in GROUPS]
    assert {*ratios} == {NOMINAL.static_ratio, 1.3}


def test_more_groups_keep_the_first():
    more = draw_groups(dataclasses.replace(STUDENT, groups=STUDENT.groups + 3))
    assert more[: STUDENT.groups] == GROUPS


@pytest.mark.parametrize("name", ["x_dot_noise", "latency", "lag"])
def test_a_severity_of_none_draws_disturbances_up_to_their_full_size(name):
    rng = np.random.default_rng(0)
    full = max(np.atleast_1d(getattr(REAL, name)))
    drawn = [draw_disturbances(group_of(None), rng)[name] for _ in range(200)]
    assert 0.0 <= min(drawn) < 0.05 * full
    assert 0.85 * full < max(drawn) <= full


def test_disturbances_of_a_fixed_severity():
    rng = np.random.default_rng(0)
    none = draw_disturbances(group_of(0.0), rng)
    assert none.keys() == set(DISTURBANCES)
    del none["drift_time"]
    assert {*none.values()} == {0.0}
    full = draw_disturbances(group_of(1.0), rng)
    assert full["x_dot_noise"] == REAL.x_dot_noise
    low, high = REAL.latency
    assert low <= full["latency"] <= high


@pytest.mark.parametrize("name", SAMPLING)
def test_sampling_is_drawn_if_it_is_disturbed(name):
    disturbances = dataclasses.replace(REAL, **{name: 0.002})
    group = dataclasses.replace(group_of(1.0), disturbances=disturbances)
    assert draw_disturbances(group, np.random.default_rng(0))[name] == 0.002


def test_sampling_that_is_not_disturbed_takes_no_draw():
    rng = np.random.default_rng(0)
    draw_disturbances(group_of(1.0), rng)
    others = np.random.default_rng(0)
    # The time constant of the drift is drawn twice.
    others.random(len(DISTURBANCES) - len(SAMPLING) + 1)
    assert rng.random() == others.random()


def test_plants_change_at_the_rate_of_the_student_within_an_episode():
    rng = np.random.default_rng(0)
    group = GROUPS[0]
    episodes = [draw_changes(group, 0.2, 16.0, rng) for _ in range(300)]
    for changes in episodes:
        times = [change["t"] for change in changes]
        assert times == sorted(times)
    times = np.array([change["t"] for changes in episodes for change in changes])
    assert 0.0 < times.min() < 0.1
    assert 15.9 < times.max() < 16.0
    assert len(times) / len(episodes) == pytest.approx(0.2 * 16.0, rel=0.1)


def test_an_episode_changes_to_plants_of_wide_in_its_group():
    rng = np.random.default_rng(0)
    group = GROUPS[1]
    changes = draw_changes(group, 5.0, 16.0, rng)
    low, high = RANDOMIZATIONS["wide"].M
    assert all(low <= change["M"] <= high for change in changes)
    plants_of_group = {(problem.M, problem.mu) for problem in group.problems}
    assert {(change["M"], change["mu"]) for change in changes} <= plants_of_group


def test_solutions_have_the_order_of_the_plants(solved):
    groups, solutions = solved
    problems = [problem for group in groups for problem in group.problems]
    assert [solution.problem for solution in solutions] == problems


def test_a_grid_has_room_for_a_pendulum_that_is_not_nominal(solved):
    _, (solution, *_) = solved
    nominal = solve_near(solution.problem, known_results(), solution.values.shape)
    assert solution.grid.y == pytest.approx(np.multiply(1.15, nominal.grid.y))


def test_solved_plants_are_not_solved_again(plants_folder, monkeypatch, solved):
    groups, solutions = solved
    monkeypatch.setattr(plants, "solve_near", None)
    again = solve_groups(groups, plants_folder, jobs=1)
    for first, second in zip(solutions, again, strict=True):
        assert first.grid == second.grid
        assert (first.values == second.values).all()


def test_a_file_of_another_plant_is_replaced(tmp_path, plants_folder, solved):
    groups, solutions = solved
    first, second, *_ = sorted(plants_folder.iterdir())
    (tmp_path / first.name).write_bytes(second.read_bytes())
    (found,) = solve_groups(groups[:1], tmp_path, jobs=1)
    assert found.problem == solutions[0].problem
    assert (found.values == solutions[0].values).all()


def test_the_tiny_student_has_all_severities():
    assert {group.severity for group in draw_groups(RECURRENT)} == {0.0, 1.0, None}
