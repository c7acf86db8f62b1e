import json

import pytest

from baselines import lqr, tuning
from baselines.laws import periodic
from baselines.policies import ScriptedPolicy

pytest.importorskip("cma")


def test_a_failure_scores_below_standstill():
    drop = ScriptedPolicy("drop", "", {"controller": periodic.open_loop((0.5, 1.5, *[0.0] * 8))})
    rest = ScriptedPolicy("rest", "", {"controller": periodic.open_loop((0.5, *[0.0] * 9))})
    (dropped, metrics), (rested, _) = (tuning.score(each, tuning.PAPER, 1, 2, 2.0) for each in (drop, rest))
    assert metrics["failures"] == 2 and dropped < -5.0 < abs(rested) < 0.5


def test_only_better_parameters_replace_those_on_file(monkeypatch, tmp_path):
    monkeypatch.setattr(periodic, "FILE", tmp_path / "periodic.json")
    for name, value in (("POPULATION", 4), ("PLANTS", 2), ("TRIAL", 0.5), ("VALIDATION_PLANTS", 2), ("HORIZON", 0.5)):
        monkeypatch.setattr(tuning, name, value)
    assert tuning.main(["open-loop", "--generations", "1"]) == 0
    first = json.loads(periodic.FILE.read_text(encoding="utf-8"))["open-loop"]
    assert first["found"]["command"].endswith("open-loop --generations 1 --seed 0 --step 0.5")
    monkeypatch.setattr(tuning, "score", lambda *arguments: (-1.0, {}))
    assert tuning.main(["open-loop", "--generations", "1", "--seed", "1"]) == 0
    assert json.loads(periodic.FILE.read_text(encoding="utf-8"))["open-loop"] == first


@pytest.mark.parametrize(
    ("name", "expected"), [("pd", -1.1786), ("oscillator", 12.3786), ("open-loop", 7.4638), ("open-loop-real", 8.6820)]
)
def test_the_score_of_the_start_of_a_search(name, expected):
    problem = tuning.problem(name)
    assert problem.start.shape == problem.units.shape and (problem.units > 0.0).all()
    kwargs = {"controller": problem.make(problem.start.tolist()), "control_dt": tuning.CONTROL_DT}
    reached, _ = tuning.score(ScriptedPolicy(name, "", kwargs), problem.env_kwargs, 0, 8, 10.0)
    assert reached == pytest.approx(expected, abs=1e-3)


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
