from dataclasses import replace

import numpy as np
import pytest

from baselines.dynamic_programming import __main__ as command
from baselines.dynamic_programming import archive, solver
from baselines.dynamic_programming.archive import Archive, known_results, load_archive, set_plants
from baselines.dynamic_programming.grid import Grid
from baselines.dynamic_programming.policy import Oracle
from baselines.dynamic_programming.problem import Problem, plant_problems, repeat
from baselines.dynamic_programming.solver import Solution, solve_on_grids
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
from tests import ROOT


def test_trajectories_give_the_speeds_on_file_to_the_last_bit():
    known = known_results()
    keys = [Problem(M=0.35, mu=0.5).key, Problem().key, Problem(mu=0.45, static_ratio=1.3).key]
    arrays = {
        name: each[:3] if name.startswith("plants") else each for name, each in known.arrays.items()
    }
    some = Archive({key: known.results[key] for key in keys}, arrays)
    assert some.check() == []
    some.arrays[f"{keys[0]} torques"] = some.arrays[f"{keys[0]} torques"][::-1]
    some.arrays["plants torques"] = np.roll(arrays["plants torques"], 1, axis=1)
    assert len(some.check()) == 1 + 3


def test_the_plants_of_the_sets_are_solved_themselves_and_others_are_interpolated():
    known = known_results()
    np.testing.assert_allclose(known.results[Problem().key].grids, solver.GRIDS, rtol=0.007)
    plants = set_plants()
    assert list(known.plant_speeds) == plants and len(plants) > 700
    solved = np.array([optimal_speed(*plant) for plant in plants])
    ratios = np.array([interpolated_speed(*plant) for plant in plants]) / solved
    assert 0.001 < np.abs(ratios - 1.0).mean() < 0.02 and np.abs(ratios - 1.0).max() < 0.0335
    # Solved again, a plant has the torques on file; a solution on a much coarser grid is slightly
    # slower.
    runs = (plants[722], solver.GRIDS[0]), (plants[1], (13, 18, 7))
    again, coarse = (
        archive.solve_plant(Problem(M=M, mu=mu), known, shape) for (M, mu), shape in runs
    )
    assert (again.choices[:, 0] == known.arrays["plants torques"][722]).all()
    assert 0.9 < coarse.metrics["mean_speed"][0] / solved[1] < 1.01
    assert (
        optimal_speed(0.75, 0.1) == known_results().results[Problem(M=0.75, mu=0.1).key].mean_speed
    )
    assert optimal_speed(0.625, 0.1) == pytest.approx(
        0.5 * (optimal_speed(0.5, 0.1) + optimal_speed(0.75, 0.1))
    )
    with pytest.raises(
        ValueError,
        match=r"M must be in \[0.35, 1.0\] kg and mu in \[0.005, 0.5\], got M=0.3, mu=0.1",
    ):
        optimal_speed(0.3, 0.1)
    corners, *_ = GRID.cell(0.6, 0.07)
    assert [GRID.plants[corner] for corner in corners] == [
        (M, mu) for M in (0.5, 0.75) for mu in (0.03, 0.1)
    ]
    # Rounded observations and plants outside the grid use its edge.
    assert GRID.cell(float(np.float32(0.35)), 0.6) == GRID.cell(0.35, 0.5)
    assert GRID.cell(2.0, 0.0) == GRID.cell(1.0, 0.005)


def test_static_friction_that_is_planned_with_makes_the_optimum_faster():
    assert [find_grid(Capsule(static_ratio=ratio)) for ratio in (1.0, 1.3, 1.2)] == [
        GRID,
        STICKY_GRID,
        None,
    ]
    plants, capsule = (
        tuple(PlantSpec(M, mu, seed=0) for M, mu in ((0.4, 0.25), (0.6, 0.4))),
        STICKY_GRID.capsule,
    )
    found = []
    for grid in (GRID, STICKY_GRID):
        policy = replace(
            SCRIPTED["dp-oracle"], start=lambda seeds, grid=grid: Oracle(len(seeds), grid=grid).act
        )
        found.append(evaluate(policy, EvaluationSet("some", plants, capsule=capsule)))
    for unaware, aware in zip(*found, strict=True):
        assert not aware["failed"] and aware["mean_speed"] > 1.03 * unaware["mean_speed"]
        assert aware["stuck_fraction"] > 0.3 and aware["share_of_optimum"] > 0.95


