"""The cells of the table of information, their record, references, and regret."""

import itertools
import shutil
import time
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from agents import information
from agents.analysis import information as analysis
from agents.distillation import plants as solving
from agents.distillation.dagger import FINISHED
from agents.information import Cell, all_cells, main, read_record, train_cell
from baselines.dynamic_programming.archive import optimal_speed
from baselines.dynamic_programming.policy import TORQUES
from capsule_gym import CapsuleEnv
from capsule_gym.evaluation.candidates import CHECKPOINTS
from capsule_gym.evaluation.sets import EvaluationSet, PlantSpec, load_set
from capsule_gym.evaluation.statistics import paired_difference
from capsule_gym.files import to_json
from capsule_gym.parameters import Disturbances
from capsule_gym.policies.policy import POLICY
from tests.agents.leaderboard.world import table
from tests.agents.training.small import small
from tests.figures import assert_lines, texts

PAPER = optimal_speed(0.5, 0.01)


@pytest.fixture(autouse=True)
def short_wide(monkeypatch):
    """Evaluates cells of `wide` on its first plants."""
    whole = load_set("wide")
    short = replace(whole, plants=whole.plants[:3])
    evaluate = information.evaluate

    def evaluate_short(policy, where):
        return evaluate(policy, short if where == "wide" else where)

    monkeypatch.setattr(information, "evaluate", evaluate_short)


@pytest.fixture
def record(tmp_path, monkeypatch):
    """An empty record."""
    path = tmp_path / "record.npz"
    monkeypatch.setattr(information, "RECORD", path)
    return path


@pytest.fixture
def quick_cell(monkeypatch):
    """The only cell, which trains in seconds."""
    cell = Cell("wide", "quick", small("direct", "ppo", total_steps=512, randomization="wide"))
    monkeypatch.setattr(information, "all_cells", lambda: {"quick": cell})
    return cell


def test_cells_differ_in_nothing_but_what_they_observe():
    cells = all_cells()
    for set_name in information.SETS:
        blind = cells[f"{set_name}-nothing-distilled"].settings
        for observed, arguments in information.OBSERVATIONS.items():
            settings = cells[f"{set_name}-{observed}-distilled"].settings
            assert settings == replace(blind, observation=arguments)
    blind = cells["wide-nothing-ppo"].settings
    for observed in ("history", "plant"):
        settings = cells[f"wide-{observed}-ppo"].settings
        assert settings == replace(blind, **information.OBSERVATIONS[observed])
    same_critic = cells["wide-history-ppo-same-critic"].settings
    assert replace(same_critic, privileged=True) == cells["wide-history-ppo"].settings


def test_a_cell_observes_what_its_name_says():
    cells = all_cells()
    assert cells["wide-plant-ppo"].settings.observe_parameters
    for set_name in information.SETS:
        estimates = cells[f"{set_name}-estimates-distilled"].settings
        assert estimates.env_kwargs["observe_estimates"]
        plant = cells[f"{set_name}-plant-distilled"].settings
        assert plant.env_kwargs["observe_parameters"]
    readings = cells["wide-history-ppo"].settings.stack_size
    assert analysis.INFORMATION["history"] == f"{readings} readings"


def test_ppo_is_trained_on_the_plants_of_its_set():
    found = [cell for cell in all_cells().values() if "-ppo" in cell.name]
    assert {(cell.set_name, cell.settings.randomization) for cell in found} == {("wide", "wide")}


def test_students_of_wide_are_trained_with_perfect_sensors():
    student = all_cells()["wide-nothing-distilled"].settings
    assert student.disturbances == "none"
    assert student.severities == (0.0,)
    assert student.validation == ("wide",)


def test_students_of_real_wide_are_trained_under_its_conditions():
    cells = all_cells()
    student = cells["real-wide-nothing-distilled"].settings
    assert student.randomization == "real-wide"
    assert student.disturbances == "real"
    assert set(student.plants) == {"real-wide"}
    assert student.validation == ("real-wide",)
    # Disturbances have their full size, and plants do not change.
    assert student.severities == (1.0,)
    assert student.change_rate == 0.0
    assert student.spare_share == 0.0


