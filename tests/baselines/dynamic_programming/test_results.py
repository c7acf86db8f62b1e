from dataclasses import replace

import numpy as np
import pytest

from baselines.dynamic_programming import __main__ as command
from baselines.dynamic_programming import archive, solver
from baselines.dynamic_programming.archive import Archive, known_results, load_archive, set_plants
from baselines.dynamic_programming.grid import Grid
from baselines.dynamic_programming.policy import Oracle
from baselines.dynamic_programming.problem import (
    SETTLED,
    Problem,
    Trajectory,
    corner_weights,
    plant_problems,
    repeat,
)
from baselines.dynamic_programming.solver import Solution, run_policy, solve_on_grids
from baselines.policies import SCRIPTED
from capsule_gym.evaluation.episodes import evaluate
from capsule_gym.evaluation.optimum import (
    GRID,
    STICKY_GRID,
    find_grid,
    interpolated_speed,
    optimal_speed,
)
from capsule_gym.evaluation.sets import EvaluationSet, PlantSpec
from capsule_gym.parameters import Capsule
from capsule_gym.tasks.task import CONTROL_DT, HORIZON
from tests import ROOT

SPEED = Problem()
RESULTS = known_results().results
PAGE = (ROOT / "docs" / "optimum.md").read_text(encoding="utf-8")
SMALL = (13, 18, 7)


@pytest.fixture
def some():
    """Four results and three plants of the archive, with arrays of their own."""
    known = known_results()
    problems = [
        Problem(M=0.35, mu=0.5),
        SPEED,
        Problem(mu=0.45, static_ratio=1.3),
        Problem(control_dt=0.005),
    ]
    results = {problem.key: RESULTS[problem.key] for problem in problems}
    arrays = {f"{key} torques": known.arrays[f"{key} torques"] for key in results}
    for name in ("plants", "plants torques"):
        arrays[name] = known.arrays[name][:3]
    return Archive(results, arrays)


def test_trajectories_give_the_speeds_on_file_to_the_last_bit(some):
    assert some.check() == []


def test_other_torques_of_a_problem_are_found(some):
    for name in ("plants", "plants torques"):
        del some.arrays[name]
    name = f"{next(iter(some.results))} torques"
    some.arrays[name] = some.arrays[name][::-1]
    assert len(some.check()) == 1


def test_other_torques_of_plants_are_found(some):
    some.arrays["plants torques"] = np.roll(some.arrays["plants torques"], 1, axis=1)
    assert len(some.check()) == 3


def test_the_main_problem_is_solved_on_all_grids():
    np.testing.assert_allclose(RESULTS[SPEED.key].grids, solver.GRIDS, rtol=0.007)


def test_the_plants_of_the_sets_are_solved_themselves():
    plants = set_plants()
    assert len(plants) > 700
    assert list(known_results().plant_speeds) == plants


def test_interpolated_speeds_are_close_to_solved_ones():
    plants = set_plants()
    solved = np.array([optimal_speed(M, mu) for M, mu in plants])
    interpolated = np.array([interpolated_speed(M, mu) for M, mu in plants])
    errors = np.abs(interpolated / solved - 1.0)
    assert 0.001 < errors.mean() < 0.02
    assert errors.max() < 0.0335


def test_a_plant_that_is_solved_again_has_the_torques_on_file():
    known = known_results()
    M, mu = set_plants()[722]
    again = archive.solve_plant(Problem(M=M, mu=mu), known)
    assert (again.choices[:, 0] == known.arrays["plants torques"][722]).all()


def test_a_solution_on_a_much_coarser_grid_is_slightly_slower():
    M, mu = set_plants()[1]
    coarse = archive.solve_plant(Problem(M=M, mu=mu), known_results(), SMALL)
    assert 0.9 < coarse.metrics["mean_speed"][0] / optimal_speed(M, mu) < 1.01


def test_the_speed_of_a_plant_of_the_grid_is_that_on_file():
    assert optimal_speed(0.75, 0.1) == RESULTS[Problem(M=0.75, mu=0.1).key].mean_speed


def test_the_speed_between_plants_of_the_grid_is_interpolated():
    mean = 0.5 * (optimal_speed(0.5, 0.1) + optimal_speed(0.75, 0.1))
    assert optimal_speed(0.625, 0.1) == pytest.approx(mean)


