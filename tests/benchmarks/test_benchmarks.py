"""The benchmarks at small sizes: their tables, errors, agents and trainers. These tests measure no
time."""

import re
from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from baselines.drawing import BLUE, MUTED
from benchmarks import (
    accuracy,
    fresh_draws,
    identification,
    measurement,
    rig,
    sensitivity,
    throughput,
    training,
)
from benchmarks.mujoco import FRICTIONS, build, hold
from capsule_gym import load_policy
from capsule_gym.core.layout import Row
from capsule_gym.parameters import Capsule
from tests.agents.fakes import Sine
from tests.figures import assert_bars, texts
from tests.project.test_pages import ROOT


def test_errors_of_the_step_grow_with_it(monkeypatch, tmp_path):
    small = {
        "FRICTION": (0.1,),
        "AMPLITUDES": (0.5,),
        "TRAJECTORIES": 2,
        "PLANTS": 2,
        "SECONDS": 1.0,
    }
    for name, value in small.items():
        monkeypatch.setattr(accuracy, name, value)
    assert accuracy.main(["--markdown", str(tmp_path / "page.md")]) == 0
    head, _, *rows = [
        line.strip("|").split("|") for line in (tmp_path / "page.md").read_text().splitlines()[2:6]
    ]
    assert head[2:] == ["0.25 ms", "0.5 ms", "1 ms", "2 ms", "5 ms", "10 ms", "length"]
    assert [row[:2] + row[-1:] for row in rows] == [
        ["μ = 0.1", "±0.5", "1.0 s"],
        ["2 random", "±0.7", "1.0 s"],
    ]
    for row in rows:
        largest, median = np.array([re.findall(r"\d\S*e-\d+", cell) for cell in row[2:-1]], float).T
        assert sorted(largest) == largest.tolist() and (median <= largest).all()
        # Of fourth order, from 10 ms to 1 ms.
        assert largest[2] < 1e-7 and median[5] / median[2] > 10.0**3.5


def test_the_errors_of_the_documentation_are_those_of_the_step():
    solved = accuracy.expected_trajectories([Capsule(mu=0.3)] * accuracy.TRAJECTORIES, 1.5)
    steps = accuracy.STEPS[2:]  # smaller ones are as accurate as the reference
    cells = [
        accuracy.cell([abs(accuracy.run(u, plant, h) - y).max() for plant, u, y in solved])
        for h in steps
    ]
    assert f"|{'|'.join(cells)}|2.4 s|" in (ROOT / "docs/error_table.md").read_text(
        encoding="utf-8"
    )


def test_mujoco_is_compared_by_its_errors_and_its_creep(monkeypatch):
    fake = {
        "build": lambda friction, step, capsule: (capsule, []),
        "creep": lambda model, data, load: load,
    }
    fake["hold"] = lambda capsule, u, torque: (
        u.append(torque) or accuracy.run(u, capsule, 1e-3) + np.eye(4)[2] / 1e3
    )
    monkeypatch.setattr(accuracy, "mujoco", SimpleNamespace(FRICTIONS=("1 mm ahead",), **fake))
    monkeypatch.setattr(accuracy, "SECONDS", 0.1)
    head, (name, speed, *errors), ahead = accuracy.compare_mujoco()
    assert f"|{'|'.join(head)}|\n" in (ROOT / "docs/error_table.md").read_text(encoding="utf-8")
    assert (name, speed) == ("capsule_gym", "0") and max(
        float(each.split()[0]) for each in errors
    ) < 1e-4
    load = 0.5 * 0.1 * (Capsule().M + Capsule().m) * Capsule().g  # half of the friction's limit
    assert ahead == ["MuJoCo, 1 mm ahead", f"{load:.0e}", *["1.0e+00 (1.0e+00)"] * 4]


def test_errors_and_coverage_of_identified_plants(monkeypatch, capsys):
    truth = {"M": 0.5, "mu": 0.1, "latency": 0.01, "lag": 0.005}
    # Estimates that are off by a tenth, of which the interval of M alone contains the truth.
    found = {name: 1.1 * value for name, value in truth.items()}
    intervals = {name: (0.0 if name == "M" else value, 9.0) for name, value in found.items()}
    fits = (
        SimpleNamespace(estimates=found, intervals={0.95: intervals}.get, chi2=chi2)
        for chi2 in (1.0, 2.0, 3.0)
    )
    monkeypatch.setattr(identification, "make_logs", lambda count, *_: [(truth, truth)] * count)
    monkeypatch.setattr(identification, "identify", lambda _: next(fits))
    identification.main(["--plants", "3"])
    _, *words, last = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert words[0] == ["M", "0.05", "10.0%", "100.0%"] and words[1] == [
        "mu",
        "0.01",
        "10.0%",
        "0.0%",
    ]
    assert words[2] == ["latency", "0.001", "0.0%"] and words[-1] == [
        "latency",
        "+",
        "lag",
        "0.0015",
    ]
    assert " ".join(last) == "chi2: 2.00, 90 % within 1.10 to 2.90; 0.0 s a fit"


