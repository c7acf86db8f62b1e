"""The results on file, the command that computes them, and the policies."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from baselines.archive import PLANTS, between_plants, interpolation_weights
from baselines.dynamic_programming import FOLDER, archive, cycle, optimal_speed, refinement
from baselines.dynamic_programming import __main__ as command
from baselines.dynamic_programming.archive import Archive, key_of, known_results, load_archive
from baselines.dynamic_programming.grid import Grid
from baselines.dynamic_programming.problem import Problem
from baselines.dynamic_programming.refinement import GridResult, solve_on_grids
from baselines.dynamic_programming.report import report
from baselines.dynamic_programming.solver import Solution
from baselines.dynamic_programming.trajectory import repeat
from baselines.gaits.archive import known_gaits
from baselines.gaits.bound import speed_bound
from baselines.policies import SCRIPTED
from capsule_gym import CapsuleVectorEnv
from capsule_gym.parameters import NOMINAL

# On a heavy platform with much friction gaits gain from changing their torque every 10 ms.
SHORTER_INTERVAL_WINS = {(0.75, 0.5), (1.0, 0.5)}


def test_trajectories_give_the_speeds_on_file_to_the_last_bit():
    known = known_results()
    keys = [key_of(Problem(M=M, mu=mu)) for M, mu in ((0.35, 0.5), (0.5, 0.01))]
    some = Archive({key: known.results[key] for key in keys}, dict(known.arrays))
    assert some.check() == []
    some.arrays[f"{keys[0]} torques"] = some.arrays[f"{keys[0]} torques"][::-1]
    assert len(some.check()) == 1


def test_speeds_lie_between_the_gaits_and_the_bound():
    for plant, gait in known_gaits().fastest().items():
        assert optimal_speed(*plant) < speed_bound(*plant)
        if plant not in SHORTER_INTERVAL_WINS:
            assert optimal_speed(*plant) > gait.mean_speed


def test_the_front_has_no_dominated_point():
    costs, speeds = np.array(archive.optimal_front()).T
    assert len(costs) > 8
    assert (np.diff(costs) > 0.0).all() and (np.diff(speeds) > 0.0).all()
    tables = report(known_results())
    assert tables.count("\n|") > 30 and f"{costs[-1]:.2f}" in tables and f"{speeds[-1]:.2f}" in tables


def test_speeds_between_the_plants():
    assert optimal_speed(0.75, 0.1) == known_results().results[key_of(Problem(M=0.75, mu=0.1))].mean_speed
    assert optimal_speed(0.625, 0.1) == pytest.approx(0.5 * (optimal_speed(0.5, 0.1) + optimal_speed(0.75, 0.1)))
    logarithms = {(M, mu): M + np.log(mu) for M, mu in PLANTS}
    for M, mu in ((0.35, 0.005), (0.6, 0.07), (1.0, 0.5)):
        assert between_plants(logarithms, M, mu) == pytest.approx(M + np.log(mu))
        corners, weights = interpolation_weights(M, mu)
        assert sum(weights) == pytest.approx(1.0)
        assert sum(w * logarithms[PLANTS[c]] for c, w in zip(corners, weights, strict=True)) == pytest.approx(
            M + np.log(mu)
        )
    with pytest.raises(ValueError, match=r"M must be in \[0.35, 1.0\] kg and mu in \[0.005, 0.5\], got M=0.3, mu=0.1"):
        optimal_speed(0.3, 0.1)
    # Rounding of the observation and plants outside the grid take the edge.
    assert interpolation_weights(float(np.float32(0.35)), 0.6) == interpolation_weights(0.35, 0.5)
    assert interpolation_weights(2.0, 1e-4) == interpolation_weights(1.0, 0.005)


def test_the_cycle_is_periodic():
    found = cycle()
    assert found.period == pytest.approx(found.time[-1] + found.time[1])
    assert found.speed == pytest.approx(known_results().results[key_of(Problem())].steady[-1], rel=0.03)
    assert found.normal_force.min() > 0.0
    assert np.abs(found.torque).max() == 1.5
    assert found.theta[0] == pytest.approx(found.theta[-1], abs=0.05)
    # The centre of mass gains no momentum over a cycle.
    arm = NOMINAL.m * NOMINAL.l / (NOMINAL.M + NOMINAL.m)
    centre = found.x_dot - arm * np.cos(found.theta) * found.theta_dot
    assert centre[-1] == pytest.approx(centre[0], abs=0.01)
    with pytest.raises(ValueError, match="problem must be one of those on file"):
        cycle(Problem(M=0.6))


# The archive and the command


def test_values_survive_the_file(tmp_path):
    values = np.random.default_rng(0).uniform(-50.0, 80.0, (5, 6, 7)).astype(np.float32)
    solution = Solution(Problem(), Grid((5, 6, 7), (-3.0, 9.0), (-1.0, 4.0), 0.5), values, 0.4, 20.0, 0.0)
    result = GridResult(solution, repeat(Problem(), (np.arange(1650) % 121).astype(np.uint8)))
    written = Archive()
    written.add(Problem(), [result], 1.0)
    written.save(tmp_path)
    read = load_archive(tmp_path)
    assert read.results == written.results
    assert (read.choices(Problem()) == np.arange(1650) % 121).all()
    again = read.solution(Problem())
    np.testing.assert_allclose(again.values, values, atol=0.003)
    assert (again.grid, again.curvature, again.gain) == (solution.grid, 0.4, 20.0)
    read.add(Problem(), [result], 1.0, values=False)
    with pytest.raises(ValueError, match="holds no values of Problem"):
        read.solution(Problem())


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("archive.json", b'{"results": [{"M": 0.5}]}'),
        ("archive.json", b"\xff"),
        ("arrays.npz", b"PK"),
        ("arrays.npz", b"PK\x03\x04" + bytes(40)),
        ("arrays.npz", b""),
        ("arrays.npz", None),
    ],
)
def test_malformed_files_raise_an_error(tmp_path, name, content):
    for each in ("archive.json", "arrays.npz"):
        shutil.copy(FOLDER / each, tmp_path)
    if content is None:
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=r"must hold an archive written by `python -m baselines\.dynamic_programming`"):
        load_archive(tmp_path)


def test_the_command_solves_what_is_missing_and_keeps_it(tmp_path, monkeypatch, capsys):
    problems = [Problem(), Problem(energy_weight=2.0), Problem(mu=0.3)]
    calls = []

    def quick(problem, shapes):
        calls.append(problem)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return solve_on_grids(problem, [(13, 18, 7)])

    monkeypatch.setattr(command, "problems", lambda: problems)
    monkeypatch.setattr(refinement, "solve_on_grids", quick)
    arguments = ["--folder", str(tmp_path / "new")]
    assert command.main(arguments) == 130
    assert [result.problem for result in load_archive(tmp_path / "new").results.values()] == problems[:2]
    assert command.main(arguments) == 0
    assert calls[3:] == problems[2:]
    assert command.main([*arguments, "--check"]) == 0
    assert "3 trajectories repeated: 0 differ" in capsys.readouterr().out


# The policies


def run(name, M, mu, steps):
    """Metrics of a policy on some plants, from rest."""
    policy = SCRIPTED[name]
    kwargs = {"max_episode_steps": steps, "autoreset_mode": "DISABLED", "randomization": "none", **policy.env_kwargs}
    env = CapsuleVectorEnv(len(M), **kwargs)
    observations, _ = env.reset(seed=0, options={"M": np.array(M), "mu": np.array(mu)})
    act = policy.start(range(len(M)))
    for _ in range(steps):
        observations, *_ = env.step(act(observations))
    return env.episode_metrics()


def test_the_oracle_is_fast_on_the_plants_of_the_grid_and_between():
    metrics = run("optimum-oracle", [0.35, 0.5, 0.42, 0.62], [0.3, 0.01, 0.07, 0.015], 400)
    assert not metrics["failed"].any()
    assert (metrics["mean_speed"] > [30.0, 14.5, 20.0, 12.0]).all()


def test_the_nominal_policy_tolerates_a_lighter_platform():
    metrics = run("optimum-nominal", [0.5, 0.45, 0.55], [0.01, 0.009, 0.011], 400)
    assert not metrics["failed"].any()
    assert (metrics["mean_speed"] > 13.5).all()
    assert metrics["smallest_normal_ratio"][0] > 0.2
