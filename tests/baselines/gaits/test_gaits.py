"""The gaits: archive, families, policies, and the search for the parameters of the gait law."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from baselines.archive import PLANTS
from baselines.gaits import FOLDER, law_search
from baselines.gaits import __main__ as command
from baselines.gaits import archive as module
from baselines.gaits.archive import Archive, GaitMap, check, encode_gaits, known_gaits, load_archive, pareto_front
from baselines.gaits.families import FAMILIES, GAIT_DT, actions, encode
from baselines.gaits.law_search import draw_episodes, make_batch, run_candidates
from baselines.laws.gait import PARAMETERS, known_parameters
from baselines.policies import SCRIPTED
from capsule_gym.layout import Row
from capsule_gym.parameters import NOMINAL


def test_committed_gaits_cover_the_grid(capsys):
    fastest = known_gaits().fastest()
    assert list(fastest) == list(PLANTS)
    assert fastest[NOMINAL.M, NOMINAL.mu].mean_speed > 18.0
    assert all(gait.sensitivity < 0.01 for gait in known_gaits().everything())
    speeds, costs = ([getattr(g, name) for g in pareto_front()] for name in ("mean_speed", "cost_of_transport"))
    assert speeds == sorted(set(speeds)) and costs == sorted(set(costs)) and len(speeds) >= 8
    assert speeds[-1] == fastest[NOMINAL.M, NOMINAL.mu].mean_speed
    assert command.main([]) == 0
    for gait, line in zip(fastest.values(), capsys.readouterr().out.splitlines()[2:], strict=True):
        assert line.split()[2:4] == [gait.family, f"{gait.mean_speed:.2f}"]


def test_check_simulates_the_gaits_on_file_and_names_what_differs():
    known = known_gaits()
    some = [known.of_plant(0.35, 0.5)[0], known.of_plant(1.0, 0.005)[-1], known.of_plant(0.5, 0.01, tolerant=True)[0]]
    wrong = replace(known.front[0], mean_speed=1.1 * known.front[0].mean_speed)
    (line,) = check(Archive({gait.key: gait for gait in some}, (known.front[0], wrong)))
    assert line.startswith(f"{known.front[0].family} at M=0.5, mu=0.01: mean_speed is ")


def test_a_malformed_archive_raises_an_error(tmp_path):
    assert load_archive(tmp_path) == Archive()
    shutil.copy(FOLDER / "archive.json", tmp_path)
    path = tmp_path / "archive.json"
    path.write_text(path.read_text().replace("harmonics", "hop"))
    message = "must hold an archive for `python -m baselines.gaits`, got KeyError: 'hop'"
    with pytest.raises(ValueError, match=message):
        load_archive(tmp_path)


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_computes_every_environment_by_itself(name):
    family, rng = FAMILIES[name], np.random.default_rng(1)
    parameters = rng.uniform(0.05, 0.5, (5, family.parameters))
    gaits = encode(name, parameters)
    observations = rng.uniform(-1.0, 1.0, (5, 5)).astype(np.float32)
    together = actions(gaits, 0.37, observations)
    assert (together.shape, together.dtype) == ((5, 1), np.float32)
    for own, gait, observation, action in zip(parameters, gaits, observations, together, strict=True):
        assert actions(gait[None], 0.37, observation[None]) == action
        state = observation[:3, None].astype(np.float64)
        assert action == np.clip(family.torque(own[:, None], 0.37, state), -1.0, 1.0).astype(np.float32)


def test_gait_oracle_follows_a_jump_of_the_plant(monkeypatch):
    one, other = (
        next(g for g in known_gaits().everything() if g.family == name) for name in ("harmonics", "bang-bang")
    )
    gait_map = GaitMap((0.5, 1.0), (0.01, 0.1), (one, other), ((0, 0), (1, 0)))
    assert gait_map.find(np.array([0.2, 0.9, 3.0]), np.array([0.0, 0.01, 0.9])) == [one, other, one]
    monkeypatch.setattr(module, "known_gaits", lambda: Archive(oracle=gait_map))
    act = SCRIPTED["gait-oracle"].start([0])
    observation = np.array([[-1.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.01]], np.float32)
    before = act(observation)
    observation[0, 5] = 1.0
    after = act(observation)
    assert before == actions(encode_gaits([one]), 0.0, observation)
    assert after == actions(encode_gaits([other]), GAIT_DT, observation) != before


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


def test_failures_score_below_everything_and_better_late():
    metrics = {"mean_speed": [5.0, 50.0, 50.0], "failed": [0.0, 1.0, 1.0], "duration": [10.0, 9.0, 1.0]}
    scores = law_search.score({name: np.array(values) for name, values in metrics.items()}, 10.0)
    assert scores[0] == 5.0 > 0.0 > scores[1] > scores[2]


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
