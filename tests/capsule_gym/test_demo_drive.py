"""One episode and its driver: it is the environment's, keeps its time, and who cannot drive is refused."""

from __future__ import annotations

import pytest

from capsule_gym.demo import Drive, find_driver
from capsule_gym.evaluation_sets import load_set
from capsule_gym.task import HORIZON, Termination


def test_a_drive_is_the_episode_of_the_environment_with_its_law():
    drive = Drive(find_driver("baselines:adaptive"), load_set("paper").plants[0])
    drive.advance(HORIZON)
    metrics = drive.env.episode_metrics()
    assert drive.mean_speed == pytest.approx(metrics["mean_speed"], rel=1e-12)
    assert metrics["mean_speed"] > 1.0


def test_a_policy_with_a_step_of_its_own_keeps_the_time():
    drive = Drive(find_driver("residual-ppo"), load_set("wide").plants[0])
    assert drive.driver.env_kwargs["control_dt"] == 0.005
    drive.advance(0.1)
    assert drive.time == pytest.approx(0.1)


def test_a_plant_jumps_when_its_set_says_so():
    plant = load_set("drift").plants[0]
    drive = Drive(find_driver("adaptive"), plant)
    drive.advance(plant.changes[0].t)
    assert drive.shown()["M"] == plant.M
    drive.advance(plant.changes[0].t + 0.02)
    assert drive.shown()["M"] == plant.changes[0].M


def test_who_cannot_drive_is_refused_with_the_nearest_name():
    with pytest.raises(ValueError, match=r"got 'adaptve'; did you mean 'adaptive'\?"):
        find_driver("adaptve")


@pytest.mark.parametrize("name", ["adaptive", "baselines:adaptive"])
def test_a_law_is_found_with_and_without_its_package(name):
    law = find_driver(name)
    assert (law.name, law.env_kwargs) == ("adaptive", {"controller": "baselines:adaptive"})


@pytest.mark.parametrize(
    ("name", "attribute"),
    [("feedback-linearising", "feedback_linearising"), ("gait-guarded", "gait"), ("gait", "gait")],
)
def test_a_law_is_found_and_shown_as_the_leaderboard_or_python_names_it(name, attribute):
    law = find_driver(name)
    assert (law.name, law.env_kwargs) == (name, {"controller": f"baselines:{attribute}"})


@pytest.mark.parametrize("name", ["random", "gait-nominal", "gait-oracle", "optimum-nominal", "optimum-oracle"])
def test_a_row_that_is_neither_law_nor_trained_is_refused(name):
    with pytest.raises(ValueError, match=f"must be one of zero, .*gait-guarded.* got '{name}'"):
        find_driver(name)


@pytest.mark.parametrize("name", ["adaptive", "epc", "residual-ppo"])
def test_a_law_that_follows_a_reference_shows_it(name):
    drive = Drive(find_driver(name), load_set("paper").plants[0])
    drive.advance(0.5)
    simulation = drive.env.simulation
    tick = round(0.5 / simulation.controller.dt)
    assert drive.shown()["theta_reference"] == simulation.reference[tick % len(simulation.reference), 0] != 0.0


@pytest.mark.parametrize("name", ["gait", "gait_identifying", "residual-on-gait", "direct-ppo", "zero"])
def test_what_follows_no_reference_shows_none(name):
    drive = Drive(find_driver(name), load_set("paper").plants[0])
    for time in (0.0, 0.5):
        drive.advance(time)
        assert drive.shown()["theta_reference"] is None


def test_a_broken_policy_file_is_refused_by_its_path(tmp_path):
    path = tmp_path / "policy.safetensors"
    path.write_bytes(b"no policy")
    with pytest.raises(ValueError, match="is no policy") as caught:
        find_driver(str(path))
    assert str(path) in str(caught.value)


def test_an_episode_that_is_over_stands_still_until_the_next_begins():
    plant = load_set("nominal").plants[0]
    drive = Drive(find_driver("zero"), plant)
    assert drive.mean_speed == 0.0 and drive.end is None
    drive.advance(2.0 * HORIZON)
    assert drive.end is Termination.none
    last, time = drive.shown(), drive.time
    drive.advance(3.0 * HORIZON)
    assert (drive.shown(), drive.time) == (last, time)
    assert drive.ghost().x == last["x"] and drive.ghost().name == "zero"
    drive.begin(plant)
    assert (drive.end, drive.time, drive.shown()["x"]) == (None, 0.0, 0.0)
