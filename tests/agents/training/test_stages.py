"""Runs of two stages, with all that PPO can be told: what goes over, and that a run that goes on is the same run."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from agents.evaluation.episodes import evaluate, scores
from agents.training import checkpoint, loop
from agents.training.loop import Falling, Monitor, begin, export, falling, make_env, make_model, own_draws, train
from agents.training.ppo import CapsulePPO, transfer
from agents.training.presets import PRESETS, PPOConfig, read_config
from agents.training.runs import archive, unarchive
from capsule_gym import Randomization, load_policy
from capsule_gym.network import to_action
from capsule_gym.observation import BASE_OBSERVATION
from tests.agents.training.sameness import differences, rows
from tests.agents.training.small import small, weights
from tests.agents.training.test_survival import Killed, kill_at, next_second

LAST_ACTION = BASE_OBSERVATION.index("last_action")
# With episodes so short that there is something to log.
SHORT = {"episode_seconds": 0.4, "evaluate_every": 300}
OPTIONS: dict[str, dict[str, Any]] = {
    "identifies": {"identifies": True, "randomization": "wide"},
    "privileged critic": {"privileged_critic": True, "randomization": "broad"},
    "energy weights": {"energy_weights": (0.1, 10.0)},
    "jumps": {"jump_rate": 2.0, "randomization": "wide"},
    "tanh and a floor": {"tanh_mean": True, "least_log_std": -0.4},
    "relu": {"activation": "relu"},
    "critic first": {"critic_steps": 600},
    "a law": {"task": "residual", "controller": "baselines:adaptive"},
    "in stages": {"task": "residual", "controller": "baselines:adaptive", "direct_steps": 700, "output": "torque"},
}
OPTIONS["all"] = {name: value for changes in OPTIONS.values() for name, value in changes.items()}
STAGED = [name for name, changes in OPTIONS.items() if "direct_steps" in changes]


@pytest.fixture(autouse=True)
def small_direct_stage(monkeypatch):
    """What runs begin with is as small as what they end with."""
    monkeypatch.setitem(PRESETS, ("direct", "ppo"), small("direct", "ppo", **SHORT))


def configuration(name: str, **changes: Any) -> PPOConfig:
    own = {"task": "direct", "controller": None, "total_steps": 1800, **SHORT, **OPTIONS[name], **changes}
    own = {"control_dt": 0.02, "output": "action", "log_std_init": -0.5, **own}
    config = small(own.pop("task"), "ppo", **own)
    assert isinstance(config, PPOConfig)
    return config


def finished(folder: Path, config: PPOConfig) -> Path:
    begin(folder, config)
    assert train(folder, config)
    return folder


def killed(run: Path, config: PPOConfig, monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    with monkeypatch.context() as patch:
        kill_at(patch, steps)
        with pytest.raises(Killed):
            train(run, config)
    next_second()


def stage_of(folder: Path | None) -> int:
    assert folder is not None
    stage: int = json.loads((folder / "progress.json").read_text())["stage"]
    return stage


@pytest.mark.parametrize("name", OPTIONS)
def test_a_run_that_was_killed_ends_with_the_same_policy(name, tmp_path, monkeypatch):
    config = configuration(name)
    whole = finished(tmp_path / "whole", config)
    run = tmp_path / "run"
    begin(run, config)
    # Before the first checkpoint, after it, and late: in stages in the first, in the first, and in the second.
    for steps in (300, 600, 1500):
        killed(run, config, monkeypatch, steps)
    assert checkpoint.newest(run) is not None
    assert stage_of(checkpoint.newest(run)) == int(name in STAGED)
    assert train(run, read_config(run))
    assert differences(run, whole) == []


@pytest.mark.parametrize("name", STAGED)
@pytest.mark.parametrize("where", ["transfer", "make_model", "_on_rollout_start", "_on_step"])
def test_a_run_that_was_killed_between_its_stages_ends_with_the_same_policy(name, where, tmp_path, monkeypatch):
    config = configuration(name)
    whole = finished(tmp_path / "whole", config)
    run = tmp_path / "run"
    begin(run, config)
    holder: Any = Monitor if where.startswith("_on") else loop
    original = getattr(holder, where)

    def dying(*arguments: Any, **options: Any) -> Any:
        monitor, *_ = arguments
        # The second stage's first.
        if (
            where == "transfer"
            or getattr(monitor, "task", "") == "residual"
            or (isinstance(monitor, Monitor) and monitor.progress.stage == 1)
        ):
            raise Killed
        return original(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(holder, where, dying)
        with pytest.raises(Killed):
            train(run, config)
    assert stage_of(checkpoint.newest(run)) == 0
    assert len(list(run.glob("checkpoint-*"))) == 2
    next_second()
    assert train(run, config)
    assert differences(run, whole) == []


def test_a_run_that_is_stopped_between_its_stages_keeps_two_checkpoints_and_goes_on(tmp_path, monkeypatch):
    config = configuration("in stages")
    whole = finished(tmp_path / "whole", config)
    run = tmp_path / "run"
    begin(run, config)
    ending = Monitor._on_training_end

    def stopping(self: Monitor) -> None:
        ending(self)
        self.stop.requested = True

    with monkeypatch.context() as patch:
        patch.setattr(Monitor, "_on_training_end", stopping)
        assert not train(run, config)
    assert load_policy(run / "policy.safetensors").output == "torque"
    assert len(list(run.glob("checkpoint-*"))) == 2
    next_second()
    assert train(run, config)
    assert differences(run, whole) == []


def test_a_stage_that_takes_all_steps_leaves_a_policy_of_the_last(tmp_path):
    # A stage ends with a whole rollout, here beyond the run's end.
    config = configuration("in stages", total_steps=701)
    run = finished(tmp_path / "run", config)
    for folder in (run, run / "best"):
        assert load_policy(folder / "policy.safetensors").env_kwargs["controller"] == "baselines:adaptive"
    assert [row["stage"] for row in rows(run / "evaluations.csv")][-1] == "1"


def test_the_stages_of_a_run_share_what_makes_the_network_and_how_it_is_looked_after():
    config = configuration("all", seed=3, hidden=9, torque_limit=1.2, evaluate_every=77, env_threads=2, torch_threads=2)
    direct, last = config.stages()
    assert last is config
    assert isinstance(direct, PPOConfig)
    assert (direct.task, direct.total_steps, direct.direct_steps) == ("direct", 700, 0)
    shared = ("activation", "hidden", "tanh_mean", "output", "seed", "randomization", "torque_limit", "evaluate_every")
    for name in (*shared, "evaluation_episodes", "torch_threads", "env_threads"):
        assert getattr(direct, name) == getattr(config, name), name


@pytest.mark.parametrize(("steps", "total"), [(1000, 1000), (1000, 10)])
def test_a_direct_stage_that_leaves_no_steps_is_refused(steps, total):
    with pytest.raises(ValueError, match=rf"direct_steps must be less than total_steps={total}, .*got {steps}"):
        configuration("in stages", direct_steps=steps, total_steps=total).check()


def test_the_learning_rate_begins_anew_with_a_stage_and_ends_with_the_run():
    config = configuration("in stages", total_steps=1000, learning_rate=1e-2, final_learning_rate=1e-3)
    rate = falling(config)
    assert rate(0.3) == pytest.approx(1e-2)
    assert rate(0.15) == pytest.approx(5.5e-3)
    # The last rollout may go beyond the end.
    assert rate(0.0) == rate(-0.5) == pytest.approx(1e-3)
    assert Falling(1e-2, 1e-3, 1.0)(0.5) == pytest.approx(5.5e-3)


def test_with_another_end_the_learning_rate_falls_to_that(tmp_path, monkeypatch):
    config = configuration("in stages", total_steps=3000)
    run = tmp_path / "run"
    begin(run, config)
    killed(run, config, monkeypatch, 1800)
    shorter = dataclasses.replace(config, total_steps=2000)
    seen = []
    ending = Monitor._on_training_end

    def noting(self: Monitor) -> None:
        seen.append(self.model.learning_rate)
        ending(self)

    monkeypatch.setattr(Monitor, "_on_training_end", noting)
    assert train(run, shorter)
    assert seen == [falling(shorter)] != [falling(config)]


# What goes over.


def stages_of(name: str, **changes: Any) -> tuple[CapsulePPO, CapsulePPO, PPOConfig]:
    """A direct agent that has learnt, and the agent that goes on with it."""
    config = configuration(name, **changes)
    models = []
    for stage in config.stages():
        model = make_model(stage, make_env(stage, 0))
        assert isinstance(model, CapsulePPO)
        models.append(model)
    before, model = models
    before.learn(600)
    with torch.no_grad():
        # Far from a beginning, at which all outputs are about the same.
        before.policy.action_net.weight.mul_(30.0)
    transfer(before, model)
    return before, model, config


def heads(model: CapsulePPO, observations: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Means and values for observations, by name; what is not named is what the agent has seen on average."""
    env: Any = model.get_vec_normalize_env()
    names = env.venv.names
    columns = [observations.get(name, np.full(100, env.obs_rms.mean[i])) for i, name in enumerate(names)]
    inputs = torch.from_numpy(env.normalize_obs(np.stack(columns, axis=1)).astype(np.float32))
    with torch.no_grad():
        return model._distribution(inputs)[0][:, 0].numpy(), model._values(inputs).numpy()


