import json
import math

import numpy as np
import pytest

from agents.evaluation import episodes as evaluation
from agents.evaluation.episodes import difference, failures, make_result, scores, summarise
from agents.evaluation.sets import load_set, parse_set
from agents.evaluation.statistics import estimate
from capsule_gym import CapsuleVectorEnv
from capsule_gym.files import to_json
from tests.agents.fakes import PLANTS, Sine, make_policy

TINY = parse_set(PLANTS)


def test_episodes_are_those_of_single_environments():
    policy = Sine(0.5)
    episodes = evaluation.evaluate(policy, TINY, horizon=2.0)
    assert [e["seed"] for e in episodes] == [0, 1, 2]
    assert [e.get("changes", []) for e in episodes] == [p.to_dict()["changes"] for p in TINY.plants]
    for plant, episode in zip(TINY.plants, episodes, strict=True):
        env = CapsuleVectorEnv(1, max_episode_steps=100, randomization="none")
        options = {"M": plant.M, "mu": plant.mu, "changes": [[change.to_dict() for change in plant.changes]]}
        observation, _ = env.reset(seed=[plant.seed], options=options)
        act = policy.start([plant.seed])
        for _ in range(100):
            observation, _, _, truncated, _ = env.step(act(observation))
        assert truncated.all()
        for name, values in env.episode_metrics().items():
            assert episode[name] == values[0], name
    # The jump to a heavier platform on a rougher floor is felt.
    assert episodes[2]["mean_speed"] != episodes[0]["mean_speed"]


def test_an_episode_starts_from_the_angle_that_its_set_says():
    content = {"M": 0.5, "mu": 0.01, "seed": 0}
    chosen = parse_set({"name": "starts", "plants": [content, content | {"theta": 0.0}]})
    rest, upright = evaluation.evaluate(Sine(0.0), chosen, horizon=0.5)
    assert rest["largest_theta"] > 1.0 > upright["largest_theta"] == 0.0
    assert "theta" not in rest and upright["theta"] == 0.0


def test_a_trained_policy_runs_in_compiled_code_with_the_same_bits(monkeypatch):
    policy = make_policy()
    compiled = evaluation.evaluate(policy, TINY, horizon=2.0)
    monkeypatch.setattr("capsule_gym.rollout.rollout", None)

    class Stepped:
        name, env_kwargs, start = policy.name, policy.env_kwargs, policy.start

    assert evaluation.evaluate(Stepped(), TINY, horizon=2.0) == compiled


def test_only_the_first_end_of_an_episode_counts():
    # Full torque swings the ball into the platform at once.
    episodes = evaluation.evaluate(Sine(1.5, period=10.0), TINY, horizon=4.0)
    assert failures(episodes) == 3
    for episode in episodes:
        assert episode["duration"] < 1.0
        assert episode["mean_speed"] == pytest.approx(100.0 * episode["distance"] / 4.0)


def test_what_a_policy_was_trained_with_does_not_change_the_episodes():
    plain = evaluation.evaluate(Sine(0.3), TINY, horizon=1.0)
    kwargs = {"randomization": "wide", "initial_noise": 0.3, "num_envs": 7, "max_episode_steps": 3}
    kwargs |= {"autoreset_mode": "SAME_STEP"}
    assert evaluation.evaluate(Sine(0.3, env_kwargs=kwargs), TINY, horizon=1.0) == plain
    # The agent's step is the policy's own; the episode is as long.
    finer = evaluation.evaluate(Sine(0.3, env_kwargs={"control_dt": 0.01}), TINY, horizon=1.0)
    assert finer[0]["duration"] == pytest.approx(1.0)


def episodes_of(speeds, **fields):
    return [{"M": 0.5, "mu": 0.01, "seed": i, "mean_speed": v, "failed": 0.0, **fields} for i, v in enumerate(speeds)]


def test_summary():
    rng = np.random.default_rng(0)
    speeds = rng.normal(size=(2, 20))
    learned = [e for seed in (0, 1) for e in episodes_of(speeds[seed].tolist(), training_seed=seed)]
    learned[3]["failed"] = 1.0
    summary = summarise(learned)
    assert summary["mean_speed"] == estimate(speeds).to_dict()
    assert (summary["failures"], summary["episodes"]) == (1, 40)
    assert (summary["training_seeds"], summary["resampled"]) == ([0, 1], "seeds")
    assert set(summary) == {"mean_speed", "episodes", "failures", "training_seeds", "resampled"}
    scripted = episodes_of(rng.normal(size=20).tolist())
    assert summarise(scripted)["training_seeds"] == []
    assert difference(learned, scripted, "mean_speed").resampled == "seeds"


def test_results_are_strict_json_and_survive_it():
    episodes = episodes_of([1.0, 2.0], cost_of_transport=math.inf)
    text = to_json(make_result("x", TINY, episodes))
    result = json.loads(text, parse_constant=lambda name: pytest.fail(name))
    assert set(result) == {"policy", "set", "set_hash", "versions", "episodes", "summary"}
    assert (result["set"], result["set_hash"]) == ("tiny", TINY.hash)
    assert result["versions"]["numpy"] == np.__version__
    assert result["summary"]["cost_of_transport"] == {"iqm": None, "low": None, "high": None}
    np.testing.assert_array_equal(scores(result["episodes"], "cost_of_transport"), [[math.inf, math.inf]])


def test_frozen_sets_are_accepted_by_the_environment():
    for name in ("nominal", "extrapolation", "drift"):
        episodes = evaluation.evaluate(Sine(0.2), load_set(name), horizon=0.1)
        assert all(math.isfinite(e["mean_speed"]) for e in episodes)
