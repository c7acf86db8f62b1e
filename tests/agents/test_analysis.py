"""The documents of the analysis: statistics of the leaderboard, Pareto front, residual limit and gallery."""

import csv
import dataclasses
import re

import numpy as np
import pytest
from PIL import Image

from agents.analysis import __main__ as analysis
from agents.analysis import gallery, pareto, residual_limit
from agents.analysis.data import fronts, gather, read_learning
from agents.analysis.figures import draw_improvement, figures_of
from agents.analysis.residual_limit import Agent, Results
from agents.evaluation import policies as evaluation_policies
from agents.leaderboard.rows import COLUMNS, Row
from agents.training.callbacks import SELECTION_SEED
from agents.training.presets import ROWS as TRAINED
from baselines import drawing
from capsule_gym.evaluation_sets import SET_NAMES, load_set
from capsule_gym.task import TORQUE_LIMIT
from tests.agents.fakes import Sine
from tests.agents.leaderboard.world import make_set

SETS = tuple(make_set(name, *[(0.5, 0.01)] * 4) for name in ("nominal", "paper", "wide"))
SHORT = make_set("short", (0.5, 0.01), (0.5, 0.01))


def make_row(name, seeds=(), speed=1.0, base=None, failed=0):
    """A row whose speeds are known: each seed half a centimetre per second faster than the one before."""
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
    failures = cells(analysis.tables.failures(results))
    assert failures[0][2:] == ["nominal", "paper", "wide"]
    assert failures[2] == ["direct-ppo", "3", *["2/12 (16.7 %, worst seed 2)"] * 3]
    assert failures[4] == ["adaptive", "-", *["0/4"] * 3]
    differences = {(row[0], row[1]): row[2:] for row in cells(analysis.tables.differences(results))}
    assert differences["direct-ppo", "paper"] == ["+16.50 [+16.00, +17.00]", "-", "-", "-"]
    against, direct, base, name = differences["residual", "wide"]
    assert against == base == "+8.25 [+8.00, +8.50]"
    assert direct.startswith("-8.25 [") and name == "adaptive"
    assert cells(analysis.tables.improvements(results))[2] == ["direct-ppo", "residual", *["1.00 [1.00, 1.00]"] * 2]
    learning = analysis.tables.learning(results)
    assert cells(learning)[2] == ["residual", "2", "300", "9.50 [9.00, 10.00]", "300"]
    assert "Without committed evaluations: direct-ppo." in learning


def test_figures_of_the_statistics(results, tmp_path, monkeypatch):
    monkeypatch.setattr(drawing, "DPI", 50)
    found = figures_of(results)
    assert {name.rpartition("_")[2] for name in found} == {*("transport", "profiles", "improvement", "learning")}
    for name, write in found.items():
        for path in write(tmp_path / name.rpartition("/")[2]):
            assert path.stat().st_size > 5000
    scripted = gather([row for row in ROWS if not row.trained], SETS, tmp_path)
    assert list(figures_of(scripted)) == ["figures/statistics_transport"]
    (axes,) = draw_improvement(results).axes
    assert [text.get_text() for text in axes.texts] == ["1.00", "0.00"]


def test_the_optimum_dominates_the_gaits_and_speed_has_its_cost():
    found = fronts()
    for points in found.values():
        costs, speeds = np.array(points).T
        assert (np.diff(costs) >= 0.0).all() and (np.diff(speeds) >= 0.0).all()
    for cost, speed in found["best-known gaits"]:
        assert min((c for c, s in found["optimum"] if s >= speed), default=0.0) < cost


def test_the_last_of_two_evaluations_at_the_same_step_counts(tmp_path):
    write_evaluations(tmp_path, 3, [1.0, 2.0])
    with (tmp_path / "seed-3" / "evaluations.csv").open("a") as file:
        file.write("200,5.0,0.0\n")
    steps, speeds = read_learning(tmp_path).seeds[3]
    assert (steps.tolist(), speeds.tolist()) == ([100, 200], [1.0, 5.0])


@pytest.mark.parametrize("text", ["steps,mean_speed_cm_s\n", "a,b\n1,2\n"])
def test_broken_evaluations_are_named(tmp_path, text):
    write_evaluations(tmp_path, 0, [])
    (tmp_path / "seed-0" / "evaluations.csv").write_text(text)
    with pytest.raises(ValueError, match=r"evaluations\.csv must be what a training run writes"):
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
    # At the speed of a gait the ratio is that of the costs; beyond the fastest there is none.
    cost, speed = fronts()["best-known gaits"][3]
    twice = dataclasses.replace(free.cost, value=2.0 * cost)
    at, beyond = (
        free._replace(speed=dataclasses.replace(free.speed, value=each), cost=twice) for each in (speed, 99.0)
    )
    assert [line[3] for line in cells(pareto.table([at, beyond]))[2:]] == ["2.00", "-"]


@pytest.mark.parametrize("name", ["direct-ppo", "adaptive"])
def test_a_policy_that_does_not_observe_the_weight_is_refused(name):
    with pytest.raises(ValueError, match="energy weight"):
        pareto.measure(name, SHORT, (1.0,))


ON_GAIT = Agent("gait-guarded", "paper", 0.75, "cautious")
DIRECT = Agent("", "paper", TORQUE_LIMIT)