@pytest.mark.parametrize("name", STAGED)
def test_what_goes_on_wants_the_torque_that_the_direct_agent_gave(name):
    before, model, config = stages_of(name)
    assert model.num_timesteps == before.num_timesteps > 0
    # Dropped: the last action, which means another thing.
    with torch.no_grad():
        for net in (before.policy.mlp_extractor.policy_net, before.policy.mlp_extractor.value_net):
            net[0].weight[:, LAST_ACTION] = 0.0
    rng = np.random.default_rng(0)
    sizes = {"theta": 0.8, "theta_dot": 4.0, "x_dot": 0.3}
    seen = {entry: size * rng.normal(size=100) for entry, size in sizes.items()}
    seen |= {"stick": rng.integers(0, 2, 100).astype(float), "law_torque": rng.uniform(-1.5, 1.5, 100)}
    (wanted, value), (found, found_value) = heads(before, seen), heads(model, seen)
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    np.testing.assert_allclose(found_value, value, rtol=1e-4, atol=1e-4)
    assert np.ptp(wanted) > 0.5
    # And so it is the same torque that acts.
    header, limit = model.get_vec_normalize_env().venv.header, config.torque_limit  # type: ignore[union-attr]
    direct = before.get_vec_normalize_env().venv.header  # type: ignore[union-attr]
    for output, law_torque in zip(wanted.tolist(), seen["law_torque"].tolist(), strict=True):
        torque = np.clip(law_torque + config.residual_limit * to_action(header, output, law_torque), -limit, limit)
        assert torque == pytest.approx(limit * to_action(direct, output, 0.0), abs=1e-6)