def test_results_survive_the_file(tmp_path, monkeypatch):
    values = np.random.default_rng(0).uniform(-50.0, 80.0, (5, 6, 7)).astype(np.float32)
    solution = Solution(
        Problem(), Grid((5, 6, 7), (-3.0, 9.0), (-1.0, 4.0), 0.5), values, 0.4, 20.0
    )
    slow, fast = (
        repeat(Problem(), (scale * np.arange(1650) % 121).astype(np.uint8)) for scale in (0, 1)
    )
    solved, grids, written = [(solution, slow), (solution, fast), (solution, slow)], [], Archive()
    monkeypatch.setattr(
        solver, "solve_on_grids", lambda problem, shapes: grids.append(len(shapes)) or solved
    )
    list(written.solve([Problem(), Problem(energy_weight=1.0), Problem(control_dt=0.04)]))
    written.save(tmp_path)
    read = load_archive(tmp_path)
    assert read.results == written.results and grids == [4, 2, 3]
    # Only the policies of the speed problems look ahead with values.
    assert sum("torques" not in name for name in read.arrays) == 2
    # `repeat` returns the trajectory of the largest reward.
    assert (read.repeat(Problem()).choices == fast.choices).all()
    again = read.solution(Problem())
    np.testing.assert_allclose(again.values, values, atol=0.003)
    assert (again.grid, again.curvature, again.gain) == (solution.grid, 0.4, 20.0)


def test_the_command_solves_what_is_missing_and_keeps_it(tmp_path, monkeypatch, capsys, refused):
    problems, calls = [Problem(), Problem(energy_weight=2.0), Problem(mu=0.3)], []

    def quick(problem, shapes):
        calls.append(problem)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return solve_on_grids(problem, [(13, 18, 7)])

    monkeypatch.setattr(command, "PROBLEMS", problems)
    monkeypatch.setattr(solver, "solve_on_grids", quick)
    monkeypatch.setattr(command, "set_plants", lambda: [(0.5, 0.01), (0.5, 0.02)])
    monkeypatch.setattr(
        archive, "solve_plant", lambda problem, _: repeat(problem, np.full(1650, 60, np.uint8))
    )
    arguments = ["--folder", str(tmp_path / "new")]
    refused(command.main, [*arguments, "--check"])
    assert command.main(arguments) == 130
    assert list(load_archive(tmp_path / "new").results) == [each.key for each in problems[:2]]
    assert command.main(arguments) == 0 and calls[3:] == problems[2:]
    assert command.main([*arguments, "--check"]) == 0
    assert "5 trajectories repeated: 0 differ" in capsys.readouterr().out
    monkeypatch.setattr(Archive, "check", lambda self: ["another"])
    assert command.main([*arguments, "--check"]) == 1
    monkeypatch.undo()
    assert command.main(["--report"]) == 0
    assert "20.91" in next(
        line for line in capsys.readouterr().out.splitlines() if "22.53 to 22.66" in line
    )


def test_the_page_shows_the_results_on_file():
    known, page = (
        known_results().results,
        (ROOT / "docs" / "optimum.md").read_text(encoding="utf-8"),
    )
    assert {problem.key for problem in command.PROBLEMS} == set(known)
    rows = [
        [each.energy_weight, each.mean_speed, each.cost_of_transport] for each in known.values()
    ]
    rows = [row for row in rows if row[0]]
    for grid in (GRID, STICKY_GRID):
        speeds = np.reshape(
            [known[each.key].mean_speed for each in plant_problems(grid)], (len(grid.M), -1)
        )
        rows += np.column_stack([grid.M, speeds]).tolist()
    for each in (known[Problem(control_dt=control_dt).key] for control_dt in (0.02, 0.01, 0.005)):
        rows.append([1e3 * each.control_dt, each.mean_speed, max(each.steady), each.gains[-1]])
        assert f"{each.gains[-1]:.2f}|{archive.extrapolated(each)}|" in page
    assert all(
        "|".join([f"\n|{row[0]:g}", *(f"{value:.2f}" for value in row[1:]), ""]) in page
        for row in rows
    )
