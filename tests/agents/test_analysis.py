"""Analysis: recordings and limit cycles, statistics of the leaderboard, Pareto front, residual limit and animations."""

import csv
import dataclasses
import re

import numpy as np
import pytest
from PIL import Image

import capsule_gym
from agents.analysis import __main__ as analysis
from agents.analysis import algorithms, goal, limit_cycle, pareto, recording, sensitivity
from agents.analysis.data import fronts, gather, read_learning
from agents.analysis.limit_cycle import find_cycle, median_run
from agents.analysis.recording import Recording, record
from agents.evaluation import policies as evaluation_policies
from agents.evaluation.episodes import evaluate
from agents.evaluation.policies import Candidate, find_candidate
from agents.leaderboard.rows import COLUMNS, Row
from baselines import drawing
from capsule_gym import Capsule, dynamics
from capsule_gym.evaluation_sets import EvaluationSet, PlantSpec
from capsule_gym.parameters import REAL, Disturbances
from tests.agents.fakes import Sine, make_policy
from tests.agents.leaderboard.world import make_set

SETS = tuple(make_set(name, *[(0.5, 0.01)] * 4) for name in ("nominal", "paper", "wide"))
SHORT = make_set("short", (0.5, 0.01), (0.5, 0.01))


def make_row(name, seeds=(), speed=1.0, base=None, failed=0):
    """A row with known speeds: each seed is half a centimetre per second faster than the one before."""
    count = max(1, len(seeds))
    values = np.ones((len(COLUMNS), count, 4))
    values[COLUMNS.index("mean_speed")] = speed + 0.5 * np.arange(count)[:, None]
    values[COLUMNS.index("failed")] = 0.0
    values[COLUMNS.index("failed"), -1, :failed] = 1.0
    header = {"policy": name, "training_seeds": list(seeds), "base": base, "metrics": list(COLUMNS)}
    sets = {each.name: each.hash for each in SETS}
    return Row({**header, "sets": sets}, {each.name: values.copy() for each in SETS})


def write_evaluations(folder, seed, speeds):
    path = folder / f"seed-{seed}" / "evaluations.csv"
    path.parent.mkdir(parents=True)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["steps", "mean_speed_cm_s", "failed"])
        writer.writeheader()
        writer.writerows({"steps": 100 * (n + 1), "mean_speed_cm_s": v, "failed": 0.0} for n, v in enumerate(speeds))


ROWS = [
    make_row("adaptive", speed=1.0),
    make_row("direct-ppo", (0, 1, 2), speed=17.0, failed=2),
    make_row("residual", (0, 1), speed=9.0, base="adaptive"),
    make_row("still", speed=0.0),
]
ROWS[-1].scores["nominal"][COLUMNS.index("cost_of_transport")] = np.inf


@pytest.fixture
def results(tmp_path):
    for seed, end in ((0, 9.0), (1, 10.0)):
        write_evaluations(tmp_path / "residual", seed, [1.0, end - 1.0, end])
    return gather(ROWS, SETS, tmp_path)


def cells(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line[:1] == "|"]


def test_tables_of_the_statistics(results):
    learning = analysis.statistics.learning(results)
    assert cells(learning)[2] == ["residual", "2", "300", "9.50 [3.15, 15.85]", "300"]
    assert "Without committed evaluations: direct-ppo." in learning


def test_figures_of_the_statistics(results, tmp_path, monkeypatch):
    monkeypatch.setattr(drawing, "DPI", 50)
    found = analysis.statistics.figures_of(results)
    assert {name.rpartition("_")[2] for name in found} == {*("transport", "profiles", "learning")}
    for name, write in found.items():
        for path in write(tmp_path / name.rpartition("/")[2]):
            assert path.stat().st_size > 5000
    scripted = gather([row for row in ROWS if not row.trained], SETS, tmp_path)
    assert list(analysis.statistics.figures_of(scripted)) == ["figures/statistics_transport"]


