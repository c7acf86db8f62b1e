import numpy as np
import pytest
import torch
from stable_baselines3 import SAC

from agents.training.loop import make_env, make_model
from agents.training.sac import LeanSAC
from tests.agents.training.small import small, weights


def test_lean_sac_makes_the_updates_of_sb3():
    results = []
    for kind in (SAC, LeanSAC):
        config = small("residual", "sac", learning_starts=400)
        env = make_env(config, 0)
        model = make_model(config, env, sac=kind, fused=False)
        # Too few steps for an update: both hold the same transitions and the same networks.
        model.learn(400)
        np.random.seed(0)
        torch.manual_seed(0)
        before = weights(model)
        for _ in range(10):
            model.train(1, 64)
        entropy = model.log_ent_coef.item()
        losses = {name: value for name, value in model.logger.name_to_value.items() if name.startswith("train/")}
        results.append((weights(model), entropy, losses))
        assert not np.array_equal(before, results[-1][0])
        env.close()
    (expected, entropy, losses), (found, own_entropy, own_losses) = results
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    assert own_entropy == pytest.approx(entropy, rel=1e-5)
    assert own_losses == pytest.approx(losses, rel=1e-3, abs=1e-6)


def test_lean_sac_draws_a_batch_of_its_own_for_each_update(monkeypatch):
    config = small("residual", "sac", learning_starts=400)
    env = make_env(config, 0)
    model = make_model(config, env)
    model.learn(400)
    sizes, batches = [], []
    draw = model.replay_buffer.sample
    monkeypatch.setattr(model.replay_buffer, "sample", lambda size, env: sizes.append(size) or draw(size, env=env))
    sample = LeanSAC.train.__globals__["sample"]
    monkeypatch.setattr(
        "agents.training.sac.sample", lambda actor, seen: batches.append(seen.numpy()) or sample(actor, seen)
    )
    model.train(3, 16)
    assert sizes == [48]
    assert [batch.shape for batch in batches] == [(16, 10)] * 6
    assert len({batch.tobytes() for batch in batches}) == 6
    env.close()
