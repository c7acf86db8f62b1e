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
REGULATOR = lqr.FILE.read_text(encoding="utf-8")


@pytest.fixture
def small(monkeypatch, tmp_path):
    """Small searches, whose results are in a file of their own, which contains no parameters
    yet."""
    started = {}
    for name, own in read().items():
        started[name] = {"start": own["start"], "units": own["units"]}
    monkeypatch.setattr(gains, "TUNED", tmp_path / "tuned.json")
    gains.TUNED.write_text(json.dumps(started), encoding="utf-8")
    for name, value in SMALL.items():
        monkeypatch.setattr(tuning, name, value)


def read():
    return json.loads(gains.TUNED.read_text(encoding="utf-8"))


def open_loop_score(*amplitudes):
    """Score and metrics of an open loop on two plants over 2 s."""
    rest = [0.0] * (9 - len(amplitudes))
    controller = periodic.open_loop((0.5, *amplitudes, *rest))
    policy = ScriptedPolicy("open loop", "", {"controller": controller})
    return tuning.score(policy, tuning.PAPER, 1, 2, 2.0)


def test_standstill_scores_about_zero():
    score, _ = open_loop_score()
    assert abs(score) < 0.5


def test_a_speed_has_the_digits_of_the_file():
    score, metrics = open_loop_score(0.1)
    assert metrics["failures"] == 0
    digits = 10_000.0 * metrics["mean_speed"]
    assert digits == pytest.approx(round(digits), abs=1e-6)
    assert digits != pytest.approx(10_000.0 * score, abs=1e-6)


def test_a_failure_scores_below_standstill():
    score, metrics = open_loop_score(1.5)
    assert metrics["failures"] == 2
    assert score == pytest.approx(metrics["mean_speed"] - 10.0, abs=1e-4)
    assert score < -5.0


@pytest.fixture
def runs(monkeypatch):
    """How often a search of the default size has run laws by seed, number of plants and seconds."""
    counted = Counter()

    def score_law(name, point, seed, plants, seconds):
        counted[seed, plants, seconds] += 1
        return 0.0, {}

    monkeypatch.setattr(tuning, "score_law", score_law)
    assert tuning.main(["pd"]) == 0
    return counted


def test_a_search_has_200_generations_of_20_candidates(runs):
    searched = [(seconds, count) for (_, plants, seconds), count in runs.items() if plants == 32]
    assert searched == [(12.0, 20)] * 200


def test_no_two_generations_have_a_plant_in_common_or_one_of_an_evaluation_set(runs):
    seeds = sorted(seed for seed, plants, _ in runs if plants == 32)
    assert min(seeds) >= 2**40
    assert (np.diff(seeds) >= 32).all()
    (validation,) = {seed for seed, plants, _ in runs if plants == 1024}
    assert validation >= max(seeds) + 32


def test_a_search_validates_on_whole_episodes_after_each_quarter(runs):
    # The parameters on file, and the mean at the start and after each quarter.
    validated = [(seconds, count) for (_, plants, seconds), count in runs.items() if plants == 1024]
    assert validated == [(33.0, 6)]


def test_better_parameters_replace_those_on_file(small):
    assert tuning.main(["gait", "--generations", "3", "--step", "0.2"]) == 0
    own = read()["gait"]
    assert len(own["parameters"]) == len(own["start"])
    command = "python -m baselines.tuning gait --generations 3 --seed 0 --step 0.2"
    assert own["found"]["command"] == command


