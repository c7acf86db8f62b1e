import math
from types import SimpleNamespace

import numpy as np
import pytest

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv
from capsule_gym.evaluation.episodes import (
    SHARE_OF_OPTIMUM,
    TABLE_METRICS,
    TableMetric,
    drawn_like,
    evaluate,
    failures,
    summarise,
    validation_set,
)
from capsule_gym.evaluation.optimum import optimal_speed
from capsule_gym.evaluation.sets import load_set, parse_set
from capsule_gym.evaluation.statistics import estimate
from capsule_gym.tasks.task import METRICS
from tests.agents.fakes import PLANTS, Sine
from tests.capsule_gym.evaluation.test_sets import plant, spec

TINY = parse_set(PLANTS)
SPEED = TableMetric("speed", "speed (cm/s)", 2)


def test_episodes_equal_those_of_single_environments():
    policy = Sine(0.5)
    episodes = evaluate(policy, TINY, horizon=2.0)
    assert [each["seed"] for each in episodes] == [0, 1, 2]
    for each, episode in zip(TINY.plants, episodes, strict=True):
        assert episode.get("changes", []) == each.to_dict()["changes"]
        env = CapsuleVectorEnv(1, max_episode_steps=100, randomization="none")
        options = {"M": each.M, "mu": each.mu, "changes": [each.reset_options()["changes"]]}
        observation, _ = env.reset(seed=[each.seed], options=options)
        act = policy.start([each.seed])
        for _ in range(100):
            observation, _, _, truncated, _ = env.step(act(observation))
        assert truncated.all()
        for name, values in env.episode_metrics().items():
            assert episode[name] == values[0], name
    # The change to a heavier platform and a rougher floor has an effect.
    assert episodes[2]["mean_speed"] != episodes[0]["mean_speed"]


def test_episodes_start_at_the_angle_of_the_set():
    chosen = parse_set({"name": "starts", "plants": [spec(), spec(theta=0.0)]})
    rest, upright = evaluate(Sine(0.0), chosen, horizon=0.5)
    assert rest["largest_theta"] > 1.0 > upright["largest_theta"] == 0.0
    assert "theta" not in rest
    assert upright["theta"] == 0.0


def test_episodes_end_early_where_they_fail():
    # Full torque swings the ball into the platform at once.
    episodes = evaluate(Sine(1.5, period=10.0), TINY, horizon=4.0)
    assert failures(episodes) == 3
    for episode in episodes:
        assert episode["duration"] < 1.0
        assert episode["mean_speed"] == pytest.approx(100.0 * episode["distance"] / 4.0)


def test_training_settings_do_not_change_the_episodes():
    kwargs = {
        "randomization": "wide",
        "initial_noise": 0.3,
        "num_envs": 7,
        "max_episode_steps": 3,
        "autoreset_mode": "SAME_STEP",
    }
    trained = evaluate(Sine(0.3, env_kwargs=kwargs), TINY, horizon=1.0)
    assert trained == evaluate(Sine(0.3), TINY, horizon=1.0)


def test_an_observation_of_rare_plants_does_not_change_the_episodes():
    # The environment shows such M and mu of no plant by default.
    change = {"t": 0.1, "M": 4.0, "mu": 2.0}
    heavy = parse_set(plant(M=3.0, mu=1.5, changes=[change]))
    observing = Sine(0.3, env_kwargs={"observe_parameters": True})
    assert evaluate(observing, heavy, horizon=0.2) == evaluate(Sine(0.3), heavy, horizon=0.2)


def test_the_control_interval_of_a_policy_does_not_change_the_duration():
    episodes = evaluate(Sine(0.3, env_kwargs={"control_dt": 0.01}), TINY, horizon=1.0)
    assert episodes[0]["duration"] == pytest.approx(1.0)


def test_episodes_have_their_share_of_the_optimum():
    (episode,) = evaluate(Sine(0.3), parse_set(plant()), horizon=0.2)
    assert episode["share_of_optimum"] == episode["mean_speed"] / optimal_speed(0.5, 0.01)


def test_another_torque_limit_has_no_share_of_the_optimum():
    weak = Sine(0.3, env_kwargs={"torque_limit": 1.0})
    (episode,) = evaluate(weak, parse_set(plant()), horizon=0.2)
    assert "share_of_optimum" not in episode


@pytest.mark.parametrize(
    "fields", [{"mu": 0.6}, {"theta": 0.0}, {"changes": [{"t": 0.3, "M": 0.5, "mu": 0.02}]}]
)
def test_a_set_with_an_unsolved_plant_has_no_shares_of_the_optimum(fields):
    unknown = parse_set({"name": "x", "plants": [spec(), spec(**fields)]})
    for episode in evaluate(Sine(0.3), unknown, horizon=0.02):
        assert "share_of_optimum" not in episode


@pytest.mark.parametrize(
    ("value", "sign", "text"),
    [
        (1.234, False, "1.23"),
        (-1.235, False, "-1.24"),
        (-0.001, False, "0.00"),
        (None, False, "-"),
        (math.inf, False, "-"),
        (math.nan, False, "-"),
        (1.234, True, "+1.23"),
        (-0.001, True, "0.00"),
    ],
)
def test_a_number_in_tables(value, sign, text):
    assert SPEED.format(value, sign=sign) == text