def test_the_last_of_two_evaluations_at_the_same_step_counts(tmp_path):
    write_evaluations(tmp_path, 3, [1.0, 2.0])
    path = tmp_path / "seed-3" / "evaluations.csv"
    with path.open("a") as file:
        file.write("200,5.0,0.0\n")
    steps, speeds = read_learning(tmp_path)[3]
    assert (steps.tolist(), speeds.tolist()) == ([100, 200], [1.0, 5.0])
    path.write_text("steps,mean_speed_cm_s\n")
    with pytest.raises(ValueError, match=r"evaluations\.csv must be the log of a training run"):
        read_learning(tmp_path)


def test_another_set_is_refused(tmp_path):
    with pytest.raises(ValueError, match="the hash of the set paper"):
        gather(ROWS, [*SETS[:1], make_set("paper", (0.5, 0.02))], tmp_path)


def test_a_large_energy_weight_gives_slow_and_cheap_motion():
    free, dear = pareto.measure("pareto/seed-0", SHORT, (0.2, 12.0))
    assert free.speed.value > 2.0 * dear.speed.value > 0.0
    assert free.cost.value > 2.0 * dear.cost.value > 0.0
    assert free.failures == "0/2"
    (_, _, first, second) = cells(pareto.table([free, dear]))
    assert first[0] == "0.2" and float(first[3]) > 0.0 and second[-1] == "0/2"
    # At the speed of a gait, the ratio is the ratio of the costs; beyond the fastest gait, there is none.
    cost, speed = fronts()["best-known gaits"][3]
    twice = dataclasses.replace(free.cost, value=2.0 * cost)
    at, beyond = (
        free._replace(speed=dataclasses.replace(free.speed, value=each), cost=twice) for each in (speed, 99.0)
    )
    assert [line[3] for line in cells(pareto.table([at, beyond]))[2:]] == ["2.00", "-"]


def test_sensitivity_shows_speed_and_failures_under_disturbances_of_each_size(monkeypatch):
    monkeypatch.setattr(sensitivity, "EPISODES", 2)
    conditions = sensitivity.conditions()
    assert conditions['all of "real"', 1.0] == REAL
    doubled = conditions['all of "real"', 2.0]
    assert (doubled.latency, doubled.lag, doubled.drift_time) == ((0.01, 0.03), 0.01, REAL.drift_time)
    assert conditions["latency", 0.5] == Disturbances(latency=0.005)
    results = sensitivity.run([Candidate("wild", (Sine(1.5, period=10.0, name="wild"),), "")], horizon=1.0)
    document = sensitivity.compose({**results, "still": dict.fromkeys(conditions, (0.0, 0))})
    head, _, wild, still = cells(document.sections["speeds"])
    assert head == ["policy", "none", *sensitivity.DISTURBED, "no x_dot"]
    assert wild[1].endswith(" (2)") and still[1:] == ["0.00"] * (len(head) - 1)
    assert len(sensitivity.draw(results).axes) == len(head)


def test_animations_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluation_policies, "SCRIPTED", {name: Sine(0.3, name="sine") for name in ("one", "two")})
    changes = {"POLICIES": ("one",), "TASK_POLICIES": {"two": (PLANT, 0.1, 0.4)}, "BEGIN": 0.1, "SECONDS": 0.4}
    for name, value in changes.items():
        monkeypatch.setattr(recording, name, value)
    assert analysis.main(["animations", "--output", str(tmp_path)]) == 0
    with Image.open(tmp_path / "media" / "two.gif") as moving:
        assert (moving.n_frames, moving.width, moving.info["duration"]) == (6, 480, 80)
    assert {path.name for path in tmp_path.rglob("*.*")} == {"one.gif", "two.gif"}


def test_stale_tables_are_found(tmp_path, capsys):
    """The committed tables of the sweep match its committed results."""
    assert analysis.main(["residual_limit", "--check"]) == 0
    assert analysis.main(["residual_limit", "--check", "--output", str(tmp_path)]) == 1
    assert re.search(r"residual_limit_tables\.md is not up to date: run `python -m", capsys.readouterr().out)


