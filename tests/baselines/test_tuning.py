import json
from collections import Counter

import numpy as np
import pytest

from baselines import lqr, tuning
from capsule_gym.control.laws import gains, periodic
from capsule_gym.policies.scripted import ScriptedPolicy

pytest.importorskip("cma")

SMALL = {
    "POPULATION": 4,
    "PLANTS": 2,
    "TRIAL": 0.5,
    "VALIDATION_PLANTS": 2,
    "HORIZON": 0.5,
    "INTERVAL": 2,
}
SCORES = {
    "pd": -1.1786,
    "oscillator": 12.3786,
    "open-loop": 7.4638,
    "open-loop-real": 8.6820,
    "gait": 14.6546,
}


@pytest.fixture
def small(monkeypatch, tmp_path):
    """Small searches, whose results are in a file of their own, which contains no parameters
    yet."""
    content = json.loads(gains.TUNED.read_text(encoding="utf-8"))
    monkeypatch.setattr(gains, "TUNED", tmp_path / "tuned.json")
    started = {
        name: {"start": own["start"], "units": own["units"]} for name, own in content.items()
    }
    gains.TUNED.write_text(json.dumps(started), encoding="utf-8")
    for name, value in SMALL.items():
        monkeypatch.setattr(tuning, name, value)


def on_file(name):
    return json.loads(gains.TUNED.read_text(encoding="utf-8"))[name]


def test_a_failure_scores_below_standstill():
    drop = ScriptedPolicy("drop", "", {"controller": periodic.open_loop((0.5, 1.5, *[0.0] * 8))})
    rest = ScriptedPolicy("rest", "", {"controller": periodic.open_loop((0.5, *[0.0] * 9))})
    (dropped, metrics), (rested, _) = (
        tuning.score(each, tuning.PAPER, 1, 2, 2.0) for each in (drop, rest)
    )
    assert metrics["failures"] == 2 and dropped < -5.0 < abs(rested) < 0.5


def test_a_search_has_the_size_that_its_help_names(monkeypatch):
    runs = Counter()

    def score_law(name, point, seed, plants, seconds):
        runs[seed, plants, seconds] += 1
        return 0.0, {}

    monkeypatch.setattr(tuning, "score_law", score_law)
    assert tuning.main(["pd"]) == 0
    # 200 generations of 20 candidates, each on 32 plants that no other generation and no evaluation
    # set has.
    searched = {seed: count for (seed, plants, _), count in runs.items() if plants == 32}
    assert len(searched) == 200 and set(searched.values()) == {20}
    assert min(searched) >= 2**40 and (np.diff(sorted(searched)) >= 32).all()
    # The parameters on file, and the mean at the start and after each quarter of the search, on
    # whole episodes.
    assert [(seconds, count) for (_, plants, seconds), count in runs.items() if plants == 1024] == [
        (33.0, 6)
    ]


def test_only_better_parameters_replace_those_on_file(small, monkeypatch):
    assert tuning.main(["open-loop", "--generations", "1"]) == 0
    first = on_file("open-loop")
    assert first["found"]["command"].endswith("open-loop --generations 1 --seed 0 --step 0.5")
    monkeypatch.setattr(tuning, "score", lambda *arguments: (-1.0, {}))
    assert (
        tuning.main(["open-loop", "--generations", "1", "--seed", "1"]) == 0
        and on_file("open-loop") == first
    )


def test_a_search_is_seeded_and_keeps_its_best_when_interrupted(small, monkeypatch):
    assert tuning.main(["gait", "--generations", "3", "--step", "0.2"]) == 0
    found = on_file("gait")
    assert len(found["parameters"]) == len(found["start"])
    assert (
        found["found"]["command"]
        == "python -m baselines.tuning gait --generations 3 --seed 0 --step 0.2"
    )
    # The same seed finds the same parameters. They are no better, so the file stays the same.
    assert (
        tuning.main(["gait", "--generations", "3", "--step", "0.2"]) == 0
        and on_file("gait") == found
    )
    own, calls = tuning.score, []

    def interrupted(*arguments):
        if not calls:  # another search has written its parameters
            gains.TUNED.write_text(
                json.dumps(json.loads(gains.TUNED.read_text(encoding="utf-8")) | {"gait": "other"})
            )
        calls.append(own(*arguments))
        if len(calls) == 10:
            raise KeyboardInterrupt
        return calls[-1]

    monkeypatch.setattr(tuning, "score", interrupted)
    with pytest.raises(SystemExit, match="130"):
        tuning.main(["pd", "--generations", "100"])
    assert (
        len(on_file("pd")["parameters"]) == len(on_file("pd")["start"])
        and on_file("gait") == "other"
    )


@pytest.mark.parametrize(("name", "expected"), SCORES.items())
def test_the_score_of_the_start_of_a_search(name, expected):
    own = json.loads(gains.TUNED.read_text(encoding="utf-8"))[name]
    assert (
        len(own["start"]) == len(own["units"]) == len(own["parameters"]) and min(own["units"]) > 0.0
    )
    assert tuning.score_law(name, np.array(own["start"]), 0, 8, 10.0)[0] == pytest.approx(
        expected, abs=1e-3
    )


def test_the_regulator_with_the_best_score_is_written(monkeypatch, tmp_path):
    committed = lqr.FILE.read_text(encoding="utf-8")
    best, lazy = json.loads(committed), json.loads(committed)
    lazy["gains"] = [[0.0] * 3 for _ in lazy["gains"]]
    monkeypatch.setattr(lqr, "FILE", tmp_path / "lqr.json")
    for name, value in (("VALIDATION_PLANTS", 32), ("HORIZON", 5.0)):
        monkeypatch.setattr(tuning, name, value)
    monkeypatch.setattr(lqr, "candidates", lambda: map(dict, (lazy, None)))
    with pytest.raises(TypeError):
        tuning.main(["lqr"])
    assert not lqr.FILE.exists()
    monkeypatch.setattr(lqr, "candidates", lambda: iter([lazy, best, lazy]))
    assert tuning.main(["lqr"]) == 0
    assert lqr.FILE.read_text(encoding="utf-8") == committed