def test_logs_are_of_plants_that_the_prior_contains():
    (log, truth), (_, other) = identification.make_logs(2, 8, identification.SENSORS["white"], 0.55)
    low, high = identification.FREE["static_ratio"]
    assert low <= truth["static_ratio"] <= high and truth["static_ratio"] != other["static_ratio"]
    assert len(log["t"]) > 1990 and truth["x_dot_bias"] == 0.0  # the first plant's has 57
    assert abs(truth["latency"] / identification.PHYSICS_DT % 1.0 - 0.5) > 0.5 - 1e-9


def test_the_agent_of_the_identified_plant_is_compared_with_the_others(monkeypatch, capsys):
    trained = []

    def train(seed, total_steps, **env_kwargs):
        trained.append((seed, total_steps, env_kwargs))
        # The agent of the paper's ranges fails, and that of wide ranges stands still.
        return (
            load_policy("residual-real-wide")
            if "found" in env_kwargs
            else Sine(0.0 if env_kwargs else 1.5)
        )

    monkeypatch.setattr(rig, "train", train)
    monkeypatch.setattr(
        rig,
        "identify",
        lambda log: SimpleNamespace(env_kwargs=lambda level: {"found": len(log["t"])}),
    )
    rig.main(["--plants", "2", "--total-steps", "64"])
    assert [seed for seed, *_ in trained] == [0, 0, rig.SEED, rig.SEED + 1] and {
        n for _, n, _ in trained
    } == {64}
    assert trained[2][2] == {"found": 2000}
    lines = [line for line in capsys.readouterr().out.splitlines() if line[0] != "7"]
    found = {
        line.split()[0]: [float(number) for number in re.findall(r"-?\d+\.\d+", line)]
        for line in lines[::2]
    }
    assert found["identified"][0] > 5.0 and found["identified"][0] >= found["identified"][1]
    assert abs(found["real-wide"][0]) < 0.5 and "2 of 2 fail" in lines[2]
    assert [line.split()[-1] for line in lines[1::2]] == ["0", "2", "2"]


def test_an_agent_is_trained_on_the_plants_that_it_is_given(monkeypatch):
    monkeypatch.setattr(
        rig, "CONFIG", replace(rig.CONFIG, num_envs=8, n_steps=32, batch_size=64, n_epochs=1)
    )
    agent = rig.train(0, 64, randomization="wide")
    assert agent.start([0])(np.zeros((1, 20), np.float32)).shape == (1, 1)


def test_the_derivatives_of_one_trajectory(capsys):
    sensitivity.main(["--trajectories", "1"])
    head, error, cost = capsys.readouterr().out.splitlines()
    assert head.startswith("1 trajectories with") and float(error.split()[-1]) < 1e-6
    assert float(re.search(r"take (\S+) times", cost)[1]) > 1.0


def test_rates_are_bars_of_their_colours(tmp_path, saved_figures):
    measured = {
        "capsule": 2e5,
        "CartPole-v1": 1e5,
        "capsule, plain C, 1024": 9e6,
        "capsule, 1024": 8e6,
    }
    throughput.draw(measured, tmp_path / "speed")
    axes = saved_figures[0].axes[0]
    # From top to bottom.
    assert texts(axes.get_yticklabels()) == [*measured][::-1]
    assert_bars(
        axes, *zip(range(4), [*measured.values()][::-1], (BLUE, MUTED, MUTED, BLUE), strict=True)
    )
    assert texts(axes.texts) == ["8,000,000", "9,000,000", "100,000", "200,000"]
    assert axes.get_xscale() == "log" and axes.get_xlim()[0] < 1e5 < 9e6 < axes.get_xlim()[1]
    assert {path.name for path in tmp_path.iterdir()} == {"speed.svg", "speed.png"}


