import json
import math
from dataclasses import replace

import numpy as np
import pytest

from baselines.gaits import archive as gaits
from baselines.gaits import performance
from baselines.gaits.archive import GRID_M, GRID_MU, PLANTS, Archive, best_known_speed, known_gaits
from baselines.gaits.bound import phase_plane_envelope, speed_bound
from baselines.gaits.families import FAMILIES, GAIT_DT, actions, pack
from baselines.gaits.performance import Performance
from baselines.gaits.simulation import recheck, simulate
from baselines.policies import SCRIPTED
from capsule_gym import Capsule, CapsuleVectorEnv
from capsule_gym.task import HORIZON, START_THETA
from tests.baselines.gaits.fakes import some_gait

NOMINAL = Capsule()


# The data


def test_the_data_holds_every_plant():
    archive = known_gaits()
    assert list(archive.table()) == list(PLANTS)
    assert len(PLANTS) == len(GRID_M) * len(GRID_MU) == 28
    assert archive.seconds > 0.0
    assert archive.evaluations > 0
    for gait in archive.everything():
        assert len(gait.parameters) == len(FAMILIES[gait.family].names)
        assert np.isfinite(gait.parameters).all()
        assert 0.0 < gait.mean_speed < 100.0
        assert 0.0 < gait.cost_of_transport < 100.0
        assert gait.sensitivity < 0.01
        assert gait.command.startswith("python -m baselines.gaits")


def test_the_nominal_plant_is_well_above_the_prototype():
    assert best_known_speed(NOMINAL.M, NOMINAL.mu) > 18.0


def test_every_gait_lies_below_the_bound():
    for (M, mu), gait in known_gaits().table().items():
        assert gait.mean_speed < speed_bound(M, mu)


def test_the_front_has_no_dominated_gait():
    front = gaits.pareto_front()
    assert len(front) >= 8
    speeds, transports = ([getattr(g, name) for g in front] for name in ("mean_speed", "cost_of_transport"))
    assert speeds == sorted(set(speeds))
    assert transports == sorted(set(transports))
    assert speeds[-1] == best_known_speed(NOMINAL.M, NOMINAL.mu)


def test_gaits_do_what_the_data_says():
    table = known_gaits().table()
    chosen = [table[plant] for plant in ((0.35, 0.5), (0.5, 0.01), (0.75, 0.1), (1.0, 0.005))]
    chosen += [next(g for g in known_gaits().gaits if g.family == name) for name in FAMILIES]
    chosen += [known_gaits().front[0], known_gaits().tolerant[0]]
    speeds, transports = recheck(chosen)
    # The search lets a change of one part in 1000 move a speed by 1 %; rounding is far below that.
    np.testing.assert_allclose(speeds, [g.mean_speed for g in chosen], rtol=0.01)
    np.testing.assert_allclose(transports, [g.cost_of_transport for g in chosen], rtol=0.01)


def test_best_known_speed_interpolates_in_the_logarithm():
    table = known_gaits().table()
    assert best_known_speed(0.75, 0.1) == table[0.75, 0.1].mean_speed
    between = 0.5 * (table[0.75, 0.1].mean_speed + table[0.75, 0.2].mean_speed)
    assert best_known_speed(0.75, math.sqrt(0.02)) == pytest.approx(between)
    middle = 0.5 * (table[0.5, 0.1].mean_speed + table[0.75, 0.1].mean_speed)
    assert best_known_speed(0.625, 0.1) == pytest.approx(middle)
    with pytest.raises(ValueError, match=r"mu in \[0.005, 0.5\], got M=0.5, mu=0.6"):
        best_known_speed(0.5, 0.6)


def test_malformed_data_is_named(tmp_path):
    assert gaits.load_archive(tmp_path).gaits == []
    archive = Archive(gaits=[some_gait()], front=[some_gait()], tolerant=[some_gait(worst_speed=8.0)])
    (tmp_path / "gaits.json").write_text(archive.to_json())
    assert gaits.load_archive(tmp_path) == archive
    (tmp_path / "gaits.json").write_text(archive.to_json().replace("harmonics", "hop"))
    with pytest.raises(ValueError, match=r"must hold families harmonics, bang-bang, phase-space .* got 'hop'"):
        gaits.load_archive(tmp_path)
    (tmp_path / "gaits.json").write_text("{}")
    with pytest.raises(ValueError, match="must be what the gait search writes, got KeyError"):
        gaits.load_archive(tmp_path)


# The bound


def test_the_bound_grows_with_the_torque_and_falls_with_the_mass():
    assert speed_bound(0.5, 0.1, 0.5) < speed_bound(0.5, 0.1, 1.0) < speed_bound(0.5, 0.1, 1.5)
    assert speed_bound(0.5, 0.1) > speed_bound(0.75, 0.1)
    # On a smooth floor the centre of mass needs its time.
    assert speed_bound(0.5, 0.001) < 0.5 * speed_bound(0.5, 0.1)
    assert speed_bound(0.5, 0.01, horizon=1.0) < speed_bound(0.5, 0.01)
    with pytest.raises(ValueError, match=r"torque_limit must be a finite number > 0 \(N m\), got 0"):
        speed_bound(0.5, 0.1, 0)
    with pytest.raises(ValueError, match="capsule must have normal_force='newton'"):
        speed_bound(0.5, 0.1, capsule=Capsule(normal_force="paper"))


