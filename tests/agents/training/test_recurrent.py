"""A policy with a memory: the LSTM in one call, and evaluations that hand its state on."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("sb3_contrib", exc_type=ImportError)

import torch
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy

from agents.evaluation.episodes import evaluate
from agents.training.loop import begin, make_env, make_model, train
from agents.training.recurrent import RecurrentActorCritic, load_best, present_policy
from capsule_gym import load_policy
from capsule_gym.evaluation_sets import EvaluationSet, PlantSpec
from capsule_gym.files import to_json
from tests.agents.training.small import small

PLANTS = EvaluationSet("two", (PlantSpec(M=0.5, mu=0.01, seed=0), PlantSpec(M=0.46, mu=0.01, seed=1)))


@pytest.mark.parametrize("length", [1, 7])
@pytest.mark.parametrize("begun", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0)])
def test_the_lstm_in_one_call_is_the_lstm_step_by_step(length, begun):
    torch.manual_seed(0)
    lstm = torch.nn.LSTM(5, 4)
    starts = torch.zeros(3, length)
    starts[:, 0] = torch.tensor(begun)
    states = (torch.randn(1, 3, 4), torch.randn(1, 3, 4))
    given = (torch.randn(3 * length, 5), states, starts.flatten(), lstm)
    outputs, after = RecurrentActorCritic._process_sequence(*given)
    wanted, wanted_after = RecurrentActorCriticPolicy._process_sequence(*given)
    torch.testing.assert_close(outputs, wanted)
    torch.testing.assert_close(after, wanted_after)


def test_an_episode_that_begins_within_a_sequence_is_refused():
    states = (torch.zeros(1, 1, 4), torch.zeros(1, 1, 4))
    given = (torch.zeros(2, 5), states, torch.tensor([0.0, 1.0]), torch.nn.LSTM(5, 4))
    with pytest.raises(AssertionError, match="begin with a sequence"):
        RecurrentActorCritic._process_sequence(*given)


def test_the_saved_policy_is_the_one_that_was_evaluated(tmp_path):
    run, config = tmp_path / "run", small("direct", "recurrent-ppo", total_steps=512, evaluate_every=512)
    begin(run, config)
    assert train(run, config)
    # Its memory has no place in a policy file.
    assert not list(run.rglob("policy.safetensors"))
    with pytest.raises(ValueError, match="policy"):
        load_policy(run)
    policy = load_best(run)
    assert dict(policy.env_kwargs) == config.env_kwargs()
    first, again = (to_json(evaluate(policy, PLANTS, horizon=0.5)) for _ in range(2))
    assert first == again


def test_it_remembers_within_an_episode_and_normalises():
    config = small("direct", "recurrent-ppo")
    env = make_env(config, 0)
    env.obs_rms.mean[:], env.obs_rms.var[:] = 0.3, 4.0
    model = make_model(config, env)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    act = present_policy("present", model, config.env_kwargs()).start([0, 1])
    observations = np.random.default_rng(0).normal(size=(2, 5)).astype(np.float32)
    first, second = act(observations), act(observations)
    assert np.abs(first - second).min() > 1e-4
    begun = np.ones(2, bool)
    wanted, state = model.predict(env.normalize_obs(observations), episode_start=begun, deterministic=True)
    assert np.array_equal(first, wanted)
    wanted, _ = model.predict(env.normalize_obs(observations), state, ~begun, deterministic=True)
    assert np.array_equal(second, wanted)
    env.close()