def test_the_students_of_both_sets_have_networks_of_the_same_size():
    cells = all_cells()
    for observed in ("nothing", "memory"):
        both = [cells[f"{set_name}-{observed}-distilled"].settings for set_name in information.SETS]
        assert both[0].hidden == both[1].hidden
        assert both[0].units == both[1].units


def test_a_memory_is_trained_on_the_plants_of_the_other_students():
    cells = all_cells()
    names = ("randomization", "disturbances", "groups", "plants", "severities", "change_rate")
    for set_name in information.SETS:
        memory = cells[f"{set_name}-memory-distilled"].settings
        blind = cells[f"{set_name}-nothing-distilled"].settings
        assert memory.units > 0
        assert memory.observation == {}
        for name in names:
            assert getattr(memory, name) == getattr(blind, name), name


def test_a_finished_cell_is_evaluated_again_without_a_training(quick_cell, tmp_path, monkeypatch):
    # On a fast processor the training takes so little that it is rounded to zero.
    monkeypatch.setattr(time, "process_time", itertools.count(0.0, 10.0).__next__)
    first = train_cell(quick_cell, (0, 1), tmp_path, 1)
    assert first["mean_speed"].shape == (2, 3)
    assert (first["mean_speed"][0] != first["mean_speed"][1]).any()
    assert (first["core_seconds"] > 0.0).all()
    monkeypatch.setattr("agents.training.loop.train", None)
    again = train_cell(quick_cell, (0, 1), tmp_path, 1)
    for name, values in first.items():
        np.testing.assert_array_equal(again[name], values, err_msg=name)


def test_a_finished_student_is_not_trained_again(tmp_path):
    cell = all_cells()["wide-estimates-distilled"]
    run = tmp_path / "wide" / f"{cell.name}-0"
    run.mkdir(parents=True)
    shutil.copy(CHECKPOINTS / "dp-distilled-wide" / "seed-0" / POLICY, run)
    (run / FINISHED).write_text(to_json({"core_seconds": 12.5}))
    found = train_cell(cell, (0,), tmp_path, 1)
    assert found["core_seconds"] == [12.5]
    assert found["mean_speed"].min() > 10.0


@pytest.mark.usefixtures("quick_cell")
def test_a_cell_is_added_to_those_in_the_record(record, tmp_path, capsys):
    before = {"slow": {"mean_speed": np.array([[1.0, 2.0]])}}
    information._write_record(before)
    arguments = ["quick", "--seeds", "3", "--jobs", "1", "--runs", str(tmp_path / "runs")]
    assert main(arguments) == 0
    assert "quick: " in capsys.readouterr().out
    found = read_record()
    # Cells are sorted, in whatever order they were added.
    assert list(found) == ["quick", "slow"]
    np.testing.assert_array_equal(found["slow"]["mean_speed"], [[1.0, 2.0]])
    assert found["quick"]["failed"].shape == (1, 3)
    assert record.is_file()


OTHERS = {"real-wide-optimum", "real-ceiling", "real-wide-ceiling"}


@pytest.mark.usefixtures("record")
def test_all_cells_are_computed_by_default(monkeypatch, capsys):
    def trained(cell, seeds, runs, jobs):
        return results([[10.0 + seed] * 2 for seed in seeds], 0.5)

    monkeypatch.setattr(information, "train_cell", trained)
    monkeypatch.setattr(information, "evaluate_reference", lambda: results([[20.0]]))
    ceilings = {"real": results([[21.0]]), "real-wide": results([[22.0]])}
    monkeypatch.setattr(information, "evaluate_ceiling", lambda name, folder: ceilings[name])
    assert main([]) == 0
    found = read_record()
    assert found.keys() == all_cells().keys() | OTHERS
    for name in all_cells():
        assert found[name]["mean_speed"].mean(axis=1).tolist() == [10.0, 11.0, 12.0]
    assert found["real-wide-optimum"]["mean_speed"] == 20.0
    assert found["real-ceiling"]["mean_speed"] == 21.0
    assert found["real-wide-ceiling"]["mean_speed"] == 22.0
    assert "wide-nothing-ppo: 11.00 cm/s, 50.0 % failed\n" in capsys.readouterr().out


