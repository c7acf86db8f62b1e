"""The searches for gaits and for the parameters of the gait law."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from baselines.archive import run_search
from baselines.gaits import __main__ as command
from baselines.gaits import archive, law_candidates, law_search, search, simulation
from baselines.gaits.archive import Archive, GaitMap, load_archive
from baselines.gaits.law_candidates import Candidates, draw_episodes
from baselines.gaits.search import PURPOSES, Search
from baselines.gaits.simulation import compute_map
from baselines.laws.gait import PARAMETERS, known_parameters
from capsule_gym.layout import Row
from tests.baselines.gaits.test_gaits import make_gait


@pytest.fixture
def quick(monkeypatch):
    """A search of seconds: two plants, short episodes, few candidates."""
    pytest.importorskip("cma")
    for module in (archive, search):
        monkeypatch.setattr(module, "PLANTS", ((0.5, 0.01), (0.5, 0.1)))
    for name, value in (("RANDOM_STARTS", 8), ("SHORT_HORIZON", 1.0), ("HORIZON", 2.0)):
        monkeypatch.setattr(search, name, value)
    monkeypatch.setattr(
        search, "PURPOSES", {name: replace(each, generations=2, restarts=1) for name, each in PURPOSES.items()}
    )
    monkeypatch.setattr(
        search, "simulate", lambda *args, **kwargs: simulation.simulate(*args, **{"horizon": 1.0, **kwargs})
    )
    monkeypatch.setattr(search, "sensitivity", lambda results: np.zeros(results["mean_speed"].shape[1]))


def test_a_search_never_worsens_an_entry(quick):
    found, history = Archive(), []
    steps = Search(found, command="test").iterations(count=15)
    run_search(steps, lambda: history.append({key: gait.score for key, gait in found.gaits.items()}))
    assert len(history) == found.iterations == 15
    # Three families on two plants, fastest and tolerant.
    assert len(found.gaits) == 12 and found.front and found.evaluations > 0
    for before, after in pairwise(history):
        assert all(after[key] >= score for key, score in before.items())
    unbeatable = make_gait(1000.0)
    found.offer(unbeatable)
    list(Search(found).iterations(count=1))
    assert found.fastest()[0.5, 0.01] is unbeatable


def test_an_interrupted_search_keeps_what_it_has_found(quick, monkeypatch):
    calls = []

    def interrupted(self, *args):
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return advance(self, *args)

    advance = Search._advance
    monkeypatch.setattr(Search, "_advance", interrupted)
    found, saved = Archive(), []
    assert run_search(Search(found).iterations(), lambda: saved.append(len(found.gaits)))
    assert saved == [2] and found.iterations == 1
    assert {gait.seed for gait in found.gaits.values()} == {(0, 0)}


def test_failures_score_below_everything_and_better_late():
    results = {
        "late_speed": np.array([5.0, 50.0, 50.0]),
        "cost_of_transport": np.array([3.0, 3.0, np.inf]),
        "mean_speed": np.array([5.0, 5.0, 5.0]),
        "failed": np.array([0.0, 1.0, 1.0]),
        "duration": np.array([10.0, 9.0, 1.0]),
    }
    scores = search.score(results, 10.0)
    assert scores[0] == 5.0 > 0.0 > scores[1] > scores[2]
    # On the front the cost counts, and missing the required speed counts more.
    required = search.score(results, 10.0, np.array([6.0, 5.0, 5.0]))
    assert required[0] == -3.0 - search.FRONT_PENALTY and required[1] > required[2]


def test_the_map_takes_the_gait_whose_slowest_run_is_fastest(monkeypatch):
    monkeypatch.setattr(simulation, "MAP_M", (0.5, 0.6, 2))
    monkeypatch.setattr(simulation, "MAP_MU", (0.01, 0.02, 2))

    def simulate(family, parameters, M, mu, *, variants, **kwargs):
        # One gait is fast but fails at the edge of the heavier cells, the other one is slow.
        heavy = np.outer(variants[:, 0], M) > 0.62
        failed = heavy if family == "harmonics" else np.zeros(heavy.shape)
        speed = np.full(heavy.shape, 20.0 if family == "harmonics" else 5.0)
        return {"mean_speed": speed, "failed": failed, "duration": np.full(heavy.shape, 33.0)}

    monkeypatch.setattr(simulation, "simulate", simulate)
    fast, slow = make_gait(20.0), make_gait(5.0, family="bang-bang")
    gait_map = compute_map([fast, slow])
    assert gait_map.gaits == ((fast, fast), (slow, slow))


def test_the_command_goes_on_from_what_is_known(quick, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(simulation, "compute_map", lambda gaits: GaitMap((0.5,), (0.01,), ((gaits[0],),)))
    common = ["--folder", str(tmp_path), "--families", "bang-bang"]
    assert command.main([*common, "--minutes", "0"]) == 1
    assert "holds no gait" in capsys.readouterr().out
    assert command.main([*common, "--iterations", "1", "--seed", "7"]) == 0
    first = load_archive(tmp_path)
    (gait, *_) = first.gaits.values()
    assert gait.seed == (7, 0) and "--seed 7 --families bang-bang" in gait.command
    assert first.oracle is not None

    def interrupt(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(Search, "_start", interrupt)
    assert command.main(common) == 130
    assert load_archive(tmp_path) == replace(first, iterations=2, seconds=load_archive(tmp_path).seconds)
    for option, value in (("--families", "hop"), ("--purposes", "win")):
        with pytest.raises(SystemExit):
            command.main([option, value])
        assert option.strip("-") in capsys.readouterr().err


# The gait law


@pytest.fixture
def quick_law(monkeypatch):
    """A search of seconds: few candidates, few plants, short episodes."""
    pytest.importorskip("cma")
    sizes = {"POPULATION": 4, "PLANTS": 4, "TEST_EPISODES": 4, "TRIAL": 0.4, "HORIZON": 0.4, "TEST_INTERVAL": 2}
    for name, value in sizes.items():
        monkeypatch.setattr(law_candidates, name, value)


def test_episodes_draw_plants_evenly_and_disturb_every_second_one():
    plants, actions = draw_episodes(np.random.default_rng(0), 100, 0.6, repeats=2)
    assert (plants.shape, actions.shape) == ((3, 2, 200), (6, 200))
    assert (plants[..., :100] == plants[..., 100:]).all()
    M, mu = plants[0, :, :100]
    assert np.histogram(M, bins=100, range=(0.35, 0.75))[0].tolist() == [1] * 100
    assert np.histogram(np.log(mu), bins=100, range=np.log((0.005, 0.3)))[0].tolist() == [1] * 100
    assert (actions[:, ::2] == 0.0).all() and (actions[:, 1::2] != 0.0).all()
    candidates = Candidates(8)
    candidates.run(np.tile(known_parameters(), (8, 1)), plants[..., :8], actions[:, :8])
    np.testing.assert_array_equal(candidates.env.simulation.rows(Row.M, Row.mu + 1), plants[-1, :, :8])


def test_a_law_search_writes_better_parameters_only(quick_law, tmp_path, monkeypatch):
    path = tmp_path / "gait.json"
    arguments = ["--generations", "3", "--file", str(path)]
    assert law_search.main(arguments) == 0
    content = json.loads(path.read_text(encoding="utf-8"))
    assert tuple(content["parameters"]) == PARAMETERS
    assert content["found"]["command"] == "python -m baselines.gaits.law_search --seed 0 --generations 3"
    # The same seed finds the same parameters, which are not better.
    assert law_search.main(arguments) == 0
    assert json.loads(path.read_text(encoding="utf-8")) == content
    advance, path = law_candidates.Search.advance, tmp_path / "interrupted.json"
    done = []

    def interrupted(self):
        done.append(self)
        if len(done) == 3:
            raise KeyboardInterrupt
        return advance(self)

    monkeypatch.setattr(law_candidates.Search, "advance", interrupted)
    assert law_search.main(["--generations", "9", "--file", str(path)]) == 130
    assert json.loads(path.read_text(encoding="utf-8"))["found"]["generation"] == 2