@pytest.mark.parametrize("mu", [0.01, 0.3])
def test_the_steps_of_the_proof_hold_on_hard_driven_capsules(mu):
    count = 64
    rng = np.random.default_rng(0)
    env = CapsuleVectorEnv(count, randomization="none", autoreset_mode="DISABLED", control_dt=GAIT_DT)
    observations, info = env.reset(seed=0, options={"mu": mu})
    envelope = phase_plane_envelope(NOMINAL.M, mu)
    arm = NOMINAL.m * NOMINAL.l / (NOMINAL.M + NOMINAL.m)
    fastest = arm * (np.cos(envelope.theta) * envelope.theta_dot).max()
    threshold = rng.uniform(-1.0, 1.0, count)
    for _ in range(200):
        # Energy goes in wherever the torque follows the motion; every capsule turns it around somewhere else.
        push = np.where(np.abs(observations[:, 0]) < np.abs(threshold), 1.0, -1.0)
        torque = np.where(observations[:, 1] >= 0.0, push, -push)
        observations, _, terminated, _, info = env.step(torque[:, None])
        going = ~terminated
        theta, theta_dot, _, x_dot = info["state"][going].T
        mirrored = np.where(theta_dot >= 0.0, theta, -theta)
        assert (np.abs(theta_dot) <= np.interp(mirrored, envelope.theta, envelope.theta_dot) + 1e-6).all()
        assert (x_dot - arm * np.cos(theta) * theta_dot <= fastest).all()
    env.close()


# Families and policies


@pytest.mark.parametrize("family", FAMILIES.values(), ids=lambda family: family.name)
def test_a_family_computes_every_environment_by_itself(family):
    rng = np.random.default_rng(1)
    parameters = np.array(family.start) + 0.1 * np.array(family.units) * rng.standard_normal((5, len(family.start)))
    gaits = pack([family.name] * 5, parameters.tolist())
    observations = rng.uniform(-1.0, 1.0, (5, 5)).astype(np.float32)
    together = actions(gaits, 0.37, observations)
    assert (together.shape, together.dtype) == ((5, 1), np.float32)
    for own, gait, observation, action in zip(parameters, gaits, observations, together, strict=True):
        assert actions(gait[None], 0.37, observation[None]) == action
        torque = family.torque(tuple(own.tolist()), 0.37, *observation[:3].tolist())
        assert action == np.float32(min(max(torque, -1.0), 1.0))


def test_clocks_run_in_periods():
    rest = (0.0, 0.0, 0.0)
    harmonics = (0.65, 0.01, *(0.1 * k for k in range(8)), 0.0, 0.0, 0.0)
    square = (0.2, 0.1, 0.15, 0.2, 0.0, 0.0, 0.0, 0.0)
    for name, parameters in (("harmonics", harmonics), ("bang-bang", square)):
        torque = [FAMILIES[name].torque(parameters, time, *rest) for time in (0.105, 0.105 + 0.65, 0.255)]
        assert torque[0] == pytest.approx(torque[1])
        assert torque[0] != pytest.approx(torque[2])
    # A step that holds a switch gets the mean of both torques.
    assert FAMILIES["bang-bang"].torque(square, 0.1925, *rest) == pytest.approx(0.5)


@pytest.mark.parametrize("name", ["gait-nominal", "gait-oracle"])
def test_gait_policies_are_deterministic(name):
    policy = SCRIPTED[name]
    kwargs = {"randomization": "none", "autoreset_mode": "DISABLED", **policy.env_kwargs}
    M, mu = np.array([0.4, 0.7, 0.5]), np.array([0.006, 0.25, 0.01])

    def states(rows):
        env = CapsuleVectorEnv(len(rows), **kwargs)
        observations, _ = env.reset(seed=0, options={"M": M[rows], "mu": mu[rows]})
        act = policy.start(range(len(rows)))
        for _ in range(300):
            observations, _, _, _, info = env.step(act(observations))
        env.close()
        return info["state"]

    first = states([0, 1, 2])
    assert (first == states([0, 1, 2])).all()
    np.testing.assert_allclose(states([2]), first[2:], rtol=1e-3, atol=1e-6)


def test_the_nominal_policy_is_the_tolerant_gait():
    policy = SCRIPTED["gait-nominal"]
    tolerant = [g for g in known_gaits().tolerant if (g.M, g.mu) == (NOMINAL.M, NOMINAL.mu)]
    gait = max(tolerant, key=lambda g: g.worst_speed)
    assert gait.worst_speed <= gait.mean_speed
    env = CapsuleVectorEnv(1, randomization="none", autoreset_mode="DISABLED", **policy.env_kwargs)
    observations, _ = env.reset(seed=0)
    act = policy.start([0])
    for _ in range(round(3.0 / GAIT_DT)):
        observations, *_ = env.step(act(observations))
    speed = env.episode_metrics()["mean_speed"][0]
    env.close()
    family = FAMILIES[gait.family]
    expected = simulate(family, np.array([gait.parameters]), np.array([0.5]), np.array([0.01]), horizon=3.0)
    assert speed == expected["mean_speed"][0]


