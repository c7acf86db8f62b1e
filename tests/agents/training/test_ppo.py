"""The compiled update is SB3's: the same parameters, moments of Adam and logged losses, for every kind of agent."""

from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure

from agents.fast_ppo.ppo import FastPolicy, FastPPO
from agents.training.algorithms import FastTanh, make_env, make_model
from agents.training.export import export
from tests.agents.training.small import small, weights

EPOCHS = 2
RATE = 1e-3


def agent(samples: int = 250, inputs: int = 7, policy_inputs: int = 7, batch_size: int = 96, **changes: Any) -> FastPPO:
    """An agent with a rollout; the same arguments give the same agent."""
    of_policy = {"net_arch": [13, 6], "activation_fn": FastTanh, "tanh_mean": False, "least_log_std": -20.0}
    of_policy = {name: changes.pop(name, value) for name, value in of_policy.items()}
    options = {"ent_coef": 0.01, "n_epochs": EPOCHS, "learning_rate": RATE, "seed": 3, "device": "cpu", **changes}
    of_policy |= {"policy_inputs": policy_inputs, "log_std_init": -0.5, "optimizer_kwargs": {"eps": 1e-5}}
    model = FastPPO(
        FastPolicy,
        None,
        n_steps=samples,
        batch_size=batch_size,
        policy_kwargs=of_policy,
        _init_setup_model=False,
        **options,
    )
    model.observation_space = spaces.Box(-np.inf, np.inf, (inputs,), np.float32)
    model.action_space, model.n_envs = spaces.Box(-1.0, 1.0, (1,), np.float32), 1
    model._setup_model()
    model.set_logger(configure(None, []))
    give_rollout(model)
    return model


def give_rollout(model: FastPPO) -> None:
    """Fills the buffer with samples whose probability ratios lie below, within and above the clipping range."""
    random, buffer = np.random.default_rng(5), model.rollout_buffer

    def normal(*shape: int) -> np.ndarray:
        return random.normal(size=shape).astype(np.float32)

    count = model.n_steps
    buffer.observations, buffer.actions = normal(*buffer.observations.shape), normal(count, 1, 1)
    with torch.no_grad():
        observations, actions = (torch.from_numpy(each[:, 0]) for each in (buffer.observations, buffer.actions))
        _, log_prob, _ = model.policy.evaluate_actions(observations, actions)
    buffer.log_probs = log_prob.numpy()[:, None] + 0.3 * normal(count, 1)
    buffer.advantages, buffer.values, buffer.returns = (normal(count, 1) for _ in range(3))
    buffer.full = True


