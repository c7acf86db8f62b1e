import math

import pytest

from capsule_gym import Capsule, CapsuleVectorEnv
from capsule_gym.evaluation.episodes import (
    SHARE_OF_OPTIMUM,
    TABLE_METRICS,
    TableMetric,
    evaluate,
    failures,
)
from capsule_gym.evaluation.optimum import optimal_speed
from capsule_gym.evaluation.sets import parse_set
from capsule_gym.tasks.task import METRICS
from tests.agents.fakes import PLANTS, Sine

TINY = parse_set(PLANTS)
SPEED = TableMetric("speed", "speed (cm/s)", 2)


def test_episodes_equal_those_of_single_environments():
    policy = Sine(0.5)
    episodes = evaluate(policy, TINY, horizon=2.0)
    assert [e["seed"] for e in episodes] == [0, 1, 2]
    assert [e.get("changes", []) for e in episodes] == [p.to_dict()["changes"] for p in TINY.plants]
    for plant, episode in zip(TINY.plants, episodes, strict=True):
        env = CapsuleVectorEnv(1, max_episode_steps=100, randomization="none")
        options = {"M": plant.M, "mu": plant.mu, "changes": [plant.reset_options()["changes"]]}
        observation, _ = env.reset(seed=[plant.seed], options=options)
        act = policy.start([plant.seed])
        for _ in range(100):
            observation, _, _, truncated, _ = env.step(act(observation))
        assert truncated.all()
        for name, values in env.episode_metrics().items():
            assert episode[name] == values[0], name
    # The change to a heavier platform and a rougher floor has an effect.
    assert episodes[2]["mean_speed"] != episodes[0]["mean_speed"]


def test_episodes_start_at_the_angle_of_the_set_and_end_early_where_they_fail():
    content = {"M": 0.5, "mu": 0.01, "seed": 0}
    chosen = parse_set({"name": "starts", "plants": [content, content | {"theta": 0.0}]})
    rest, upright = evaluate(Sine(0.0), chosen, horizon=0.5)
    assert rest["largest_theta"] > 1.0 > upright["largest_theta"] == 0.0
    assert "theta" not in rest and upright["theta"] == 0.0
    # Full torque swings the ball into the platform at once.
    episodes = evaluate(Sine(1.5, period=10.0), TINY, horizon=4.0)
    assert failures(episodes) == 3
    for episode in episodes:
        assert episode["duration"] < 1.0 and episode["mean_speed"] == pytest.approx(
            100.0 * episode["distance"] / 4.0
        )


def test_training_settings_do_not_change_the_episodes():
    plain = evaluate(Sine(0.3), TINY, horizon=1.0)
    kwargs = {"randomization": "wide", "initial_noise": 0.3, "num_envs": 7, "max_episode_steps": 3}
    kwargs |= {"autoreset_mode": "SAME_STEP"}
    assert evaluate(Sine(0.3, env_kwargs=kwargs), TINY, horizon=1.0) == plain
    # Nor does an observation of M and mu that the environment shows of no plant by default.
    change, shows = {"t": 0.1, "M": 4.0, "mu": 2.0}, {"observe_parameters": True}
    heavy = parse_set(
        {"name": "x", "plants": [{"M": 3.0, "mu": 1.5, "seed": 0, "changes": [change]}]}
    )
    assert evaluate(Sine(0.3, env_kwargs=shows), heavy, horizon=0.2) == evaluate(
        Sine(0.3), heavy, horizon=0.2
    )
    # The policy determines the control interval; the duration of the episode stays the same.
    assert evaluate(Sine(0.3, env_kwargs={"control_dt": 0.01}), TINY, horizon=1.0)[0][
        "duration"
    ] == pytest.approx(1.0)


def test_shares_of_the_optimum_stand_where_it_is_known():
    known = {"M": 0.5, "mu": 0.01, "seed": 0}
    content = {"name": "x", "plants": [known]}
    (episode,) = evaluate(Sine(0.3), parse_set(content), horizon=0.2)
    assert episode["share_of_optimum"] == episode["mean_speed"] / optimal_speed(0.5, 0.01)
    (episode,) = evaluate(
        Sine(0.3, env_kwargs={"torque_limit": 1.0}), parse_set(content), horizon=0.2
    )
    assert "share_of_optimum" not in episode
    for change in ({"mu": 0.6}, {"theta": 0.0}, {"changes": [{"t": 0.3, "M": 0.5, "mu": 0.02}]}):
        unknown = parse_set({"name": "x", "plants": [known, known | change]})
        assert not any(
            "share_of_optimum" in each for each in evaluate(Sine(0.3), unknown, horizon=0.02)
        )


def test_numbers_in_tables():
    values = (1.234, -1.235, -0.001, None, math.inf, math.nan)
    assert [SPEED.format(value) for value in values] == ["1.23", "-1.24", "0.00", "-", "-", "-"]
    assert [SPEED.format(value, sign=True) for value in (1.234, -0.001)] == ["+1.23", "0.00"]
    assert SPEED.with_interval((1.0, -0.5, None), sign=True) == "+1.00 [-0.50,\N{NO-BREAK SPACE}-]"
    assert SPEED.with_interval((1.0, None, None)) == "1.00"
    assert set(TABLE_METRICS) <= set(METRICS) and SHARE_OF_OPTIMUM.name not in METRICS


def test_a_set_says_which_capsule_its_episodes_have():
    content = {
        "name": "x",
        "task": "goal",
        "plants": [{"M": 0.5, "mu": 0.2, "seed": 0, "goal": 0.3}],
    }
    capsules = {"task": None, "nominal": Capsule(), "sticky": Capsule(static_ratio=1.3)}
    kwargs = {
        name: {"task": "goal"} | ({"capsule": capsule} if capsule else {})
        for name, capsule in capsules.items()
    }
    found = [
        [
            evaluate(Sine(0.6, env_kwargs=own), parse_set(chosen), horizon=2.0)
            for own in kwargs.values()
        ]
        for chosen in (
            content,
            {**content, "capsule": {"static_ratio": 1.3}},
            {**content, "capsule": {}},
        )
    ]
    of_task, sticky, nominal = (each[0] for each in found)
    assert all(each == first for first, *others in found for each in others)
    assert of_task == sticky and 0.0 < nominal[0]["stuck_fraction"] < sticky[0]["stuck_fraction"]
