"""The search of the gait law: its draws, its judgement, and that a file is replaced by better parameters only."""

from __future__ import annotations

import json

import numpy as np
import pytest

from baselines.gaits import law_trials
from baselines.gaits.law_search import main
from baselines.gaits.law_trials import Search, Trials, draw_episodes, draw_plants
from baselines.laws.gait import PARAMETERS, gait, known_parameters
from capsule_gym import CapsuleVectorEnv
from capsule_gym.layout import Row


@pytest.fixture
def quick(monkeypatch):
    """A search of seconds: few candidates, few plants, short episodes."""
    pytest.importorskip("cma")
    sizes = {"POPULATION": 4, "PLANTS": 4, "LOOK_EPISODES": 4, "TRIAL": 0.4, "HORIZON": 0.4, "LOOK_EVERY": 2}
    for name, value in sizes.items():
        monkeypatch.setattr(law_trials, name, value)


def test_draws_lie_evenly_over_wide():
    M, mu = draw_plants(np.random.default_rng(0), 100)
    assert np.histogram(M, bins=100, range=(0.35, 0.75))[0].tolist() == [1] * 100
    assert np.histogram(np.log(mu), bins=100, range=np.log((0.005, 0.3)))[0].tolist() == [1] * 100


def test_a_candidate_moves_as_the_law_with_its_parameters():
    plants = np.array([[0.5, 0.4], [0.01, 0.2]])
    parameters = np.tile(known_parameters(), (2, 1))
    found = Trials(2, 1).run(parameters, plants[None], np.zeros((20, 2)))
    env = CapsuleVectorEnv(2, controller=gait(), control_dt=0.1, autoreset_mode="DISABLED")
    env.reset(seed=0, options={"M": plants[0], "mu": plants[1]})
    for _ in range(20):
        env.step(np.zeros((2, 1), np.float32))
    # But for the first millisecond, in which a candidate has no torque.
    np.testing.assert_allclose(found["mean_speed"], env.episode_metrics()["mean_speed"], rtol=0.05)


def test_the_plants_of_an_episode_follow_each_other_in_equal_parts():
    plants, actions = draw_episodes(np.random.default_rng(0), 4, 0.6, repeats=2)
    assert (plants.shape, actions.shape) == ((3, 2, 8), (6, 8))
    assert (plants[..., :4] == plants[..., 4:]).all()
    assert (actions[:, ::2] == 0.0).all() and (actions[:, 1::2] != 0.0).all()
    trials = Trials(8, 1)
    trials.run(np.tile(known_parameters(), (8, 1)), plants, actions)
    np.testing.assert_array_equal(trials.env.simulation.rows(Row.M, Row.mu + 1), plants[-1])


def test_a_search_is_that_of_its_seed(quick):
    def course(seed):
        search = Search(seed, 1)
        return [search.advance() for _ in range(3)]

    assert course(1) == course(1) != course(2)


def test_a_search_writes_what_is_better_and_nothing_else(quick, tmp_path, capsys):
    path = tmp_path / "gait.json"
    arguments = ["--generations", "3", "--threads", "1", "--file", str(path)]
    assert main(arguments) == 0
    content = json.loads(path.read_text(encoding="utf-8"))
    assert tuple(content["parameters"]) == PARAMETERS
    assert content["found"]["command"] == "python -m baselines.gaits.law_search --seed 0 --generations 3"
    assert f"wrote {path}" in capsys.readouterr().out
    assert main(arguments) == 0
    assert "stays as it is" in capsys.readouterr().out
    assert json.loads(path.read_text(encoding="utf-8")) == content


def test_an_interrupted_search_keeps_the_best_so_far(quick, tmp_path, monkeypatch):
    advance = Search.advance

    def interrupted(search):
        if search.generation == 2:
            raise KeyboardInterrupt
        return advance(search)

    monkeypatch.setattr(Search, "advance", interrupted)
    path = tmp_path / "gait.json"
    assert main(["--generations", "9", "--threads", "1", "--file", str(path)]) == 130
    assert json.loads(path.read_text(encoding="utf-8"))["found"]["generation"] == 2


def test_a_search_without_threads_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["--threads", "0"])
    assert "--threads must be at least 1, got 0" in capsys.readouterr().err
