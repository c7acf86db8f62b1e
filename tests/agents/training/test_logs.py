import io
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from tqdm import tqdm

from agents.training import callbacks
from agents.training.loop import begin, train
from tests.agents.training.small import log, small

WATCHED = (
    "mean_speed",
    "failed",
    "stuck_fraction",
    "reward_progress",
    "reward_energy",
    "reward_termination",
)


def train_briefly(folder, total_steps=768, **options):
    config = small(
        "direct", "ppo", total_steps=total_steps, evaluate_every=256, episode_seconds=0.4
    )
    if not folder.exists():
        begin(folder, config)
    return config, train(folder, **options)


def test_the_log_holds_the_terms_of_the_reward(tmp_path, monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: True)
    monkeypatch.setattr(callbacks, "tqdm", partial(tqdm, file=screen))
    record, moved, spent = callbacks.TrainingCallback._record_episodes, {}, {}

    def recorded(self):
        moved[self.num_timesteps] = np.median(
            [100.0 * episode["distance"] for episode in self.model.ep_info_buffer]
        )
        spent[self.num_timesteps] = np.median(
            [episode["energy"] for episode in self.model.ep_info_buffer]
        )
        record(self)

    monkeypatch.setattr(callbacks.TrainingCallback, "_record_episodes", recorded)
    config, finished = train_briefly(tmp_path / "run", total_steps=1000)
    assert finished
    # The progress bar on a terminal ends at the total, which the last rollout exceeds.
    assert "100%" in screen.getvalue() and "1.00k/1.00k" in screen.getvalue()
    lines = log(tmp_path / "run")
    assert list(lines) == [256, 512, 768, 1024]
    # Episodes without progress have an infinite cost, which is not logged.
    line = {
        name: float(value)
        for name, value in lines[768].items()
        if name.startswith(("episodes/", "evaluation/"))
    }
    assert {f"episodes/{name}" for name in WATCHED} | {"evaluation/stuck_fraction"} <= set(line)
    assert 0.0 <= line["episodes/stuck_fraction"] <= 1.0
    assert line["episodes/reward_energy"] == pytest.approx(
        -config.energy_weight * spent[768], rel=1e-4
    )
    assert line["episodes/reward_progress"] == pytest.approx(moved[768], abs=1e-5)
    assert line["episodes/reward_termination"] in {-10.0 * share for share in (0.0, 0.5, 1.0)}


def test_weights_and_biases_follows_a_run_under_the_same_name_where_it_is_asked_for(
    tmp_path, monkeypatch
):
    begun = []
    wandb = SimpleNamespace(
        init=lambda **options: begun.append(options) or wandb, finish=lambda: begun.append("end")
    )
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    for folder in "aba":
        train_briefly(tmp_path / folder, total_steps=256, wandb=True)
    assert begun[1::2] == ["end"] * 3 and begun[0]["id"] == begun[4]["id"] != begun[2]["id"]
    assert (begun[0]["name"], begun[0]["project"], begun[0]["sync_tensorboard"]) == (
        "a",
        "capsule_gym",
        True,
    )
    monkeypatch.setitem(sys.modules, "wandb", None)
    assert train_briefly(tmp_path / "run")[1]
