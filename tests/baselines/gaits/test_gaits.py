"""The gaits: archive, families and policies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baselines.archive import PLANTS
from baselines.gaits import archive as module
from baselines.gaits.archive import Archive, Gait, GaitMap, encode_gaits, known_gaits, load_archive, pareto_front
from baselines.gaits.families import FAMILIES, GAIT_DT, actions, encode
from baselines.gaits.search import check
from baselines.policies import SCRIPTED
from capsule_gym.parameters import NOMINAL


def make_gait(mean_speed=10.0, cost_of_transport=3.0, M=0.5, mu=0.01, family="harmonics", worst_speed=None):
    """A gait with invented numbers."""
    numbers = {"mean_speed": mean_speed, "cost_of_transport": cost_of_transport, "worst_speed": worst_speed}
    return Gait(M=M, mu=mu, family=family, parameters=FAMILIES[family].start, sensitivity=1e-3, **numbers)


def test_committed_gaits_cover_the_grid():
    fastest = known_gaits().fastest()
    assert list(fastest) == list(PLANTS)
    assert fastest[NOMINAL.M, NOMINAL.mu].mean_speed > 18.0
    assert all(gait.sensitivity < 0.01 for gait in known_gaits().everything())
    speeds, costs = ([getattr(g, name) for g in pareto_front()] for name in ("mean_speed", "cost_of_transport"))
    assert speeds == sorted(set(speeds)) and costs == sorted(set(costs)) and len(speeds) >= 8
    assert speeds[-1] == fastest[NOMINAL.M, NOMINAL.mu].mean_speed


def test_check_simulates_the_gaits_on_file_and_names_what_differs():
    known = known_gaits()
    some = [known.of_plant(0.35, 0.5)[0], known.of_plant(1.0, 0.005)[-1], known.of_plant(0.5, 0.01, tolerant=True)[0]]
    wrong = replace(known.front[0], mean_speed=1.1 * known.front[0].mean_speed)
    (line,) = check(Archive({gait.key: gait for gait in some}, front=[known.front[0], wrong]))
    assert line.startswith(f"{known.front[0].family} at M=0.5, mu=0.01: mean_speed is ")


def test_an_archive_survives_its_file_and_a_malformed_one_raises_an_error(tmp_path):
    assert load_archive(tmp_path) == Archive()
    tolerant, fastest = make_gait(worst_speed=8.0), make_gait(M=1.0)
    oracle = GaitMap((0.5, 1.0), (0.1,), (tolerant, fastest), ((0,), (1,)))
    archive = Archive({gait.key: gait for gait in (tolerant, fastest)}, [make_gait()], oracle, 3)
    archive.save(tmp_path)
    assert load_archive(tmp_path) == archive
    path = tmp_path / "archive.json"
    path.write_text(path.read_text().replace("harmonics", "hop"))
    message = "must hold an archive written by `python -m baselines.gaits`, got KeyError: 'hop'"
    with pytest.raises(ValueError, match=message):
        load_archive(tmp_path)


def test_an_entry_is_replaced_by_better_ones_only():
    archive = Archive()
    assert not archive.offer(make_gait(0.0))
    assert [archive.offer(make_gait(speed)) for speed in (10.0, 10.0, 9.0, 11.0)] == [True, False, False, True]
    assert archive.offer(make_gait(8.0, family="bang-bang"))
    assert [g.mean_speed for g in archive.of_plant(0.5, 0.01)] == [11.0, 8.0]
    # Tolerant gaits are compared by their worst speed.
    offers = [(10.0, 7.0), (20.0, 6.0), (9.0, 8.0), (20.0, -1.5)]
    assert [archive.offer(make_gait(a, worst_speed=b)) for a, b in offers] == [True, False, True, False]
    assert [g.mean_speed for g in archive.of_plant(0.5, 0.01, tolerant=True)] == [9.0]
    assert archive.fastest()[0.5, 0.01].mean_speed == 11.0


def test_the_front_keeps_what_nothing_dominates():
    archive = Archive()
    offers = [(10.2, 3.0), (9.0, 3.0), (-1.0, 0.1), (9.0, 2.0), (10.1, 3.0), (12.0, 2.8)]
    kept = [True, False, False, True, False, True]
    assert [archive.offer_front(make_gait(*offer)) for offer in offers] == kept
    assert [(g.mean_speed, g.cost_of_transport) for g in archive.front] == [(9.0, 2.0), (12.0, 2.8)]


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_computes_every_environment_by_itself(name):
    family, rng = FAMILIES[name], np.random.default_rng(1)
    parameters = np.array(family.start) + 0.1 * np.array(family.units) * rng.standard_normal((5, len(family.start)))
    gaits = encode(name, parameters)
    observations = rng.uniform(-1.0, 1.0, (5, 5)).astype(np.float32)
    together = actions(gaits, 0.37, observations)
    assert (together.shape, together.dtype) == ((5, 1), np.float32)
    for own, gait, observation, action in zip(parameters, gaits, observations, together, strict=True):
        assert actions(gait[None], 0.37, observation[None]) == action
        state = observation[:3, None].astype(np.float64)
        assert action == np.clip(family.torque(own[:, None], 0.37, state), -1.0, 1.0).astype(np.float32)


def test_gait_oracle_follows_a_jump_of_the_plant(monkeypatch):
    one, other = make_gait(), make_gait(M=1.0, family="bang-bang")
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
