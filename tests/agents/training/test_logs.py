import io
import shutil
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from tqdm import tqdm

from agents.criteria import CRITERIA
from agents.training import callbacks
from agents.training.callbacks import validation_plants
from agents.training.config import EVALUATIONS
from agents.training.loop import begin, train
from capsule_gym import load_policy
from capsule_gym.evaluation.episodes import evaluate, scores
from capsule_gym.tasks.task import HORIZON
from tests.agents.training.small import finished, log, rows, small


def briefly(**changes):
    # The first policies hardly move: a large weight makes their energy count.
    settings = {"evaluate_every": 256, "episode_seconds": 0.4, "energy_weight": 50.0}
    return small("direct", "ppo", **settings, **changes)


def terminal(patch):
    """A terminal that shows the progress bar."""
    screen = io.StringIO()
    screen.isatty = lambda: True
    patch.setattr(callbacks, "tqdm", partial(tqdm, file=screen))
    return screen


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run, what it shows on a terminal, and its last episodes by steps."""
    record = callbacks.TrainingCallback._record_episodes
    episodes = {}

    def recorded(self):
        episodes[self.num_timesteps] = [dict(each) for each in self.model.ep_info_buffer]
        record(self)

    folder = tmp_path_factory.mktemp("logs") / "run"
    with pytest.MonkeyPatch.context() as patch:
        screen = terminal(patch)
        patch.setattr(callbacks.TrainingCallback, "_record_episodes", recorded)
        finished(folder, briefly(total_steps=1000))
    return folder, screen.getvalue(), episodes


def test_the_progress_bar_ends_at_the_total_which_the_last_rollout_exceeds(run):
    _, screen, _ = run
    assert "100%" in screen
    assert "1.00k/1.00k" in screen
    assert "cm/s, failed" in screen


def test_the_progress_bar_of_a_resumed_run_begins_at_its_last_evaluation(
    run, tmp_path, monkeypatch
):
    folder, _, _ = run
    longer = shutil.copytree(folder, tmp_path / "run")
    screen = terminal(monkeypatch)
    train(longer, 1280)
    first, *_ = screen.getvalue().split("steps")
    assert "1.02k/1.28k" in first


def test_the_log_has_a_line_for_every_rollout(run):
    folder, _, _ = run
    assert list(log(folder)) == [256, 512, 768, 1024]


def test_the_log_of_an_off_policy_run_has_a_line_for_so_many_steps(tmp_path, monkeypatch):
    monkeypatch.setattr(callbacks, "LOG_EVERY", 200)
    config = small("direct", "td3", total_steps=640, learning_starts=640, episode_seconds=0.2)
    assert list(log(finished(tmp_path / "run", config))) == [200, 400, 600]


@pytest.fixture(scope="module")
def line(run):
    """A line of the log."""
    folder, _, _ = run
    names = ("episodes/", "evaluation/")
    row = log(folder)[768]
    # Episodes without progress have an infinite cost, which is not logged.
    return {name: float(value) for name, value in row.items() if name.startswith(names)}


@pytest.mark.parametrize(
    "name", ["episodes/mean_speed", "episodes/failed", "evaluation/stuck_fraction"]
)
def test_the_log_holds_metrics(line, name):
    assert name in line


def test_the_log_holds_the_terms_of_the_reward(run, line):
    _, _, episodes = run
    energy = np.median([episode["energy"] for episode in episodes[768]])
    moved = np.median([100.0 * episode["distance"] for episode in episodes[768]])
    speed = np.mean([episode["mean_speed"] for episode in episodes[768]])
    weight = briefly().energy_weight
    assert line["episodes/mean_speed"] == pytest.approx(speed, rel=1e-4)
    assert 0.0 <= line["episodes/stuck_fraction"] <= 1.0
    assert line["episodes/reward_energy"] == pytest.approx(-weight * energy, rel=1e-4)
    assert line["episodes/reward_progress"] == pytest.approx(moved, abs=1e-5)


def test_the_log_of_platforms_that_lift_without_moving(tmp_path):
    # Most starts fail, and so much friction leaves the capsule where it is.
    config = briefly(total_steps=256, initial_range=(1.5, 30.0), friction_range=(2.0, 2.0))
    line = log(finished(tmp_path / "run", config))[256]
    assert float(line["episodes/failed"]) > 0.5
    assert float(line["episodes/reward_termination"]) == -config.termination_penalty
    assert float(line["episodes/reward_progress"]) == pytest.approx(0.0, abs=1e-5)
    # An infinite number cannot be plotted.
    assert not {"episodes/cost_of_transport", "evaluation/cost_of_transport"} & set(line)


def test_the_score_is_less_by_the_energy(run):
    folder, _, _ = run
    config = briefly()
    episodes = evaluate(load_policy(folder), validation_plants(config))
    criteria = CRITERIA["speed"]
    means = {name: scores(episodes, name).mean() for name in criteria.weights}
    # The mean power, by the weight of energy in the reward.
    power = config.energy_weight * scores(episodes, "energy").mean() / HORIZON
    assert power > 1e-3
    best = max(float(row["score_cm_s"]) for row in rows(folder / EVALUATIONS))
    # evaluations.csv has four decimals.
    assert best == round(criteria.score(means) - power, 4)


@pytest.fixture
def wandb(monkeypatch):
    """A substitute of wandb, and what it was asked for."""
    begun = []

    def init(**options):
        begun.append(options)
        return module

    module = SimpleNamespace(init=init, finish=lambda: begun.append("end"))
    monkeypatch.setitem(sys.modules, "wandb", module)
    return begun


def test_weights_and_biases_follows_a_run_under_the_same_name(tmp_path, wandb):
    for name in ("first", "second"):
        begin(tmp_path / name, briefly(total_steps=256))
    for name in ("first", "second", "first"):
        train(tmp_path / name, wandb=True)
    first, _, second, _, again, _ = wandb
    assert wandb[1::2] == ["end"] * 3
    assert first["id"] == again["id"] != second["id"]
    assert (first["name"], first["project"]) == ("first", "capsule_gym")
    assert first["sync_tensorboard"]
    assert first["dir"] == tmp_path / "first"
    assert first["resume"] == "allow"
    assert first["config"]["total_steps"] == 256


def test_weights_and_biases_is_imported_only_where_it_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    finished(tmp_path / "run", briefly(total_steps=256))