def test_a_search_climbs_from_its_start_to_the_best_parameters(small, monkeypatch, capsys):
    own = read()["pd"]
    start = np.array(own["start"])
    units = np.array(own["units"])
    best = start + 4.0 * units
    tried = []

    def score_law(name, parameters, *_):
        tried.append(parameters)
        return -np.square((parameters - best) / units).sum(), {"mean_speed": 0.0, "failures": 0}

    monkeypatch.setattr(tuning, "score_law", score_law)
    assert tuning.main(["pd", "--generations", "200"]) == 0
    assert tried[0] == pytest.approx(start)
    first = np.array(tried[1 : 1 + tuning.POPULATION])
    assert (np.abs(first - start) < 4.0 * 0.5 * units).all()
    np.testing.assert_allclose(read()["pd"]["parameters"], best, atol=0.1 * units.min())
    assert "generation 200: score -0.0" in capsys.readouterr().out


def test_worse_parameters_do_not_replace_those_on_file(small, monkeypatch):
    assert tuning.main(["open-loop", "--generations", "1"]) == 0
    first = read()
    command = first["open-loop"]["found"]["command"]
    assert command.endswith("open-loop --generations 1 --seed 0 --step 0.5")
    monkeypatch.setattr(tuning, "score", lambda *arguments: (-1.0, {}))
    assert tuning.main(["open-loop", "--generations", "1", "--seed", "1"]) == 0
    assert read() == first


def test_a_search_is_seeded(small):
    arguments = ["gait", "--generations", "3", "--step", "0.2"]
    assert tuning.main(arguments) == 0
    first = read()
    # The same seed finds the same parameters. They are no better, so the file stays the same.
    assert tuning.main(arguments) == 0
    assert read() == first


def test_a_search_keeps_its_best_when_interrupted(small, monkeypatch):
    score = tuning.score
    calls = []

    def interrupted(*arguments):
        if not calls:  # another search has written its parameters
            others = dict(reversed(read().items())) | {"gait": "other"}
            gains.TUNED.write_text(json.dumps(others))
        calls.append(score(*arguments))
        if len(calls) == 10:
            raise KeyboardInterrupt
        return calls[-1]

    monkeypatch.setattr(tuning, "score", interrupted)
    with pytest.raises(SystemExit, match="130"):
        tuning.main(["pd", "--generations", "100"])
    content = read()
    assert len(content["pd"]["parameters"]) == len(content["pd"]["start"])
    assert content["gait"] == "other"
    assert list(content) == sorted(content)


@pytest.mark.parametrize("name", SCORES)
def test_entries_of_the_file_have_the_same_length(name):
    own = read()[name]
    assert len(own["start"]) == len(own["units"]) == len(own["parameters"])
    assert min(own["units"]) > 0.0


@pytest.mark.parametrize(("name", "expected"), SCORES.items())
def test_the_score_of_the_start_of_a_search(name, expected):
    start = np.array(read()[name]["start"])
    score, _ = tuning.score_law(name, start, 0, 8, 10.0)
    assert score == pytest.approx(expected, abs=1e-3)


@pytest.fixture
def lazy(monkeypatch, tmp_path):
    """A regulator that does nothing, with another file of the regulator and short validations."""
    content = json.loads(REGULATOR)
    monkeypatch.setattr(lqr, "FILE", tmp_path / "lqr.json")
    monkeypatch.setattr(tuning, "VALIDATION_PLANTS", 32)
    monkeypatch.setattr(tuning, "HORIZON", 5.0)
    return {**content, "gains": [[0.0] * 3 for _ in content["gains"]]}


def test_no_regulator_is_written_before_all_are_tried(lazy, monkeypatch):
    monkeypatch.setattr(lqr, "candidates", lambda: map(dict, (lazy, None)))
    with pytest.raises(TypeError):
        tuning.main(["lqr"])
    assert not lqr.FILE.exists()


def test_the_regulator_with_the_best_score_is_written(lazy, monkeypatch, capsys):
    monkeypatch.setattr(lqr, "candidates", lambda: iter([lazy, json.loads(REGULATOR), lazy]))
    assert tuning.main(["lqr"]) == 0
    assert lqr.FILE.read_text(encoding="utf-8") == REGULATOR
    assert capsys.readouterr().out.count("control intervals: score") == 3