def test_the_record_has_every_cell_with_three_seeds():
    found = read_record()
    assert found.keys() == all_cells().keys() | OTHERS
    for name in all_cells():
        assert len(found[name]["mean_speed"]) == 3
    for set_name in information.CEILED:
        shape = found[f"{set_name}-ceiling"]["mean_speed"].shape
        assert shape == (1, information.CEILING_PLANTS)


@pytest.mark.usefixtures("quick_cell")
def test_an_unknown_cell_is_named(capsys):
    with pytest.raises(SystemExit):
        main(["slow"])
    error = capsys.readouterr().err
    assert "'slow'" in error
    assert "quick, real-wide-optimum" in error


def drawn(name, disturbances, **plant):
    plants = (PlantSpec(M=0.5, mu=0.01, seed=0, **plant),)
    return EvaluationSet(name, plants, disturbances=disturbances)


def test_the_reference_ignores_pendulum_and_disturbances(monkeypatch):
    disturbed = drawn("real-wide", "real", capsule={"m": 0.14, "l": 0.27})
    monkeypatch.setattr(information, "load_set", lambda name: disturbed)
    found = information.evaluate_reference()
    assert found["mean_speed"] == pytest.approx(np.array([[PAPER]]), rel=0.03)
    assert not found["failed"].any()


def test_the_ceiling_is_the_optimum_of_each_plant_whatever_the_sensors_are(monkeypatch, tmp_path):
    # Friction of the motor and the pendulum's mass hardly change the optimum.
    blurred = Disturbances(theta_noise=0.1, x_dot_noise=0.1, motor_friction=(0.0005, 0.001))
    light = PlantSpec(M=0.4, mu=0.1, seed=1, capsule={"m": 0.139})
    plants = (PlantSpec(M=0.5, mu=0.01, seed=0), light)
    both = EvaluationSet("two", plants, disturbances=blurred)
    monkeypatch.setattr(information, "load_set", lambda name: both)
    monkeypatch.setattr(solving, "solve_near", partial(solving.solve_near, shape=(21, 31, 9)))
    solved = []

    def solve(problems, folder):
        solved.extend(problems)
        return solving.solve_problems(problems, folder, jobs=1)

    monkeypatch.setattr(information, "solve_problems", solve)
    found = information.evaluate_ceiling("real", tmp_path)
    optima = [PAPER, optimal_speed(0.4, 0.1)]
    assert found["mean_speed"] == pytest.approx(np.array([optima]), rel=0.06)
    assert not found["failed"].any()
    assert [(each.M, each.mu, each.m) for each in solved] == [(0.5, 0.01, 0.138), (0.4, 0.1, 0.139)]
    for problem, plant in zip(solved, plants, strict=True):
        _, info = CapsuleEnv(disturbances=blurred).reset(seed=plant.seed)
        assert problem.motor_friction == info["disturbances"]["motor_friction"]


def test_an_episode_of_the_ceiling_ends_with_its_failure(monkeypatch, tmp_path):
    # The largest torque lifts the platform.
    scores = np.array([np.arange(len(TORQUES))])
    expert = SimpleNamespace(scores=lambda: scores)
    monkeypatch.setattr(information, "PlantOracle", lambda simulation, solutions: expert)
    monkeypatch.setattr(information, "solve_problems", lambda problems, folder: [])
    monkeypatch.setattr(information, "load_set", lambda name: drawn("real", "real"))
    found = information.evaluate_ceiling("real", tmp_path)
    assert found["failed"].tolist() == [[1.0]]


def results(speeds, failed=0.0):
    speeds = np.array(speeds)
    return {"mean_speed": speeds, "failed": np.full(speeds.shape, failed)}


@pytest.fixture
def small_record():
    """A record of two cells: the plants' optimum is 20, 10 and 15 cm/s."""
    found = {"real-wide-optimum": results([[20.0, 10.0, 15.0]])}
    seeds = [[16.0, 6.0, 12.0], [15.0, 7.0, 10.0], [15.5, 6.5, 8.0]]
    found["real-wide-nothing-distilled"] = results(seeds, 1.0)
    found["real-wide-memory-distilled"] = results([[19.0, 9.0, 14.0]] * 3)
    return found


