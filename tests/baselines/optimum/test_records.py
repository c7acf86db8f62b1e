import json
import shutil
from itertools import pairwise

import numpy as np
import pytest

from baselines import optimum
from baselines.gaits.archive import GRID_M, GRID_MU, PLANTS, between_plants, known_gaits
from baselines.gaits.bound import speed_bound
from baselines.optimum import __main__ as command
from baselines.optimum import optimal_speed, parts
from baselines.optimum.grid import Grid
from baselines.optimum.levels import allotted, optimise
from baselines.optimum.records import FOLDER, MOTIONS, RECORDS, Archive, key_of, known_optima
from baselines.optimum.solver import Problem, Solution
from capsule_gym.parameters import NOMINAL

# A heavy platform on a rough floor moves at the peaks of the swing alone, which a gait may time to 10 ms.
FINER_HOLD_WINS = {(0.75, 0.5), (1.0, 0.5)}


def test_motions_do_what_the_records_say_to_the_last_bit():
    archive = known_optima()
    some = [key_of(Problem(M=M, mu=mu)) for M, mu in ((0.35, 0.5), (0.5, 0.01), (1.0, 0.005))]
    few = Archive()
    few.records = {key: archive.records[key] for key in some}
    assert parts.check(few) == []
    few.choices[some[0]] = few.choices[some[0]][::-1]
    assert len(parts.check(few)) == 1


def test_optima_lie_between_the_gaits_and_the_bound():
    for plant, gait in known_gaits().table().items():
        speed = optimal_speed(*plant)
        assert speed < speed_bound(*plant)
        if plant not in FINER_HOLD_WINS:
            assert speed > gait.mean_speed


def test_finer_grids_find_more_and_settle():
    gains = known_optima().records[key_of(Problem())].gains
    changes = np.diff(gains)
    assert (changes > 0.0).all() and (np.diff(changes) < 0.0).all()
    assert changes[-1] < 0.01 * gains[-1]


def test_a_joule_that_costs_more_is_spent_less():
    records = sorted(
        (r for r in known_optima().records.values() if (r.M, r.mu, r.hold, r.margin) == (0.5, 0.01, 0.02, 0.0)),
        key=lambda record: record.energy_weight,
    )
    assert len(records) > 8
    transports = [r.cost_of_transport for r in records if r.mean_speed > 1.0]
    # Every motion is an approximation: neighbours may change places by a little.
    assert all(after < 1.03 * before for before, after in pairwise(transports))
    assert transports[-1] < 0.5 * transports[0]


def test_speeds_between_the_plants():
    assert optimal_speed(0.75, 0.1) == known_optima().records[key_of(Problem(M=0.75, mu=0.1))].mean_speed
    middle = 0.5 * (optimal_speed(0.5, 0.1) + optimal_speed(0.75, 0.1))
    assert optimal_speed(0.625, 0.1) == pytest.approx(middle)
    with pytest.raises(ValueError, match=r"M must be in \[0.35, 1.0\] kg"):
        optimal_speed(0.3, 0.1)
    table = {(M, mu): M for M in GRID_M for mu in GRID_MU}
    assert between_plants(table, 0.6, 0.07) == pytest.approx(0.6)


def test_values_survive_the_file(tmp_path):
    rng = np.random.default_rng(0)
    values = rng.uniform(-50.0, 80.0, (5, 6, 7)).astype(np.float32)
    solution = Solution(Problem(), Grid((5, 6, 7), (-3.0, 9.0), (-1.0, 4.0), 0.5), values, 0.4, 20.0, 0.0)
    record = known_optima().records[key_of(Problem())]
    archive = Archive(tmp_path)
    archive.add(record, np.arange(9, dtype=np.uint8), solution)
    archive.save()
    read = Archive(tmp_path)
    assert read.records == {record.key: record}
    again = read.solution(Problem())
    np.testing.assert_allclose(again.values, values, atol=0.003)
    assert (again.grid, again.curvature, again.gain) == (solution.grid, 0.4, 20.0)
    with pytest.raises(ValueError, match="holds no values of Problem"):
        read.solution(Problem(M=0.6))
    read.add(record, np.arange(9, dtype=np.uint8), None)
    with pytest.raises(ValueError, match="holds no values of Problem"):
        read.solution(Problem())


def test_malformed_files_are_named(tmp_path):
    shutil.copytree(FOLDER, tmp_path / "data")
    content = json.loads((tmp_path / "data" / RECORDS).read_text())
    (tmp_path / "data" / RECORDS).write_text(json.dumps([{"M": 0.5}]))
    with pytest.raises(ValueError, match=r"must hold what `python -m baselines\.optimum` writes, got KeyError"):
        Archive(tmp_path / "data")
    (tmp_path / "data" / RECORDS).write_text(json.dumps(content))
    (tmp_path / "data" / MOTIONS).write_bytes(b"PK")
    with pytest.raises(ValueError, match="must hold what"):
        Archive(tmp_path / "data")


def test_the_command_solves_what_is_missing_and_keeps_it(tmp_path, monkeypatch, capsys):
    problems = (Problem(), Problem(energy_weight=2.0), Problem(mu=0.3))
    calls = []

    def quick(problem, levels, report):
        calls.append(problem)
        if len(calls) == 3:
            raise KeyboardInterrupt
        report("on its way")
        return optimise(problem, [(13, 18, 7)], report)

    monkeypatch.setattr(parts, "PARTS", {"plants": problems})
    monkeypatch.setattr(parts, "optimise", quick)
    arguments = ["--folder", str(tmp_path), "--parts", "plants"]
    assert command.main(arguments) == 130
    assert [record.problem for record in Archive(tmp_path).records.values()] == list(problems[:2])
    assert command.main(arguments) == 0
    assert calls[3:] == [problems[2]]
    assert command.main([*arguments, "--check"]) == 0
    assert "3 motions repeated: 0 differ" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        command.main(["--parts", "nothing"])


def test_nodes_go_where_the_range_is():
    assert allotted((31, 51, 16), (-6.0, 20.0), (-1.0, 4.8)) == (31, 51, 16)
    along_theta, along_s, along_w = allotted((31, 51, 16), (-1.0, 3.4), (-16.0, 14.0))
    assert along_theta == 31 and along_s < along_w
    assert along_s * along_w == pytest.approx(51 * 16, rel=0.05)


def test_the_cycle():
    own = optimum.cycle()
    assert own.period == pytest.approx(own.time[-1] + own.time[1])
    assert own.speed == pytest.approx(known_optima().records[key_of(Problem())].steady[-1], rel=0.03)
    assert own.normal_force.min() > 0.0
    assert np.abs(own.torque).max() == 1.5
    assert own.theta[0] == pytest.approx(own.theta[-1], abs=0.05)
    arm = NOMINAL.m * NOMINAL.l / (NOMINAL.M + NOMINAL.m)
    centre = own.x_dot - arm * np.cos(own.theta) * own.theta_dot
    # The cycle gains no momentum.
    assert centre[-1] == pytest.approx(centre[0], abs=0.01)
    with pytest.raises(ValueError, match="problem must be one of those on file"):
        optimum.cycle(Problem(M=0.6))


def test_the_grid_of_plants_is_complete():
    assert {(M, mu) for M, mu in PLANTS} <= {(r.M, r.mu) for r in known_optima().records.values()}


def test_the_help_names_the_parts(capsys):
    with pytest.raises(SystemExit):
        command.main(["--help"])
    text = capsys.readouterr().out
    assert all(part in text for part in parts.PARTS)