def sweep(agents, seeds=(0, 1, 2)):
    """Results that are known: an agent adds its limit and its seed to the speed of its law; its last episode fails."""
    speeds = [10.0 + 0.01 * n for n in range(8)]
    laws = dict.fromkeys(agent.alone for agent in agents if agent.base)
    runs = [{"arm": law._asdict(), "seed": None, "speeds": speeds, "failed": [], "learning": []} for law in laws]
    for agent in agents:
        for seed in seeds:
            own = [speed + agent.limit + seed for speed in speeds]
            run = {"arm": agent._asdict(), "seed": seed, "speeds": own, "failed": [7]}
            runs.append({**run, "learning": [[500_000, 5.0, 0.5], [1_000_000, 9.0, 0.0]]})
    return Results({"steps": 1_000_000, "sets": {}, "versions": {}, "runs": runs})


def test_agents_of_the_sweep_differ_in_law_limit_plants_and_recipe_alone():
    agents = residual_limit.agents()
    assert len(agents) == len({agent.name for agent in agents}) == 18
    for agent in agents:
        config = agent.config()
        config.check()
        row = TRAINED[residual_limit.RECIPES.get(agent.recipe) or residual_limit.DIRECT[agent.plants]]
        names = [each.name for each in dataclasses.fields(row)]
        changed = {name for name in names if getattr(row, name) != getattr(config, name)}
        of_a_law = {"task", "controller", "residual_limit"}
        assert changed <= {"total_steps", "evaluate_every", "randomization", *(of_a_law if agent.base else ())}
        assert (config.total_steps, config.randomization) == (1_000_000, agent.plants)
        if agent.base:
            assert config.env_kwargs()["residual_limit"] == agent.limit in residual_limit.LIMITS


@pytest.mark.parametrize("plants", ["paper", "wide"])
def test_the_plants_of_the_sweep_are_of_no_other_set(plants):
    drawn = residual_limit.evaluation_plants(plants)
    seeds = {plant.seed for plant in drawn.plants}
    assert len(seeds) == 256 and min(seeds) == 3_000_000 > SELECTION_SEED + 1000 * 256
    frozen = {(plant.M, plant.mu) for name in SET_NAMES for plant in load_set(name).plants}
    assert not {(plant.M, plant.mu) for plant in drawn.plants} & frozen


def test_agents_are_compared_with_their_law_on_the_same_plants():
    results = sweep([ON_GAIT, DIRECT])
    assert results.speeds(ON_GAIT).shape == (3, 8)
    assert results.failed(ON_GAIT).sum(axis=0).tolist() == [0.0] * 7 + [3.0]
    _, _, alone, agent, direct = cells(residual_limit.speed_table(results))
    # Every seed is faster by its limit and its number, on every plant.
    assert agent[2] == "0.75" and agent[-2:] == ["3/24", "+1.75 [+0.75, +2.75]"]
    assert alone[-2:] == ["0/8", "-"] and direct[0] == "none (direct)"
    assert residual_limit.describe(results).startswith("6 trainings of 1,000,000 steps, training seeds 0, 1, 2; 8")
    assert cells(residual_limit.learning_table(results))[2] == ["gait", "paper", "cautious", *["5.00"] * 4, "9.00"]


@pytest.mark.parametrize("agents", [residual_limit.agents(), residual_limit.agents()[:3]], ids=["all", "some"])
def test_the_figure_of_the_sweep_shows_what_there_is(agents):
    speed, failed = residual_limit.draw(sweep(agents)).axes[::2]
    assert speed.get_ylim()[0] == failed.get_ylim()[0] == 0.0
    assert len(speed.get_legend_handles_labels()[0]) == (6 if len(agents) > 3 else 4)


def test_the_results_of_other_plants_are_refused(monkeypatch):
    monkeypatch.setattr(residual_limit, "FIRST_SEED", 5)
    with pytest.raises(ValueError, match="other plants of paper"):
        residual_limit.load()


def test_the_gallery_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluation_policies, "SCRIPTED", {name: Sine(0.3, name="sine") for name in ("one", "two")})
    changes = {"POLICIES": ("one", "two"), "COMPARED": ("one", "two"), "CARD_POLICY": "two", "CARD_FRAME": 1}
    for name, value in {**changes, "BEGIN": 0.1, "SECONDS": 0.4}.items():
        monkeypatch.setattr(gallery, name, value)
    assert analysis.main(["gallery", "--output", str(tmp_path)]) == 0
    with Image.open(tmp_path / "media" / "two.gif") as moving:
        assert (moving.n_frames, moving.width, moving.info["duration"]) == (6, 480, 80)
    with Image.open(tmp_path / "media" / "card.png") as card:
        assert card.size == (1200, 630)
    assert {path.name for path in tmp_path.rglob("*.*")} == {"one.gif", "two.gif", "card.png", "gallery.png"}


def test_stale_tables_are_found(tmp_path, capsys):
    """The committed tables of the sweep are those of its committed results."""
    assert analysis.main(["residual_limit", "--check"]) == 0
    assert analysis.main(["residual_limit", "--check", "--output", str(tmp_path)]) == 1
    assert re.search(r"residual_limit_tables\.md is not up to date: run `python -m", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "message"),
    [(["nothing"], "got 'nothing'"), (["limit_cycle", "--policies", "nobody"], "got 'nobody'")],
)
def test_bad_options_are_named(words, message, capsys):
    with pytest.raises(SystemExit) as stop:
        analysis.main(words)
    assert stop.value.code == 2 and message in capsys.readouterr().err
