import json

import numpy as np
import pytest

from baselines import gaits
from baselines.gaits import draw_episodes, make_batch, run_candidates
from baselines.laws.gait import PARAMETERS, known_parameters
from capsule_gym.layout import Row


def test_episodes_draw_plants_evenly_and_disturb_every_second_one():
    plants, actions = draw_episodes(np.random.default_rng(0), 100, 0.6, repeats=2)
    assert (plants.shape, actions.shape) == ((3, 2, 200), (6, 200))
    assert (plants[..., :100] == plants[..., 100:]).all()
    M, mu = plants[0, :, :100]
    assert np.histogram(M, bins=100, range=(0.35, 0.75))[0].tolist() == [1] * 100
    assert np.histogram(np.log(mu), bins=100, range=np.log((0.005, 0.3)))[0].tolist() == [1] * 100
    assert (actions[:, ::2] == 0.0).all() and (actions[:, 1::2] != 0.0).all() and (np.abs(actions) <= 1.0).all()
    batch = make_batch(8)
    run_candidates(batch, np.tile(known_parameters(), (8, 1)), plants[..., :8], actions[:, :8])
    np.testing.assert_array_equal(batch.simulation.rows(Row.M, Row.mu + 1), plants[-1, :, :8])


def test_failures_score_below_everything_and_better_late():
    metrics = {"mean_speed": [5.0, 50.0, 50.0], "failed": [0.0, 1.0, 1.0], "duration": [10.0, 9.0, 1.0]}
    scores = gaits.score({name: np.array(values) for name, values in metrics.items()}, 10.0)
    assert scores[0] == 5.0 > 0.0 > scores[1] > scores[2]


def test_a_gaits_writes_better_parameters_only(monkeypatch, tmp_path):
    pytest.importorskip("cma")
    path = tmp_path / "gait.json"
    sizes = {"POPULATION": 4, "PLANTS": 4, "TEST_EPISODES": 4, "TRIAL": 0.4, "HORIZON": 0.4, "TEST_INTERVAL": 2}
    for name, value in {**sizes, "FILE": path}.items():
        monkeypatch.setattr(gaits, name, value)
    assert gaits.main(["--generations", "3"]) == 0
    content = json.loads(path.read_text(encoding="utf-8"))
    assert tuple(content["parameters"]) == PARAMETERS
    assert content["found"]["command"] == "python -m baselines.gaits --generations 3 --seed 0"
    # The same seed finds the same parameters. They are no better, so the file stays the same.
    assert gaits.main(["--generations", "3"]) == 0
    assert json.loads(path.read_text(encoding="utf-8")) == content