def test_an_interval_in_tables():
    assert SPEED.with_interval((1.0, -0.5, None), sign=True) == "+1.00 [-0.50,\N{NO-BREAK SPACE}-]"
    assert SPEED.with_interval((1.0, None, None)) == "1.00"


def test_tables_show_metrics():
    assert set(TABLE_METRICS) <= set(METRICS)
    assert SHARE_OF_OPTIMUM.name not in METRICS


def test_the_seed_of_an_episode_determines_its_disturbances():
    pushed = {
        "name": "x",
        "plants": [spec(mu=0.1, seed=seed) for seed in (4, 4, 5)],
        "disturbances": {"push": 3.0},
    }
    one, same, other = evaluate(Sine(0.0), parse_set(pushed), horizon=2.0)
    assert one == same
    assert one["distance"] != other["distance"]


def test_a_validation_set_has_the_plants_that_the_environment_draws():
    drawn = validation_set("real-wide", "x", 7, 3)
    env = CapsuleEnv(randomization="real-wide")
    for seed, found in zip((7, 8, 9), drawn.plants, strict=True):
        _, info = env.reset(seed=seed)
        assert (found.seed, found.M, found.mu) == (seed, info["M"], info["mu"])
        assert found.capsule == {name: pytest.approx(info["capsule"][name]) for name in "mlkc"}
    assert validation_set("wide", "x", 7, 1).plants[0].capsule is None


def test_plants_drawn_like_those_of_a_set_have_its_disturbances():
    assert drawn_like("real", 7, 1).disturbances == load_set("real").disturbances == "real"


SCORES = np.array([[1.0, 2.0, 3.0, 8.0], [2.0, 3.0, 4.0, 9.0], [0.0, 1.0, 7.0, 2.0]])


def test_a_summary_has_means_with_intervals_counts_and_training_seeds():
    episodes = [
        {
            "M": 0.5,
            "seed": n,
            "failed": float(score == 9.0),
            "mean_speed": score,
            "success": float(score > 1.0),
            "training_seed": training_seed,
        }
        for training_seed, row in zip((3, 1, 4), SCORES, strict=True)
        for n, score in enumerate(row)
    ]
    summary = summarise(episodes)
    assert summary.keys() == {"mean_speed", "success", "episodes", "failures", "training_seeds"}
    counts = (summary["episodes"], summary["failures"], summary["training_seeds"])
    assert counts == (12, 1, [3, 1, 4])
    speed = summary["mean_speed"]
    mean = estimate(SCORES, mean=True)
    middle = estimate(SCORES)
    assert (speed["iqm"], speed["low"], speed["high"]) == (middle.value, middle.low, middle.high)
    assert (speed["mean"], speed["mean_low"], speed["mean_high"]) == (3.5, mean.low, mean.high)
    assert speed["seeds"] == [3.5, 4.5, 2.5]
    # A trimmed mean would hide a few misses.
    assert summary["success"]["mean"] == 0.75
    assert "iqm" not in summary["success"]


def test_a_single_episode_of_a_scripted_policy_has_a_summary():
    summary = summarise([{"seed": 0, "failed": 0.0, "mean_speed": 2.0}])
    assert summary["mean_speed"]["iqm"] == 2.0
    assert summary["training_seeds"] == []


GOAL = {"name": "x", "task": "goal", "plants": [spec(mu=0.2, goal=0.3)]}
STICKY = GOAL | {"capsule": {"static_ratio": 1.3}}
NOMINAL = GOAL | {"capsule": {}}


@pytest.mark.parametrize("content", [GOAL, STICKY, NOMINAL])
@pytest.mark.parametrize("capsule", [Capsule(), Capsule(static_ratio=1.3)])
def test_the_capsule_of_a_policy_does_not_change_the_episodes(content, capsule):
    chosen = parse_set(content)
    policy = Sine(0.6, env_kwargs={"task": "goal"})
    other = Sine(0.6, env_kwargs={"task": "goal", "capsule": capsule})
    assert evaluate(other, chosen, horizon=2.0) == evaluate(policy, chosen, horizon=2.0)


def test_the_task_of_the_caller_may_be_that_of_the_set():
    goals = parse_set(GOAL)
    start = Sine(0.6).start
    policy = SimpleNamespace(start=start)
    given = evaluate(policy, goals, env_kwargs={"task": "goal"}, horizon=0.2)
    assert given[0]["goal_time"] == pytest.approx(0.2)
    with pytest.raises(ValueError, match="policy must be for the task 'goal'"):
        evaluate(policy, goals, env_kwargs={"task": "velocity"})


def test_a_set_without_a_capsule_has_that_of_its_task():
    policy = Sine(0.6, env_kwargs={"task": "goal"})
    of_task, sticky, nominal = (
        evaluate(policy, parse_set(content), horizon=2.0) for content in (GOAL, STICKY, NOMINAL)
    )
    assert of_task == sticky
    assert 0.0 < nominal[0]["stuck_fraction"] < sticky[0]["stuck_fraction"]
