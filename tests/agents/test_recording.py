import numpy as np
import pytest

from agents.evaluation.episodes import evaluate
from agents.recording import record
from capsule_gym.evaluation_sets import EvaluationSet, PlantSpec
from capsule_gym.rendering import CHART_BOTTOM, CHART_LEFT, CHART_TOP
from tests.agents.fakes import Sine

PLANT = PlantSpec(0.6, 0.05, seed=3)


@pytest.mark.parametrize("control_dt", [0.02, 0.01])
def test_a_recording_is_the_episode_of_the_evaluation(control_dt):
    policy = Sine(0.5, env_kwargs={"control_dt": control_dt, "randomization": "wide"})
    found = record(policy, PLANT, seconds=2.0)
    (episode,) = evaluate(policy, EvaluationSet("one", (PLANT,)), horizon=2.0)
    assert found.x[-1] == episode["distance"]
    assert np.abs(found.theta).max() <= episode["largest_theta"]
    np.testing.assert_allclose(found.t, np.arange(len(found.t)) * control_dt)
    assert found.t[-1] == pytest.approx(2.0)
    assert found.frames == ()


def test_a_recording_ends_with_its_episode():
    policy = Sine(1.5, period=10.0)
    found = record(policy, PLANT, seconds=2.0)
    (episode,) = evaluate(policy, EvaluationSet("one", (PLANT,)), horizon=2.0)
    assert episode["failed"]
    assert -1e-9 <= found.t[-1] - episode["duration"] < 0.02


@pytest.mark.parametrize(("control_dt", "frame_seconds", "count"), [(0.02, 0.04, 6), (0.01, 0.1, 3)])
def test_pictures_are_as_often_as_asked_for(control_dt, frame_seconds, count):
    policy = Sine(0.5, env_kwargs={"control_dt": control_dt})
    found = record(policy, PLANT, seconds=0.4, frames_from=0.2, frame_seconds=frame_seconds, name="mine")
    assert len({frame.tobytes() for frame in found.frames}) == len(found.frames) == count
    assert found.name == "mine"


def test_the_axes_of_a_moving_picture_stay():
    found = record(Sine(0.5), PLANT, seconds=1.0, frames_from=0.2)
    # The labels of the vertical axis, less what the first point covers.
    first, *others = (frame[CHART_TOP - 6 : CHART_BOTTOM, : CHART_LEFT - 8] for frame in found.frames)
    assert len(others) == 20
    assert all(np.array_equal(first, other) for other in others)
    assert len({frame.tobytes() for frame in found.frames}) == 21