def test_the_oracle_follows_a_jump_of_the_plant(monkeypatch):
    slow, fast = some_gait(), replace(some_gait(), M=1.0, family="bang-bang", parameters=FAMILIES["bang-bang"].start)
    choice = performance.Choice((0.5, 1.0), (0.01, 0.1), ((slow, slow), (fast, slow)))
    assert choice.find(np.array([0.2, 0.9, 3.0]), np.array([0.0, 0.01, 0.9])) == [slow, fast, slow]
    monkeypatch.setattr(performance, "known_choice", lambda: choice)
    act = SCRIPTED["gait-oracle"].start([0])
    observation = np.array([[-1.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.01]], np.float32)
    before = act(observation)
    observation[0, 5] = 1.0
    after = act(observation)
    expected = Performance([fast])
    expected.step = 1
    assert (after == expected.act(observation)).all()
    assert before != after


def test_the_oracle_names_a_malformed_map(monkeypatch, tmp_path):
    assert performance.known_choice().gaits
    known = known_gaits()
    (tmp_path / "oracle.json").write_text(json.dumps({"M": [0.5], "mu": [0.1], "gaits": [["hop", 1, 2, False]]}))
    monkeypatch.setattr(performance, "FOLDER", tmp_path)
    monkeypatch.setattr(performance, "known_gaits", lambda: known)
    performance.known_choice.cache_clear()
    with pytest.raises(ValueError, match=r"must be what `python -m baselines.gaits --oracle` writes, got KeyErr"):
        performance.known_choice()


# The archive


def test_an_entry_is_replaced_by_better_ones_only():
    archive = Archive()
    assert not archive.offer(some_gait(0.0))
    assert archive.offer(some_gait(10.0))
    assert not archive.offer(some_gait(10.0))
    assert not archive.offer(some_gait(9.0))
    assert archive.offer(some_gait(8.0, family="bang-bang"))
    assert archive.offer(some_gait(11.0))
    assert [g.mean_speed for g in archive.of_plant(0.5, 0.01)] == [11.0, 8.0]
    assert archive.table()[0.5, 0.01].mean_speed == 11.0


def test_tolerant_gaits_are_ordered_by_their_worst_run():
    archive = Archive()
    assert archive.offer_tolerant(some_gait(10.0, worst_speed=7.0))
    assert not archive.offer_tolerant(some_gait(20.0, worst_speed=6.0))
    assert not archive.offer_tolerant(some_gait(20.0, M=1.0, worst_speed=-1.5))
    assert archive.offer_tolerant(some_gait(9.0, worst_speed=8.0))
    assert archive.library() == archive.everything() == archive.tolerant
    assert [g.worst_speed for g in archive.tolerant] == [8.0]


def test_the_front_takes_what_nothing_dominates():
    archive = Archive()
    assert archive.offer_front(some_gait(10.2, 3.0))
    assert not archive.offer_front(some_gait(9.0, 3.0))
    assert not archive.offer_front(some_gait(-1.0, 0.1))
    assert archive.offer_front(some_gait(9.0, 2.0))
    # In one cell of speed the cheaper one stays.
    assert not archive.offer_front(some_gait(10.3, 3.1))
    assert archive.offer_front(some_gait(10.1, 2.9))
    assert archive.offer_front(some_gait(12.0, 2.8))
    assert [(g.mean_speed, g.cost_of_transport) for g in archive.front] == [(9.0, 2.0), (12.0, 2.8)]


def test_simulations_start_from_rest_or_where_told():
    family = FAMILIES["phase-space"]
    parameters = np.tile(family.start, (2, 1))
    states = np.array([[START_THETA, 0.0, 0.0, 0.0], [0.1, 0.0, 0.0, 0.0]])
    plant = (np.full(2, 0.5), np.full(2, 0.01))
    plain = simulate(family, parameters, *plant, horizon=0.5)
    told = simulate(family, parameters, *plant, horizon=0.5, states=states)
    assert plain["mean_speed"][0] == told["mean_speed"][0]
    assert plain["mean_speed"][1] != told["mean_speed"][1]
    assert HORIZON == 33.0


def test_figure(tmp_path):
    pytest.importorskip("matplotlib")
    from baselines import drawing
    from baselines.gaits.figure import draw_gaits

    with drawing.style():
        figure = draw_gaits()
        written = drawing.save(figure, tmp_path / "gaits")
    assert all(path.stat().st_size > 10_000 for path in written)
    labels = {label for axes in figure.axes for label in axes.get_legend_handles_labels()[1]}
    assert set(FAMILIES) <= labels
    assert {f"M = {M:g} kg" for M in GRID_M} <= labels