def train_by_sb3(model: FastPPO, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs SB3's update with the same minibatches."""
    with monkeypatch.context() as patch:
        patch.setattr(np.random, "permutation", lambda count: torch.randperm(count).numpy())
        PPO.train(model)


def moments(model: FastPPO, name: str) -> np.ndarray:
    """A moment of Adam for all parameters."""
    state = model.policy.optimizer.state
    return np.concatenate([state[parameter][name].numpy().ravel() for parameter in model.policy.parameters()])


AGENTS = {
    "odd widths": {"net_arch": [9, 7, 5]},
    "no hidden layer": {"net_arch": []},
    "privileged critic, tanh of the mean": {"inputs": 9, "policy_inputs": 4, "tanh_mean": True},
    "wide": {"net_arch": [64, 64], "inputs": 5, "policy_inputs": 5, "samples": 4096, "batch_size": 2048},
    "minibatches of one and of whole lanes": {"samples": 257, "batch_size": 128},
    "log_std below its floor": {"least_log_std": 0.0},
    "gradients clipped to nearly nothing": {"max_grad_norm": 1e-4},
    "other weights": {"ent_coef": 0.3, "vf_coef": 2.0, "clip_range": 0.05, "max_grad_norm": 1e4},
}


@pytest.mark.parametrize("changes", AGENTS.values(), ids=AGENTS)
def test_an_update_is_that_of_stable_baselines(changes, monkeypatch):
    ours, theirs = agent(**changes), agent(**changes)
    before = weights(ours)
    # The second update continues with the moments of the first.
    for _ in range(2):
        torch.manual_seed(1)
        ours.train()
        torch.manual_seed(1)
        train_by_sb3(theirs, monkeypatch)
        logged, expected = ours.logger.name_to_value, theirs.logger.name_to_value
        for name in ("policy_gradient_loss", "value_loss", "entropy_loss", "clip_fraction"):
            assert logged[f"train/{name}"] == pytest.approx(expected[f"train/{name}"], rel=1e-4, abs=1e-6)
    assert 0.0 < logged["train/clip_fraction"] < 1.0
    assert logged["train/n_updates"] == expected["train/n_updates"] == 2 * EPOCHS
    assert np.abs(weights(ours) - before).max() > RATE
    np.testing.assert_allclose(weights(ours), weights(theirs), rtol=1e-5, atol=1e-3 * RATE)
    for name in ("exp_avg", "exp_avg_sq"):
        found, right = moments(ours, name), moments(theirs, name)
        np.testing.assert_allclose(found, right, rtol=1e-4, atol=1e-5 * np.abs(right).max())
    np.testing.assert_array_equal(moments(ours, "step"), moments(theirs, "step"))


def test_torch_goes_on_from_a_compiled_update(monkeypatch):
    ours, theirs = agent(), agent()
    torch.manual_seed(1)
    ours.train()
    train_by_sb3(ours, monkeypatch)
    torch.manual_seed(1)
    train_by_sb3(theirs, monkeypatch)
    train_by_sb3(theirs, monkeypatch)
    np.testing.assert_allclose(weights(ours), weights(theirs), rtol=1e-5, atol=1e-3 * RATE)


def test_the_divergence_is_that_of_stable_baselines(monkeypatch):
    # SB3 logs the divergence of the last epoch, FastPPO the mean of all epochs.
    ours, theirs = agent(n_epochs=1), agent(n_epochs=1)
    torch.manual_seed(1)
    ours.train()
    torch.manual_seed(1)
    train_by_sb3(theirs, monkeypatch)
    found, expected = (model.logger.name_to_value["train/approx_kl"] for model in (ours, theirs))
    assert found == pytest.approx(expected, rel=1e-5)


def test_below_its_floor_the_standard_deviation_is_not_trained():
    model = agent(least_log_std=0.0)
    model.train()
    assert model.policy.log_std.item() == -0.5
    assert not model.policy.optimizer.state[model.policy.log_std]["exp_avg"].any()


def test_first_only_the_critic_learns():
    config = small("direct", "ppo", critic_steps=600, episode_seconds=0.4)
    model: Any = make_model(config, make_env(config, 0))
    hidden = model.policy.mlp_extractor
    for learns, steps in ((False, 300), (True, 600)):
        actor = [*hidden.policy_net.parameters(), *model.policy.action_net.parameters(), model.policy.log_std]
        critic = [*hidden.value_net.parameters(), *model.policy.value_net.parameters()]
        before = [torch.nn.utils.parameters_to_vector(part).detach().clone() for part in (actor, critic)]
        model.learn(steps, reset_num_timesteps=False)
        after = [torch.nn.utils.parameters_to_vector(part) for part in (actor, critic)]
        assert [not torch.equal(*pair) for pair in zip(before, after, strict=True)] == [learns, True]


@pytest.mark.parametrize("tanh_mean", [False, True])
def test_the_policy_file_of_every_option_acts_as_the_agent(tanh_mean):
    options = {"energy_weights": (0.1, 10.0), "privileged_critic": True, "randomization": "broad"}
    config = small("direct", "ppo", tanh_mean=tanh_mean, episode_seconds=0.4, **options)
    env = make_env(config, 0)
    model: Any = make_model(config, env)
    model.learn(600)
    policy = export("run", model, config, "abc")
    assert policy.squashing == ("tanh" if tanh_mean else "clip")
    observations = np.random.default_rng(0).normal(size=(50, 5)).astype(np.float32)
    # The inputs that only the critic receives do not affect the action.
    further = np.full((50, 3), np.log(config.energy_weight), np.float32)
    expected, _ = model.predict(env.normalize_obs(np.hstack([observations, further])), deterministic=True)
    np.testing.assert_allclose(policy(observations), expected, atol=2e-6)
    assert np.ptp(expected) > 1e-3
