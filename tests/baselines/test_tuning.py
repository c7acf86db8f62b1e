import json

import numpy as np
import pytest

from baselines import lqr, tuning
from baselines.laws import gains, periodic
from baselines.laws.gait import PARAMETERS
from baselines.policies import ScriptedPolicy
from capsule_gym.layout import Row

pytest.importorskip("cma")

SMALL = {"POPULATION": 4, "PLANTS": 2, "TRIAL": 0.5, "VALIDATION_PLANTS": 2, "HORIZON": 0.5, "INTERVAL": 2}
SMALL |= {"GAIT_POPULATION": 4, "GAIT_PLANTS": 4, "GAIT_EPISODES": 4}


@pytest.fixture
def small(monkeypatch, tmp_path):
    """Small searches, whose results are in a folder of their own."""
    monkeypatch.setattr(gains, "TUNED", tmp_path / "tuned.json")
    for name, value in SMALL.items():
        monkeypatch.setattr(tuning, name, value)


def on_file(name):
    return json.loads(gains.TUNED.read_text(encoding="utf-8"))[name]


def test_a_failure_scores_below_standstill():
    drop = ScriptedPolicy("drop", "", {"controller": periodic.open_loop((0.5, 1.5, *[0.0] * 8))})
    rest = ScriptedPolicy("rest", "", {"controller": periodic.open_loop((0.5, *[0.0] * 9))})
    (dropped, metrics), (rested, _) = (tuning.score(each, tuning.PAPER, 1, 2, 2.0) for each in (drop, rest))
    assert metrics["failures"] == 2 and dropped < -5.0 < abs(rested) < 0.5


def test_episodes_of_gaits_draw_plants_evenly_and_disturb_every_second_one(monkeypatch):
    plants, actions = tuning.draw_episodes(np.random.default_rng(0), 100, 0.6, repeats=2)
    assert (plants.shape, actions.shape) == ((3, 2, 200), (6, 200))
    assert (plants[..., :100] == plants[..., 100:]).all()
    M, mu = plants[0, :, :100]
    assert np.histogram(M, bins=100, range=(0.35, 0.75))[0].tolist() == [1] * 100
    assert np.histogram(np.log(mu), bins=100, range=np.log((0.005, 0.3)))[0].tolist() == [1] * 100
    assert (actions[:, ::2] == 0.0).all() and (actions[:, 1::2] != 0.0).all() and (np.abs(actions) <= 1.0).all()
    made, make = [], tuning.CapsuleVectorEnv
    monkeypatch.setattr(
        tuning, "CapsuleVectorEnv", lambda *args, **kwargs: made.append(make(*args, **kwargs)) or made[0]
    )
    monkeypatch.setattr(tuning, "draw_episodes", lambda *_: (plants[..., :8], actions[:, :8]))
    tuning.run_gaits(np.array([gains.known_parameters("gait")]), None)
    np.testing.assert_array_equal(made[0].simulation.rows(Row.M, Row.mu + 1), plants[-1, :, :8])


def test_failed_gaits_score_below_everything_and_better_late(monkeypatch):
    parameters = np.zeros((3, len(PARAMETERS)))
    # Constant torques: none, a large one, and one that drops the pendulum later.
    parameters[:, 0] = 0.0, 1.0, 0.4
    monkeypatch.setattr(tuning, "draw_episodes", lambda *_: (np.tile([[0.5], [0.1]], (1, 1, 3)), np.zeros((20, 3))))
    (rest, early, late), metrics = tuning.run_gaits(parameters, np.random.default_rng(0))
    assert (metrics["failures"], metrics["episodes"]) == (2, 3)
    assert abs(rest) < 5.0 and early < late < -30.0


def test_only_better_parameters_replace_those_on_file(small, monkeypatch):
    assert tuning.main(["open-loop", "--generations", "1"]) == 0
    first = on_file("open-loop")
    assert first["found"]["command"].endswith("open-loop --generations 1 --seed 0 --step 0.5")
    monkeypatch.setattr(tuning, "score", lambda *arguments: (-1.0, {}))
    assert tuning.main(["open-loop", "--generations", "1", "--seed", "1"]) == 0
    assert on_file("open-loop") == first


def test_a_search_of_gaits_is_seeded_and_keeps_its_best_when_interrupted(small, monkeypatch):
    assert tuning.main(["gait", "--generations", "3", "--step", "0.2"]) == 0
    found = on_file("gait")
    assert len(found["parameters"]) == len(PARAMETERS) and found["parameters"][-2] >= 0.0
    assert found["found"]["command"] == "python -m baselines.tuning gait --generations 3 --seed 0 --step 0.2"
    # The same seed finds the same parameters. They are no better, so the file stays the same.
    assert tuning.main(["gait", "--generations", "3", "--step", "0.2"]) == 0
    assert on_file("gait") == found
    gains.TUNED.unlink()
    own, calls = tuning.run_gaits, []

    def interrupted(*arguments):
        calls.append(own(*arguments))
        if len(calls) == 5:
            raise KeyboardInterrupt
        return calls[-1]

    monkeypatch.setattr(tuning, "run_gaits", interrupted)
    with pytest.raises(SystemExit, match="130"):
        tuning.main(["gait", "--generations", "100"])
    assert len(on_file("gait")["parameters"]) == len(PARAMETERS)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("pd", -1.1786), ("oscillator", 12.3786), ("open-loop", 7.4638), ("open-loop-real", 8.6820), ("gait", 12.1028)],
)
def test_the_score_of_the_start_of_a_search(name, expected, monkeypatch):
    for attribute, value in (("VALIDATION_SEED", 0), ("VALIDATION_PLANTS", 8), ("HORIZON", 10.0), ("GAIT_EPISODES", 8)):
        monkeypatch.setattr(tuning, attribute, value)
    problem = tuning.problem(name)
    assert problem.start.shape == problem.units.shape and (problem.units > 0.0).all()
    assert problem.run(problem.start[None], None)[0][0] == pytest.approx(expected, abs=1e-3)


def test_the_regulator_with_the_best_score_is_written(monkeypatch, tmp_path):
    committed = lqr.FILE.read_text(encoding="utf-8")
    best, lazy = json.loads(committed), json.loads(committed)
    lazy["gains"] = [[0.0] * 3 for _ in lazy["gains"]]
    monkeypatch.setattr(lqr, "candidates", lambda: iter([lazy, best, lazy]))
    monkeypatch.setattr(lqr, "FILE", tmp_path / "lqr.json")
    for name, value in (("VALIDATION_PLANTS", 32), ("HORIZON", 5.0)):
        monkeypatch.setattr(tuning, name, value)
    assert tuning.main(["lqr"]) == 0
    assert lqr.FILE.read_text(encoding="utf-8") == committed
