"""The laws for the tasks `goal` and `velocity`: they reach the goal, follow the target and keep
contact."""

import numpy as np
import pytest

from baselines.policies import TASK_SCRIPTED
from capsule_gym import Capsule, CapsuleVectorEnv, Randomization
from capsule_gym.control.laws.gait import goal_pulses, velocity_pulses
from capsule_gym.core import _core
from capsule_gym.parameters import NOMINAL

PAPER = {"capsule": Capsule(), "randomization": "paper"}
BETWEEN = Randomization(M=(0.45, 0.55), mu=(0.015, 0.07), log_mu=True)


def run(name, steps, floor=None, **options):
    policy, count = TASK_SCRIPTED[name], 100
    env = CapsuleVectorEnv(count, autoreset_mode="DISABLED", **policy.env_kwargs, **(floor or {}))
    observations, first = env.reset(seed=3, options=options or None)
    act, seen = policy.start(range(count)), [first]
    for _ in range(steps):
        observations, *_, info = env.step(act(observations))
        seen.append(info)
    return env, seen


@pytest.mark.parametrize(
    "floor", [{}, {"capsule": Capsule(static_ratio=1.1), "randomization": BETWEEN}]
)
def test_the_goal_is_reached_from_both_sides_on_every_floor(floor):
    metrics = run("goal-pulses", 750, floor)[0].episode_metrics()
    assert metrics["success"].mean() >= 0.99 and metrics["failed"].sum() == 0.0
    assert np.median(metrics["goal_time"]) < 3.8


@pytest.mark.parametrize("goal", [0.3, -0.3])
def test_a_platform_at_its_goal_rests_there(goal):
    env, seen = run("goal-pulses", 750, goal=goal)
    assert (
        env.episode_metrics()["success"].mean() >= 0.99
        and np.median(abs(seen[-1]["error"])) < 0.002
    )
    # Mirrored, the gait is as fast backwards.
    assert 2.5 < np.median(env.episode_metrics()["goal_time"]) < 4.5


def test_a_smooth_floor_is_crossed_by_strokes():
    env, seen = run("goal-pulses", 750, PAPER)
    metrics = env.episode_metrics()
    assert (
        metrics["success"].all()
        and metrics["failed"].sum() == 0.0
        and np.median(metrics["goal_time"]) < 4.0
    )
    # The platform rests at the goal before the pendulum does; friction absorbs the pendulum's
    # momentum.
    first = [next(info for info in seen if info["held"][n] > 0.0)["state"][n] for n in range(100)]
    momentum = [abs(0.138 * 0.3 * np.cos(theta) * rate) for theta, rate, *_ in first]
    assert 0.02 < np.median(momentum) and max(momentum) < 0.15


def test_the_target_is_followed():
    env, seen = run("velocity-pulses", 1000)
    metrics = env.episode_metrics()
    assert metrics["failed"].sum() == 0.0 and metrics["unsettled"].mean() <= 0.01
    errors = [abs(info["error"]) for info in seen[75:]]
    assert np.median(metrics["velocity_error"]) < 10.0 and np.mean(errors) < 0.025


@pytest.mark.parametrize("make", [goal_pulses, velocity_pulses])
def test_a_fast_pendulum_is_stopped_before_the_end_of_its_range(make):
    controller, p = make(), NOMINAL
    reference = (0.0,) * _core.LAWS[controller.law.name][2]
    for theta, rate in ((0.9, 8.0), (-0.9, -8.0), (0.6, 9.0), (0.2, -12.0)):
        torque, _ = controller.law(theta, rate, 0.0, 0.0, controller.memory, reference)
        # The platform sticks; the stop at 1.25 rad has a reserve of 5 %.
        theta_ddot = (torque - p.k * theta - p.c * rate + p.m * p.l * p.g * np.sin(theta)) / (
            p.m * p.l**2
        )
        room = 1.25 - theta * np.sign(rate)
        assert theta_ddot == pytest.approx(-1.05 * np.sign(rate) * rate**2 / (2.0 * room))