def test_a_plant_outside_the_grid_raises_an_error():
    message = r"M must be in \[0.35, 1.0\] kg and mu in \[0.005, 0.5\], got M=0.3, mu=0.1"
    with pytest.raises(ValueError, match=message):
        optimal_speed(0.3, 0.1)


def test_a_cell_has_the_plants_around_a_plant():
    corners, *_ = GRID.cell(0.6, 0.07)
    plants = [GRID.plants[corner] for corner in corners]
    assert plants == [(0.5, 0.03), (0.5, 0.1), (0.75, 0.03), (0.75, 0.1)]


def test_the_weights_of_the_corners_of_a_cell_interpolate_linearly():
    weights = corner_weights(0.25, 0.4)
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ [[0, 0], [0, 1], [1, 0], [1, 1]] == pytest.approx([0.25, 0.4])


def test_rounded_observations_and_plants_outside_the_grid_use_its_edge():
    assert GRID.cell(float(np.float32(0.35)), 0.6) == GRID.cell(0.35, 0.5)
    assert GRID.cell(2.0, 0.0) == GRID.cell(1.0, 0.005)


@pytest.mark.parametrize(("ratio", "grid"), [(1.0, GRID), (1.3, STICKY_GRID), (1.2, None)])
def test_the_grid_of_a_static_ratio(ratio, grid):
    assert find_grid(Capsule(static_ratio=ratio)) == grid


def oracle_on(grid, plants):
    """Episodes of the oracle with the values of a grid."""

    def start(seeds):
        return Oracle(len(seeds), grid=grid).act

    policy = replace(SCRIPTED["dp-oracle"], start=start)
    return evaluate(policy, plants)


def test_static_friction_that_is_planned_with_makes_the_optimum_faster():
    specs = (PlantSpec(0.4, 0.25, seed=0), PlantSpec(0.6, 0.4, seed=0))
    plants = EvaluationSet("some", specs, capsule=STICKY_GRID.capsule)
    aware = oracle_on(STICKY_GRID, plants)
    for episode, unaware in zip(aware, oracle_on(GRID, plants), strict=True):
        assert not episode["failed"]
        assert episode["mean_speed"] > 1.03 * unaware["mean_speed"]
        assert episode["stuck_fraction"] > 0.3
        assert episode["share_of_optimum"] > 0.95


@pytest.fixture
def solution():
    """A solution with random values."""
    values = np.random.default_rng(0).uniform(-50.0, 80.0, (5, 6, 7)).astype(np.float32)
    return Solution(SPEED, Grid((5, 6, 7), (-3.0, 9.0), (-1.0, 4.0), SPEED.q), values, 0.4, 20.0)


@pytest.fixture
def fast():
    """A trajectory with the larger reward of those that `written` contains."""
    return repeat(SPEED, (np.arange(1650) % 121).astype(np.uint8))


@pytest.fixture
def written(monkeypatch, solution, fast):
    """An archive of three solved problems, and the numbers of grids for each."""
    slow = repeat(SPEED, np.zeros(1650, np.uint8))
    grids = []

    def solved(problem, shapes):
        grids.append(len(shapes))
        finer = replace(solution, gain=21.00004)
        return [(solution, slow), (finer, fast), (finer, slow)]

    monkeypatch.setattr(solver, "solve_on_grids", solved)
    found = Archive()
    list(found.solve([SPEED, Problem(energy_weight=1.0), Problem(control_dt=0.04)]))
    return found, grids


def test_the_main_problem_is_solved_on_the_most_grids(written):
    _, grids = written
    assert grids == [4, 2, 3]


def test_only_speed_problems_have_values(written):
    # The policies look ahead with them.
    found, _ = written
    others = [name for name in found.arrays if "torques" not in name]
    assert others == [f"{SPEED.key} differences", f"{SPEED.key} numbers"]


def test_the_trajectory_of_the_largest_reward_is_kept(written, fast):
    found, _ = written
    assert (found.repeat(SPEED).choices == fast.choices).all()