def test_an_unknown_name_is_refused(capsys):
    with pytest.raises(SystemExit) as stop:
        analysis.main(["nothing"])
    assert stop.value.code == 2 and "got 'nothing'" in capsys.readouterr().err


PLANT = PlantSpec(0.6, 0.05, seed=3)


@pytest.mark.parametrize(
    "policy",
    [
        Sine(0.5, env_kwargs={"control_dt": 0.01, "randomization": "wide", "num_envs": 3}),
        Sine(0.4, env_kwargs={"controller": "baselines:adaptive", "residual_limit": 1.0}),
    ],
    ids=["torque", "residual"],
)
def test_a_recording_is_the_motion_of_the_episode(policy):
    found = record(policy, PLANT, seconds=2.0)
    (episode,) = evaluate(policy, EvaluationSet("one", (PLANT,)), horizon=2.0)
    assert found.x[-1] == pytest.approx(episode["distance"], abs=1e-12)
    assert found.t[-1] == pytest.approx(2.0)
    assert np.abs(found.torque).max() == pytest.approx(episode["peak_torque"])
    weight = (PLANT.M + 0.138) * 9.81
    assert found.normal_force[1:].min() / weight == pytest.approx(episode["smallest_normal_ratio"])
    assert not found.failed and found.frames == ()


def test_a_recording_ends_with_its_episode():
    policy = Sine(1.5, period=10.0, name="wild")
    found = record(policy, PLANT, seconds=2.0)
    (episode,) = evaluate(policy, EvaluationSet("one", (PLANT,)), horizon=2.0)
    assert found.failed and -1e-9 <= found.t[-1] - episode["duration"] < 0.02


def test_pictures_are_as_often_as_asked_for():
    found = record(Sine(0.5), PLANT, seconds=1.0, frames_from=0.2, frame_seconds=0.08, name="mine")
    assert len({frame.tobytes() for frame in found.frames}) == len(found.frames) == 11
    assert found.name == "mine"


def made(period, seconds=30.0):
    """A known motion: theta is a sine, and the platform follows it."""
    t = np.arange(0.0, seconds, 1e-3)
    theta = np.sin(2.0 * np.pi * t / period)
    theta_dot = np.gradient(theta, t)
    x = 0.01 * theta + 0.01 * t
    force = np.full_like(t, 6.0)
    return Recording("made", t, theta, theta_dot, x, np.gradient(x, t), np.sign(theta_dot), force, 1.0, False)


def test_the_cycle_of_a_sine():
    cycle = find_cycle(made(0.8))
    assert cycle.t[-1] == pytest.approx(0.8)
    assert cycle.x[-1] / cycle.t[-1] == pytest.approx(0.01, rel=1e-2)
    assert cycle.theta[0] == pytest.approx(-1.0, abs=1e-5)
    for wrong in (made(12.0), dataclasses.replace(made(0.8), failed=True)):
        with pytest.raises(ValueError, match="must contain two cycles"):
            find_cycle(wrong)


def test_the_papers_law_brings_the_platform_to_rest_in_every_cycle():
    cycle = find_cycle(record(find_candidate("adaptive").policies[0]))
    assert cycle.t[-1] == pytest.approx(6.6)
    assert cycle.x_dot[0] == 0.0 == cycle.x_dot[-1]


def test_the_table_and_the_figure_of_cycles():
    cycles = [find_cycle(made(0.5 + 0.1 * n)) for n in range(3)]
    rows = cells(limit_cycle.table(cycles))[2:]
    assert [row[1] for row in rows] == ["0.50", "0.60", "0.70"]
    assert [row[3] for row in rows] == ["x 1.00", "x 0.83", "x 0.71"]
    assert [row[5:7] for row in rows] == [["1.00", "100 %"]] * 3
    assert len(limit_cycle.draw(cycles).axes) == 15


def test_the_seed_with_the_median_speed_is_shown(monkeypatch):
    speeds = {0: 3.0, 4: 1.0, 7: 2.0, 9: 4.0}

    def recording_of(policy, name):
        return dataclasses.replace(made(0.8), x=np.array([0.0, speeds[policy.training_seed]]), name=name)

    monkeypatch.setattr(limit_cycle, "record", recording_of)
    policies = tuple(make_policy(seed) for seed in speeds)
    assert median_run(Candidate("learnt", policies, "")).name == "learnt (seed 7)"
    assert median_run(Candidate("learnt", policies[:1], "")).name == "learnt"