def test_every_contender_steps_or_resets_and_begins_anew_after_an_episode(monkeypatch):
    monkeypatch.setattr(throughput, "TURN_SECONDS", 1e-3)
    found = throughput.contenders()
    assert {each for pair in throughput.FLOORS for each in pair} <= {
        *found,
        "capsule, plain C, 1024",
    }
    assert all(throughput.seconds_per_step(make(), 1) > 0.0 for make in found.values())
    page = (ROOT / "docs/speed_tables.md").read_text(encoding="utf-8")
    assert all(
        re.search(rf"\|{a}\|.*\|{b}\|{floor:g}\|", page)
        for (a, b), floor in throughput.FLOORS.items()
    )
    made, envs = gym.make, []
    monkeypatch.setattr(
        throughput.gym,
        "make",
        lambda *args, **kwargs: envs.append(made(*args, **kwargs)) or envs[-1],
    )
    for reset in (False, True):
        step = throughput.environment("Pendulum-v1", reset=reset)
        for _ in range(450):
            step()
    # An episode has 200 steps.
    assert [env.get_wrapper_attr("_elapsed_steps") for env in envs] == [50, 0]


def test_a_training_that_does_not_arrive_is_marked_in_the_table(monkeypatch, tmp_path, capsys):
    def trainer(speed):
        return lambda seed, clock: vars(clock).update(
            seconds=12.0 + seed, steps=65_536, speed=speed
        )

    monkeypatch.setattr(
        training, "CONTENDERS", {"fast": trainer(training.SPEED), "slow": trainer(3.25)}
    )
    assert training.main(["--seeds", "2", "--markdown", str(tmp_path / "page.md")]) == 0
    assert "fast, seed 1: 13 s\n" in capsys.readouterr().err
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "|trainer|seed 0, s|seed 1, s|thousands of steps|" in page
    assert "|fast|12|13|66, 66|" in page and "|slow|> 12 (3.2 cm/s)|> 13 (3.2 cm/s)|66, 66|" in page


class Hoard(gym.Env):
    """The last of five steps costs the sum of all actions, by the sign that is observed."""

    observation_space, action_space = (
        gym.spaces.Box(-9.0, 9.0, (2,)),
        gym.spaces.Box(-1.0, 1.0, (1,)),
    )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.seen, self.paid = np.float32([0.0, self.np_random.choice([-1.0, 1.0])]), 0.0
        return self.seen, {}

    def step(self, action):
        self.seen = self.seen + np.float32([1.0, 0.0])
        self.paid -= float(self.seen[1] * action[0])
        done = bool(self.seen[0] == 5.0)
        return self.seen, self.paid * done, done, False, {}


def test_the_loop_learns_what_pays_in_the_end(monkeypatch):
    monkeypatch.setattr(training.gym, "make", lambda *_, **__: Hoard())
    seen, updates = [], []

    def check(steps, policy):
        seen.append((steps, policy().start([0, 1])(np.float32([[0.0, -1.0], [0.0, 1.0]])).ravel()))
        return len(seen) < 4

    def record(adam, *_):
        (group,) = adam.param_groups
        updates.append(
            (group["lr"], [float(each.detach().square().sum()) for each in group["params"]])
        )

    with pytest.importorskip("torch.optim.optimizer").register_optimizer_step_pre_hook(record):
        training.train_loop(0, SimpleNamespace(check=check))
    assert [steps for steps, _ in seen] == [0, 2048, 4096, 6144]
    # 10 epochs in batches of 64, at a falling rate, from orthogonal weights with gains sqrt(2),
    # sqrt(2), and 0.01 or 1.
    assert [rate for rate, _ in updates] == pytest.approx(
        3e-4 * (1.0 - 2048e-6 * np.repeat(range(3), 320))
    )
    assert updates[0][1] == pytest.approx(
        [4.0, 0.0, 128.0, 0.0, 1e-4, 0.0, 4.0, 0.0, 128.0, 0.0, 1.0, 0.0, 0.0]
    )
    assert max(abs(seen[0][1])) < 0.05 and (seen[-1][1] * [-1.0, 1.0] < -0.3).all(), seen


def test_contenders_take_turns_and_the_tenth_percentile_counts():
    log = []
    contenders = {name: lambda name=name: log.append(name) or float(len(log)) for name in "ab"}
    assert measurement.rates(contenders, 11) == {
        "a": pytest.approx(1.0 / 3.0),
        "b": pytest.approx(1.0 / 4.0),
    }
    assert log == ["a", "b"] * 11