def test_results_survive_the_file(written, solution, fast, tmp_path):
    found, _ = written
    found.save(tmp_path)
    read = load_archive(tmp_path)
    again = read.solution(SPEED)
    assert read.results == found.results
    # In the order of their names, so that two files can be compared.
    assert list(read.results) == sorted(found.results)
    assert list(read.arrays) == sorted(found.arrays)
    assert read.results[SPEED.key].gains == [20.0, 21.0, 21.0]
    assert (read.repeat(SPEED).choices == fast.choices).all()
    np.testing.assert_allclose(again.values, solution.values, atol=0.0026)
    assert again.grid == solution.grid
    assert again.curvature == 0.4
    assert again.gain == 20.0


def test_values_of_a_wide_range_are_stored_in_65535_steps(solution):
    found = Archive()
    found._add_values(SPEED, replace(solution, values=10.0 * solution.values))
    again = found.solution(SPEED)
    atol = 0.51 * 10.0 * np.ptp(solution.values) / 65535.0
    np.testing.assert_allclose(again.values, 10.0 * solution.values, atol=atol)


def reward(**metrics):
    metrics = {name: np.array([value]) for name, value in metrics.items()}
    return archive._reward(Problem(energy_weight=2.0), Trajectory(metrics, None, None))


def test_a_reward_is_the_distance_in_cm_less_the_weighted_energy():
    assert reward(distance=0.5, energy=3.0, failed=0.0) == 44.0


def test_a_failure_is_worse_than_any_trajectory():
    assert reward(distance=9.0, energy=0.0, failed=1.0) < reward(
        distance=-9.0, energy=99.0, failed=0.0
    )


@pytest.fixture
def problems(monkeypatch, solution):
    """Three problems, of which the first is solved and the third interrupted once; two plants."""
    chosen = [SPEED, Problem(energy_weight=2.0), Problem(mu=0.3)]
    solved = []

    def quick(problem, shapes):
        solved.append(problem)
        if len(solved) == 3:
            raise KeyboardInterrupt
        if problem == SPEED:
            return solve_on_grids(problem, [SMALL])
        return [(solution, constant(problem, SMALL))]

    def constant(problem, _):
        return repeat(problem, np.full(1650, 60, np.uint8))

    monkeypatch.setattr(command, "PROBLEMS", chosen)
    monkeypatch.setattr(command, "set_plants", lambda: [(0.5, 0.01), (0.5, 0.02)])
    monkeypatch.setattr(solver, "solve_on_grids", quick)
    monkeypatch.setattr(archive, "solve_plant", constant)
    return chosen, solved


def test_the_command_solves_what_is_missing_and_keeps_it(tmp_path, problems, capsys):
    chosen, solved = problems
    arguments = ["--folder", str(tmp_path / "new")]
    assert command.main(arguments) == 130
    filed = load_archive(tmp_path / "new").results
    assert list(filed) == [problem.key for problem in chosen[:2]]
    assert command.main(arguments) == 0
    assert solved[3:] == chosen[2:]
    assert command.main([*arguments, "--check"]) == 0
    printed = capsys.readouterr().out
    found = load_archive(tmp_path / "new")
    for result in found.results.values():
        assert f"\n{result.mean_speed:.2f} cm/s, " in printed
    assert "\n3 problems and 2 plants of sets on file in" in printed
    assert "5 trajectories repeated: 0 differ" in printed
    # The archived trajectory considers the end of the episode.
    endless = run_policy(found.solution(SPEED), solver.STARTS[:1])
    assert found.results[SPEED.key].mean_speed > endless.metrics["mean_speed"][0] + 0.1


@pytest.mark.parametrize("option", ["--check", "--report"])
def test_an_option_that_needs_results_is_an_error_without_any(tmp_path, refused, option):
    message = refused(command.main, ["--folder", str(tmp_path / "new"), option])
    assert f"{option} needs results" in message


def test_the_status_says_that_a_trajectory_differs(monkeypatch):
    monkeypatch.setattr(Archive, "check", lambda self: ["another"])
    assert command.main(["--check"]) == 1