def test_what_has_not_been_observed_begins_without_weight_and_with_statistics_of_its_own():
    before, model, _ = stages_of("all")
    env: Any = model.get_vec_normalize_env()
    old: Any = before.get_vec_normalize_env()
    new = [i for i, name in enumerate(env.venv.names) if name not in BASE_OBSERVATION or i == LAST_ACTION]
    assert len(new) == 1 + 5 + 4 + 1 + 2
    networks: Any = model.policy.mlp_extractor
    inputs = env.venv.header.inputs
    assert not networks.policy_net[0].weight[:, [i for i in new if i < inputs]].any()
    assert not networks.value_net[0].weight[:, new].any()
    assert model.unseen is not None and np.flatnonzero(model.unseen).tolist() == new
    kept = [0, 1, 2, 3]
    assert env.obs_rms.mean[kept].tolist() == old.obs_rms.mean[kept].tolist()
    model.learn(300, reset_num_timesteps=False)
    assert model.unseen is None
    assert (env.obs_rms.var[new] != 1.0).all()
    assert networks.value_net[0].weight[:, new].any()


def test_the_critic_of_a_direct_stage_may_know_more(monkeypatch):
    told = small("direct", "ppo", privileged_critic=True, identifies=True, **SHORT)
    monkeypatch.setitem(PRESETS, ("direct", "ppo"), told)
    before, model, _ = stages_of("in stages", privileged_critic=True)
    old: Any = before.policy.mlp_extractor
    new: Any = model.policy.mlp_extractor
    assert torch.equal(new.value_net[0].weight[:, -2:], old.value_net[0].weight[:, -2:])
    assert new.policy_net[0].weight.shape[1] == 10


