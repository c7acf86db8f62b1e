"""The searches for gaits and for the parameters of the gait law."""

from __future__ import annotations

import json
from itertools import islice, pairwise

import numpy as np
import pytest

from baselines.gaits import __main__ as command
from baselines.gaits import archive, law_search, search
from baselines.gaits.archive import Archive, GaitMap, load_archive
from baselines.gaits.law_search import draw_episodes, make_batch, run_candidates
from baselines.gaits.search import PURPOSES, compute_map, simulate
from baselines.laws.gait import PARAMETERS, known_parameters
from capsule_gym.layout import Row
from tests.baselines.gaits.test_gaits import make_gait


@pytest.fixture
def quick(monkeypatch):
    """A search that takes seconds: two plants, short episodes, few candidates."""
    pytest.importorskip("cma")
    for module in (archive, search):
        monkeypatch.setattr(module, "PLANTS", ((0.5, 0.01), (0.5, 0.1)))
    monkeypatch.setattr(search, "RANDOM_STARTS", 8)
    purposes = {name: each._replace(generations=2, restarts=1) for name, each in PURPOSES.items()}
    monkeypatch.setattr(search, "PURPOSES", purposes)
    monkeypatch.setattr(search, "simulate", lambda *args, **kwargs: simulate(*args, **{**kwargs, "horizon": 1.0}))
    monkeypatch.setattr(search, "sensitivity", lambda results: np.zeros(results["mean_speed"].shape[1]))


def test_a_search_never_worsens_an_entry(quick):
    found, history = Archive(), []
    for _ in islice(search.search(found, 0, 10.0), 15):
        history.append({key: gait.score for key, gait in found.gaits.items()})
    # Three families on two plants give the fastest gaits and most of the tolerant ones.
    assert len(found.gaits) >= 10 and found.front
    for before, after in pairwise(history):
        assert all(after[key] >= score for key, score in before.items())
    unbeatable = make_gait(1000.0)
    found.offer(unbeatable)
    next(search.search(found, 0, 10.0))
    assert found.fastest()[0.5, 0.01] is unbeatable


def test_failures_score_below_everything_and_better_late():
    results = {
        "cost_of_transport": np.array([3.0, 3.0, np.inf]),
        "mean_speed": np.array([5.0, 50.0, 50.0]),
        "failed": np.array([0.0, 1.0, 1.0]),
        "duration": np.array([10.0, 9.0, 1.0]),
    }
    scores = search.score(results, 10.0)
    assert scores[0] == 5.0 > 0.0 > scores[1] > scores[2]
    # On the front, the cost counts; a speed below the required one counts more.
    required = search.score(results, 10.0, np.array([6.0, 50.0, 50.0]))
    assert required[0] == -3.0 - search.FRONT_PENALTY and required[1] > required[2]


def test_the_map_takes_the_gait_whose_slowest_run_is_fastest(monkeypatch):
    monkeypatch.setattr(search, "MAP_M", (0.5, 0.6, 2))
    monkeypatch.setattr(search, "MAP_MU", (0.01, 0.02, 2))

    def simulate(family, parameters, M, mu, *, variants, **kwargs):
        # One gait is fast but fails at the edge of the heavier cells; the other gait is slow.
        heavy = np.outer(variants[:, 0], M) > 0.62
        failed = heavy if family == "harmonics" else np.zeros(heavy.shape)
        speed = np.full(heavy.shape, 20.0 if family == "harmonics" else 5.0)
        return {"mean_speed": speed, "failed": failed, "duration": np.full(heavy.shape, 33.0)}

    monkeypatch.setattr(search, "simulate", simulate)
    fast, slow = make_gait(20.0), make_gait(5.0, family="bang-bang")
    gait_map = compute_map([fast, slow])
    assert (gait_map.gaits, gait_map.cells) == ((fast, slow), ((0, 0), (1, 1)))


def test_the_command_goes_on_from_what_is_known(quick, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(search, "compute_map", lambda gaits: GaitMap((0.5,), (0.01,), (gaits[0],), ((0,),)))
    common = ["--folder", str(tmp_path)]
    assert command.main([*common, "--minutes", "0"]) == 1
    assert "holds no gait" in capsys.readouterr().out
    assert command.main([*common, "--minutes", "0.0001", "--seed", "7"]) == 0
    first = load_archive(tmp_path)
    assert (first.iterations, len(first.oracle.gaits)) == (1, 1) and len(first.gaits) == 2

    def interrupt(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(search, "find_candidates", interrupt)
    assert command.main(common) == 130
    assert load_archive(tmp_path) == first


def test_episodes_draw_plants_evenly_and_disturb_every_second_one():
    plants, actions = draw_episodes(np.random.default_rng(0), 100, 0.6, repeats=2)
    assert (plants.shape, actions.shape) == ((3, 2, 200), (6, 200))
    assert (plants[..., :100] == plants[..., 100:]).all()
    M, mu = plants[0, :, :100]
    assert np.histogram(M, bins=100, range=(0.35, 0.75))[0].tolist() == [1] * 100
    assert np.histogram(np.log(mu), bins=100, range=np.log((0.005, 0.3)))[0].tolist() == [1] * 100
    assert (actions[:, ::2] == 0.0).all() and (actions[:, 1::2] != 0.0).all()
    batch = make_batch(8)
    run_candidates(batch, np.tile(known_parameters(), (8, 1)), plants[..., :8], actions[:, :8])
    np.testing.assert_array_equal(batch.simulation.rows(Row.M, Row.mu + 1), plants[-1, :, :8])


def test_a_law_search_writes_better_parameters_only(monkeypatch, tmp_path):
    pytest.importorskip("cma")
    path = tmp_path / "gait.json"
    sizes = {"POPULATION": 4, "PLANTS": 4, "TEST_EPISODES": 4, "TRIAL": 0.4, "HORIZON": 0.4, "TEST_INTERVAL": 2}
    for name, value in {**sizes, "FILE": path}.items():
        monkeypatch.setattr(law_search, name, value)
    assert command.main(["--law", "3"]) == 0
    content = json.loads(path.read_text(encoding="utf-8"))
    assert tuple(content["parameters"]) == PARAMETERS
    assert content["found"]["command"] == "python -m baselines.gaits --law 3 --seed 0"
    # The same seed finds the same parameters. They are no better, so the file stays the same.
    assert command.main(["--law", "3"]) == 0
    assert json.loads(path.read_text(encoding="utf-8")) == content