def test_regret_is_what_the_optimum_gains_on_the_same_episode(small_record):
    _, _, blind, memory, optimum = table(analysis.table(small_record, "real-wide"))
    assert blind[:2] == ["nothing more", "distilled"]
    assert blind[2].startswith("10.67 [")
    assert blind[3].startswith("4.33 [")
    # Mean speed of each plant: 15.5, 6.5, 10.
    assert blind[4] == "7.20"
    assert memory[3] == "1.00 [1.00,\xa01.00]"
    assert optimum[:2] == ["M and mu", "dp-oracle"]
    assert optimum[3] == "0"


def test_cells_are_compared_with_those_that_observe_nothing_more(small_record):
    small_record["real-wide-plant-distilled"] = results([[16.0, 6.0, 11.0]] * 3)
    small_record["real-wide-plant-ppo"] = results([[1.0, 2.0, 3.0]] * 3)
    blind = small_record["real-wide-nothing-distilled"]["mean_speed"]
    expected = {}
    for name in ("memory", "plant"):
        speeds = small_record[f"real-wide-{name}-distilled"]["mean_speed"]
        expected[name] = paired_difference(speeds, blind, mean=True).p_value
    assert 2.0 * expected["memory"] < expected["plant"]
    assert analysis.compare(small_record) == {
        "real-wide-memory-distilled": 2.0 * expected["memory"],
        "real-wide-plant-distilled": expected["plant"],
    }


def test_the_table_shows_adjusted_p_values(small_record):
    header, _, blind, memory, optimum = table(analysis.table(small_record, "real-wide"))
    column = header.index("p of 1 [Holm]")
    (p_value,) = analysis.compare(small_record).values()
    assert [each[column] for each in (blind, memory, optimum)] == ["-", f"{p_value:.3f}", "-"]


@pytest.mark.parametrize(
    ("p_value", "text"), [(0.0009, "<0.001"), (0.0011, "0.001"), (0.2, "0.200"), (None, "-")]
)
def test_a_p_value_has_three_decimals(p_value, text):
    assert analysis._p_text(p_value) == text


def test_the_failures_of_a_cell_are_those_of_all_seeds():
    assert analysis.failures({"failed": np.zeros((2, 500))}) == "0/1000 [0.0,\xa00.4]"


def test_the_figures_show_every_learner_and_the_optimum(small_record, monkeypatch):
    for name, found in list(small_record.items()):
        small_record[name.replace("real-wide", "wide")] = found
    figure = analysis.draw_speeds(small_record)
    (legend,) = figure.legends
    assert texts(legend.get_texts()) == ["distilled", "dp-oracle"]
    assert figure.axes[0].get_ylabel() == "mean speed (cm/s)"
    assert "dots: training seeds" in figure.get_supxlabel()
    for axes, set_name in zip(figure.axes, information.SETS, strict=True):
        assert axes.get_title() == set_name
        assert texts(axes.get_xticklabels()) == list(analysis.INFORMATION.values())
        assert_lines(
            axes,
            ([0, 0, 0], [34 / 3, 32 / 3, 10], analysis.BLUE),
            ([2, 2, 2], [14, 14, 14], analysis.BLUE),
            ([0, 2], [32 / 3, 14], analysis.BLUE),
            ([0, 1], [15, 15], analysis.GREEN),
        )
    plants = [SimpleNamespace(M=0.5, mu=mu) for mu in (0.01, 0.1, 0.3)]
    monkeypatch.setattr(analysis, "load_set", lambda name: SimpleNamespace(plants=plants))
    blind, memory, scale = analysis.draw_regrets(small_record).axes
    assert (blind.get_title(), memory.get_title()) == (
        "observed: nothing more",
        "observed: a memory",
    )
    assert (blind.get_xlabel(), blind.get_ylabel()) == ("mu", "M (kg)")
    assert (blind.get_xscale(), blind.get_yscale()) == ("log", "linear")
    assert scale.get_ylabel() == "regret (cm/s)"
    np.testing.assert_allclose(blind.collections[0].get_array(), [4.5, 3.5, 5.0])
    np.testing.assert_allclose(memory.collections[0].get_array(), [1.0, 1.0, 1.0])