def test_friction_bounds_what_moves_the_centre_of_mass():
    rng = np.random.default_rng(5)
    for _ in range(2000):
        p = Capsule(M=rng.uniform(0.4, 0.6), mu=rng.uniform(0.0, 0.5), static_ratio=1.3).plant()
        theta, theta_dot, u = rng.uniform(-1.5, 1.5), rng.uniform(-12.0, 12.0), rng.uniform(-1.5, 1.5)
        slip = dynamics.contact_phase(theta, theta_dot, rng.choice([-0.1, 0.0, 0.1]), u, p)
        theta_ddot, x_ddot, normal = dynamics.accelerations(theta, theta_dot, 0.1 * slip, slip, u, p)
        sin, cos, s = np.sin(theta), np.cos(theta), p.m * p.l / (p.M + p.m)
        along = x_ddot - s * (cos * theta_ddot - sin * theta_dot**2)
        up = -s * (sin * theta_ddot + cos * theta_dot**2)
        assert normal == 0.0 or abs(along) <= p.mu * p.static_ratio * (p.g + up) + 1e-9


def test_the_least_time_to_a_goal_is_that_of_a_mass_without_a_ball():
    # It accelerates by a = mu g and brakes to the velocity a / 2, which friction could remove within the final second.
    plant, capsule = PlantSpec(0.5, 0.01, 0, goal=-0.302), Capsule(m=1e-9)
    a = 0.01 * capsule.g
    fastest = np.sqrt(0.3 * a + 0.5 * (0.5 * a) ** 2)
    assert goal.least_time(plant, capsule) == pytest.approx((2.0 * fastest - 0.5 * a) / a + 1.0, abs=1e-3)


def test_no_episode_is_faster_than_the_least_time_to_its_goal():
    rng = np.random.default_rng(6)
    for capsule, mus, ratio in ((Capsule(static_ratio=1.3), (0.05, 0.5), 4.0), (Capsule(), (0.009, 0.011), 1.5)):
        drawn = [(rng.uniform(0.45, 0.55), rng.uniform(*mus), sign * rng.uniform(0.05, 0.5)) for sign in [-1, 1] * 50]
        plants = tuple(PlantSpec(M, mu, n, goal=d) for n, (M, mu, d) in enumerate(drawn))
        episodes = evaluate(goal.POLICY, EvaluationSet("own", plants, "goal", capsule))
        times = np.array([episode["goal_time"] for episode in episodes])
        bounds = np.array([goal.least_time(plant, capsule) for plant in plants])
        assert (times >= bounds).all() and np.median(times / bounds) < ratio


def test_the_figure_of_the_goal(tmp_path, monkeypatch):
    monkeypatch.setattr(drawing, "DPI", 50)
    sets = {name: EvaluationSet(name, (plant,), "goal", Capsule()) for name, plant in goal.PLANTS.items()}
    monkeypatch.setattr(goal, "load_set", sets.__getitem__)
    document = goal.document()
    assert [row[1] for row in cells(document.sections["bound"])[2:]] == ["100.0 %"] * 2
    (write,) = document.figures.values()
    assert write(tmp_path / "goal")[0].stat().st_size > 5000


# --- algorithms ------------------------------------------------------------------------------------------------------


def test_sac_from_the_default_start_swings_on_one_side_of_the_upright():
    one_sided, fast = (
        find_cycle(record(capsule_gym.load_policy(name))) for name in (algorithms.ONE_SIDED, "direct-ppo")
    )
    assert one_sided.theta.min() > np.radians(10.0)
    assert fast.theta.min() < -np.radians(50.0) and fast.theta.max() > np.radians(40.0)
    assert fast.x[-1] / fast.t[-1] > 2.5 * one_sided.x[-1] / one_sided.t[-1]