@pytest.mark.parametrize("name", ["critic first", "all"])
def test_first_the_critic_alone_learns(name):
    if name in STAGED:
        _, model, config = stages_of(name)
    else:
        config = configuration(name)
        model = make_model(config, make_env(config, 0))
    policy: Any = model.policy
    hidden = policy.mlp_extractor
    steps = [config.critic_steps // 2, config.critic_steps]
    for n, more in enumerate(steps):
        actor = [*hidden.policy_net.parameters(), *policy.action_net.parameters(), policy.log_std]
        critic = [*hidden.value_net.parameters(), *policy.value_net.parameters()]
        before = [[p.detach().clone() for p in part] for part in (actor, critic)]
        model.learn(more, reset_num_timesteps=False)
        changed = [
            any(map(torch.ne, map(torch.sum, old), map(torch.sum, new)))
            for old, new in zip(before, (actor, critic), strict=True)
        ]
        assert changed == [n == 1, True]


def test_an_archive_holds_what_has_no_statistics_yet(tmp_path):
    _, model, config = stages_of("in stages")
    (tmp_path / "model.zip").write_bytes(archive(model))
    again: Any = unarchive(tmp_path / "model.zip", "ppo", make_env(config, 0))
    assert again.unseen.tolist() == model.unseen.tolist()  # type: ignore[union-attr]


# What is learnt.


@pytest.mark.parametrize("tanh_mean", [False, True])
@pytest.mark.parametrize("name", ["identifies", "privileged critic", "energy weights", "relu"])
def test_the_archive_and_the_file_act_as_one(name, tanh_mean, tmp_path):
    config = configuration(name, tanh_mean=tanh_mean, identifies=False)
    model = make_model(config, make_env(config, 0))
    model.learn(600)
    policy = export("run", model, env_kwargs=config.env_kwargs(), training_seed=0, revision="abc")
    assert policy.squashing == ("tanh" if tanh_mean else "clip")
    (tmp_path / "model.zip").write_bytes(archive(model))
    agent = CapsulePPO.load(tmp_path / "model.zip", device="cpu")
    observations = np.random.default_rng(0).normal(size=(50, 5)).astype(np.float32)
    env: Any = model.get_vec_normalize_env()
    # What the critic alone is told counts for nothing.
    more = np.full((50, env.venv.columns - 5), np.log(config.energy_weight), np.float32)
    wanted, _ = agent.predict(np.hstack([observations, more]), deterministic=True)
    np.testing.assert_allclose(policy(observations), wanted, atol=2e-6)
    assert np.ptp(wanted) > 1e-3


def test_a_run_of_this_kind_learns():
    config = configuration(
        "identifies",
        **{"num_envs": 64, "n_steps": 128, "hidden": 32, "batch_size": 1024, "n_epochs": 6, "learning_rate": 3e-3},
        **{"total_steps": 160_000, "episode_seconds": 6.0, "evaluation_episodes": 8, "privileged_critic": True},
    )
    model = make_model(config, make_env(config, 0))
    speeds = []
    for steps in (1, config.total_steps):
        model.learn(steps)
        policy = export("run", model, env_kwargs=config.env_kwargs(), training_seed=0, revision="abc")
        speeds.append(scores(evaluate(policy, own_draws(config), horizon=300), "mean_speed").mean())
    assert speeds[1] > speeds[0] + 3.0


def test_the_ranges_called_broad_are_around_those_called_wide():
    wide, broad = Randomization.named("wide"), Randomization.named("broad")
    for one, other in ((wide.M, broad.M), (wide.mu, broad.mu)):
        assert one is not None and other is not None
        assert other[0] < one[0] < one[1] < other[1]


def test_the_same_run_on_two_threads(tmp_path):
    config = configuration("all", num_envs=130, n_steps=8, batch_size=104, total_steps=3000, direct_steps=0)
    runs = [finished(tmp_path / str(n), dataclasses.replace(config, env_threads=n)) for n in (1, 2)]
    assert differences(*runs) == []
    assert weights(CapsulePPO.load(runs[0] / "model.zip", device="cpu")).size > 0