def test_the_report_prints_speeds_with_the_limits_of_their_gains(capsys):
    assert command.main(["--report"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (main,) = (line for line in lines if "22.53 to 22.66" in line)
    assert "20.91" in main


def assert_on_page(first, *values):
    """Asserts that a table of the page begins a row with these numbers."""
    cells = "|".join(f"{value:.2f}" for value in values)
    assert f"\n|{first:g}|{cells}|" in PAGE


def test_every_problem_is_on_file():
    assert {problem.key for problem in command.PROBLEMS} == set(RESULTS)


def test_the_optimal_front_has_every_result_that_no_other_dominates():
    front = archive.optimal_front()
    costs, speeds = zip(*front, strict=True)
    assert list(speeds) == sorted(speeds)
    assert list(costs) == sorted(costs)
    for problem in command.PROBLEMS:
        if problem == SPEED or problem.energy_weight:
            result = RESULTS[problem.key]
            cost = result.cost_of_transport
            speed = result.mean_speed
            dominated = any(low <= cost and fast > speed for low, fast in front)
            assert dominated == ((cost, speed) not in front)


def test_the_page_shows_the_results_by_energy_weight():
    for result in RESULTS.values():
        if result.energy_weight:
            assert_on_page(result.energy_weight, result.mean_speed, result.cost_of_transport)


@pytest.mark.parametrize("grid", [GRID, STICKY_GRID])
def test_the_page_shows_the_speeds_on_the_grid(grid):
    speeds = [RESULTS[problem.key].mean_speed for problem in plant_problems(grid)]
    for M, by_friction in zip(grid.M, np.reshape(speeds, (len(grid.M), -1)), strict=True):
        assert_on_page(M, *by_friction)


@pytest.mark.parametrize("control_dt", [0.02, 0.01, 0.005])
def test_the_page_shows_the_results_by_control_interval(control_dt):
    result = RESULTS[Problem(control_dt=control_dt).key]
    gain = result.gains[-1]
    assert_on_page(1e3 * control_dt, result.mean_speed, max(result.steady), gain)
    assert f"{gain:.2f}|{archive.extrapolated(result)}|" in PAGE


@pytest.mark.parametrize(("turns", "speed"), [(0, 10.0), (1, 10.0), (2, 20.0)])
def test_without_a_whole_cycle_the_steady_speed_is_that_of_the_whole_time(turns, speed):
    # A platform at 0.1 m/s after the start, but at 0.2 m/s between the two times of a turn.
    t = CONTROL_DT * np.arange(round(HORIZON / CONTROL_DT))
    velocity = np.where(t >= SETTLED, 0.1, 0.0)
    # In the first interval as much slower as faster in the last.
    velocity[round(SETTLED / CONTROL_DT)] = 0.0
    velocity[-2] = 0.2
    turning = np.zeros_like(t, bool)
    for n in range(turns):
        turning |= np.isclose(t, 20.0 + n)
    if turns == 2:
        velocity[(t >= 20.0) & (t < 21.0)] = 0.2
    x = CONTROL_DT * np.append(0.0, np.cumsum(velocity)[:-1])
    states = np.stack([np.full_like(t, -1.0), np.where(turning, 1.0, -1.0), x, 0.0 * t], axis=1)
    run = Trajectory({}, states[..., None], np.zeros((len(t), 1), np.uint8))
    assert run.steady_speed(CONTROL_DT) == pytest.approx(speed)


def test_cycles_begin_where_the_pendulum_turns_left_of_upright():
    # A swing a second, with a short stop on the right, and a platform that moves to and fro.
    t = CONTROL_DT * (np.arange(round(HORIZON / CONTROL_DT)) + 0.5)
    theta = -np.cos(2.0 * np.pi * t)
    stopping = (t % 1.0 > 0.6) & (t % 1.0 < 0.7)
    theta_dot = np.where(stopping, 0.1, np.sin(2.0 * np.pi * t))
    x = 0.1 * t + 0.01 * np.cos(2.0 * np.pi * t)
    states = np.stack([theta, theta_dot, x, np.zeros_like(t)], axis=1)[..., None]
    run = Trajectory({}, states, np.zeros((len(t), 1), np.uint8))
    starts = t[run.cycle_starts(CONTROL_DT)]
    np.testing.assert_allclose(starts, np.arange(np.ceil(SETTLED), HORIZON) + 0.5 * CONTROL_DT)
    assert run.steady_speed(CONTROL_DT) == pytest.approx(10.0)