def test_a_ratio_below_its_floor_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(
        throughput, "contenders", lambda: {"fast": list, "slow": list, "other": list}
    )
    monkeypatch.setattr(throughput, "rates", lambda turns, _: {name: rates[name] for name in turns})
    rates = {"fast": 2.0, "slow": 1.0, "other": 1.0}
    for floor, status in ((1.9, 0), (2.1, 1)):
        monkeypatch.setattr(
            throughput, "FLOORS", {("fast", "slow"): floor, ("fast", "not installed"): 100.0}
        )
        page = tmp_path / "page.md"
        assert throughput.main(["--markdown", str(page)]) == status
        assert f"|fast|2|2.00|slow|{floor:g}|" in page.read_text(encoding="utf-8")
        assert "|other|1||||" in page.read_text(encoding="utf-8")


# Without the end of episodes, and with it.
@pytest.mark.parametrize("scale", [throughput.ACTION_SCALE, 1.0])
def test_plain_c_does_the_work_of_the_core(scale, monkeypatch):
    compiler = throughput.COMPILER or pytest.skip("no C compiler")
    monkeypatch.setattr(throughput, "ACTION_SCALE", scale)
    (core, expected), (plain, world) = (
        throughput.from_the_start(),
        throughput.from_the_start(compiler),
    )
    # The options of plain C hold for it alone: the process keeps subnormal numbers.
    assert np.float64(5e-324) * 1.0 > 0.0
    for _ in range(throughput.EPISODE):
        core()
        plain()
        rows = expected[:, : Row.clock]
        whole = np.isfinite(rows)
        assert np.abs(world[whole] - rows[whole]).max() < 1e-6
    assert (world[:, Row.stuck] > 0.0).any() and (world[:, Row.backward] > 0.0).any()
    assert (world[:, Row.termination] != 0.0).any() == (scale == 1.0)


@pytest.mark.parametrize("friction", [None, *FRICTIONS])
def test_mujoco_has_the_same_plant_and_about_the_same_friction(friction):
    module = pytest.importorskip("mujoco")
    torques = np.random.default_rng(0).uniform(-0.5, 0.5, 100)
    capsule = Capsule(mu=0.1 if friction else 0.0)
    model, data = build(friction or "frictionloss", 1e-3, capsule)
    model.opt.integrator = module.mjtIntegrator.mjINT_RK4
    state = [hold(model, data, torque) for torque in torques][-1]
    difference = np.abs(state - accuracy.run(torques, capsule, 1e-3)).max()
    assert difference < (0.03 if friction else 1e-8)
    assert (
        not friction
        or np.abs(state - accuracy.run(torques, Capsule(mu=0.0), 1e-3)).max() > 5.0 * difference
    )


def test_evaluations_do_not_count_and_the_clock_stops_at_the_speed_or_the_time(monkeypatch):
    now, speeds = [0.0], iter((3.0, 15.0, 3.0))

    def evaluate(*_):
        now[0] += 50.0
        return [{"mean_speed": next(speeds)}]

    monkeypatch.setattr(training, "evaluate", evaluate)
    monkeypatch.setattr(training.time, "process_time", lambda: now[0])
    clock = training.Clock(None, _began=0.0)
    assert clock.check(training.EVERY - 1, list) and clock.seconds == 0.0
    for n, (seconds, going) in enumerate(
        ((4.0, True), (10.0, False), (training.MOST_SECONDS, False)), start=1
    ):
        now[0] += seconds - clock.seconds
        assert clock.check(n * training.EVERY, list) is going
        assert (clock.seconds, clock.steps) == (seconds, n * training.EVERY)


def test_an_agent_is_evaluated_while_it_learns():
    seen = []

    def check(steps, policy):
        seen.append((steps, policy().env_kwargs))
        return len(seen) < 3

    for library, num_envs in (
        ("", training.CONFIG.num_envs),
        ("stable_baselines3", training.NUM_ENVS),
    ):
        training.train_model(library, 0, SimpleNamespace(check=check))
        assert seen == [(n * num_envs, training.ENV_KWARGS) for n in (1, 2, 3)]
        seen.clear()


def test_means_on_new_plants_agree_with_the_table_and_not_with_another(monkeypatch, capsys):
    monkeypatch.setattr(fresh_draws, "PLANTS", 20)
    monkeypatch.setattr(fresh_draws, "MAIN_SETS", ("paper",))
    assert fresh_draws.main(["open-loop"]) == 0
    assert "0 of 1 means differ" in capsys.readouterr().out
    load_row = fresh_draws.load_row

    def slower(path):
        row = load_row(path)
        return replace(row, scores={name: scores - 1.0 for name, scores in row.scores.items()})

    monkeypatch.setattr(fresh_draws, "load_row", slower)
    assert fresh_draws.main(["open-loop"]) == 1
    assert "0/20  differs" in capsys.readouterr().out
