"""The gaits: archive, families, policies and the upper bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baselines.archive import PLANTS
from baselines.gaits import policy
from baselines.gaits.archive import Archive, Gait, GaitMap, known_gaits, load_archive, pareto_front
from baselines.gaits.bound import phase_plane_envelope, speed_bound
from baselines.gaits.families import FAMILIES, GAIT_DT, actions, encode
from baselines.gaits.simulation import check, simulate
from baselines.policies import SCRIPTED
from capsule_gym import Capsule, CapsuleVectorEnv
from capsule_gym.parameters import NOMINAL


def make_gait(mean_speed=10.0, cost_of_transport=3.0, M=0.5, mu=0.01, family="harmonics", worst_speed=None):
    """A gait with invented numbers."""
    return Gait(
        M=M,
        mu=mu,
        family=family,
        parameters=FAMILIES[family].start,
        mean_speed=mean_speed,
        cost_of_transport=cost_of_transport,
        sensitivity=1e-3,
        seed=(0, 0),
        evaluations=1,
        seconds=1.0,
        command="test",
        worst_speed=worst_speed,
    )


# Archive


def test_committed_gaits_cover_the_grid_below_the_bound():
    fastest = known_gaits().fastest()
    assert list(fastest) == list(PLANTS)
    assert fastest[NOMINAL.M, NOMINAL.mu].mean_speed > 18.0
    assert all(0.0 < gait.mean_speed < speed_bound(*plant) for plant, gait in fastest.items())
    assert all(gait.sensitivity < 0.01 for gait in known_gaits().everything())
    assert len(pareto_front()) >= 8
    speeds, costs = ([getattr(g, name) for g in pareto_front()] for name in ("mean_speed", "cost_of_transport"))
    assert speeds == sorted(set(speeds)) and costs == sorted(set(costs))
    assert speeds[-1] == fastest[NOMINAL.M, NOMINAL.mu].mean_speed


def test_check_simulates_the_gaits_on_file_and_names_what_differs():
    known = known_gaits()
    some = [known.of_plant(0.35, 0.5)[0], known.of_plant(1.0, 0.005)[-1], known.of_plant(0.5, 0.01, tolerant=True)[0]]
    archive = Archive({gait.key: gait for gait in some}, front=[known.front[0]])
    assert check(archive) == []
    archive.front = [replace(known.front[0], mean_speed=1.1 * known.front[0].mean_speed)]
    (line,) = check(archive)
    assert line.startswith(f"{known.front[0].family} at M=0.5, mu=0.01: mean_speed is ")


def test_an_archive_survives_its_file(tmp_path):
    assert load_archive(tmp_path) == Archive()
    tolerant, fastest = make_gait(worst_speed=8.0), make_gait(M=1.0)
    oracle = GaitMap((0.5, 1.0), (0.1,), ((tolerant,), (fastest,)))
    archive = Archive({gait.key: gait for gait in (tolerant, fastest)}, [make_gait()], oracle, 3, 40, 1.5)
    archive.save(tmp_path)
    assert load_archive(tmp_path) == archive


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("harmonics", "hop"), "families harmonics, bang-bang, phase-space .* got 'hop'"),
        (lambda text: "[1, 2]", "TypeError"),
        (lambda text: text[: len(text) // 2], "JSONDecodeError"),
        (lambda text: text.replace('"cells": [[0]]', '"cells": [[7]]'), "IndexError"),
    ],
)
def test_a_malformed_archive_raises_an_error(tmp_path, change, message):
    gait = make_gait()
    Archive({gait.key: gait}, oracle=GaitMap((0.5,), (0.1,), ((gait,),))).save(tmp_path)
    path = tmp_path / "archive.json"
    path.write_text(change(path.read_text()))
    with pytest.raises(
        ValueError, match=f"must hold an archive written by `python -m baselines.gaits`, got .*{message}"
    ):
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
    # In one interval of speed the cheaper gait stays.
    offers = {
        (10.2, 3.0): 1,
        (9.0, 3.0): 0,
        (-1.0, 0.1): 0,
        (9.0, 2.0): 1,
        (10.3, 3.1): 0,
        (10.1, 2.9): 1,
        (12.0, 2.8): 1,
    }
    assert [archive.offer_front(make_gait(*offer)) for offer in offers] == [bool(kept) for kept in offers.values()]
    assert [(g.mean_speed, g.cost_of_transport) for g in archive.front] == [(9.0, 2.0), (12.0, 2.8)]


# Families and policies


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_computes_every_environment_by_itself(name):
    family, rng = FAMILIES[name], np.random.default_rng(1)
    parameters = np.array(family.start) + 0.1 * np.array(family.units) * rng.standard_normal((5, len(family.start)))
    gaits = encode([name] * 5, parameters.tolist())
    observations = rng.uniform(-1.0, 1.0, (5, 5)).astype(np.float32)
    together = actions(gaits, 0.37, observations)
    assert (together.shape, together.dtype) == ((5, 1), np.float32)
    for own, gait, observation, action in zip(parameters, gaits, observations, together, strict=True):
        assert actions(gait[None], 0.37, observation[None]) == action
        torque = family.torque(tuple(own.tolist()), 0.37, *observation[:3].tolist())
        assert action == np.float32(min(max(torque, -1.0), 1.0))


def test_gait_nominal_is_the_tolerant_gait_on_every_plant():
    gait = policy.tolerant_nominal()
    assert gait.worst_speed <= gait.mean_speed
    env = CapsuleVectorEnv(2, randomization="none", autoreset_mode="DISABLED", **SCRIPTED["gait-nominal"].env_kwargs)
    observations, _ = env.reset(seed=0, options={"M": np.array([0.5, 0.55])})
    act = SCRIPTED["gait-nominal"].start(range(2))
    for _ in range(300):
        observations, *_ = env.step(act(observations))
    parameters = np.tile(gait.parameters, (2, 1))
    expected = simulate(gait.family, parameters, np.array([0.5, 0.55]), np.full(2, 0.01), horizon=300 * GAIT_DT)
    assert env.episode_metrics()["mean_speed"].tolist() == expected["mean_speed"][0].tolist()


def test_gait_oracle_follows_a_jump_of_the_plant(monkeypatch):
    one, other = make_gait(), make_gait(M=1.0, family="bang-bang")
    gait_map = GaitMap((0.5, 1.0), (0.01, 0.1), ((one, one), (other, one)))
    assert gait_map.find(np.array([0.2, 0.9, 3.0]), np.array([0.0, 0.01, 0.9])) == [one, other, one]
    monkeypatch.setattr(policy, "oracle_map", lambda: gait_map)
    act = SCRIPTED["gait-oracle"].start([0])
    observation = np.array([[-1.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.01]], np.float32)
    before = act(observation)
    observation[0, 5] = 1.0
    after = act(observation)
    assert before == actions(policy.encode_gaits([one]), 0.0, observation)
    assert after == actions(policy.encode_gaits([other]), GAIT_DT, observation) != before


# The bound


def test_the_bound_grows_with_the_torque_and_falls_with_the_mass():
    assert speed_bound(0.5, 0.1, 0.5) < speed_bound(0.5, 0.1, 1.0) < speed_bound(0.5, 0.1, 1.5)
    assert speed_bound(0.5, 0.1) > speed_bound(0.75, 0.1)
    # With little friction the centre of mass accelerates slowly.
    assert speed_bound(0.5, 0.001) < 0.5 * speed_bound(0.5, 0.1)
    assert speed_bound(0.5, 0.01, horizon=1.0) < speed_bound(0.5, 0.01)
    with pytest.raises(ValueError, match=r"torque_limit must be a finite number > 0 \(N m\), got 0"):
        speed_bound(0.5, 0.1, 0)
    with pytest.raises(ValueError, match="capsule must have normal_force='newton'"):
        speed_bound(0.5, 0.1, capsule=Capsule(normal_force="paper"))


@pytest.mark.parametrize("mu", [0.01, 0.3])
def test_the_steps_of_the_proof_hold_on_hard_driven_capsules(mu):
    count = 64
    env = CapsuleVectorEnv(count, randomization="none", autoreset_mode="DISABLED", control_dt=GAIT_DT)
    observations, info = env.reset(seed=0, options={"mu": mu})
    envelope = phase_plane_envelope(NOMINAL.M, mu)
    arm = NOMINAL.m * NOMINAL.l / (NOMINAL.M + NOMINAL.m)
    fastest = arm * (np.cos(envelope.theta) * envelope.theta_dot).max()
    threshold = np.random.default_rng(0).uniform(-1.0, 1.0, count)
    for _ in range(200):
        # A torque along the motion adds energy; every capsule reverses it elsewhere.
        push = np.where(np.abs(observations[:, 0]) < np.abs(threshold), 1.0, -1.0)
        torque = np.where(observations[:, 1] >= 0.0, push, -push)
        observations, _, terminated, _, info = env.step(torque[:, None])
        theta, theta_dot, _, x_dot = info["state"][~terminated].T
        mirrored = np.where(theta_dot >= 0.0, theta, -theta)
        assert (np.abs(theta_dot) <= np.interp(mirrored, envelope.theta, envelope.theta_dot) + 1e-6).all()
        assert (x_dot - arm * np.cos(theta) * theta_dot <= fastest).all()
    env.close()
