"""The laws for the tasks `goal` and `velocity`: they reach the goal, follow the target and keep
contact."""

import numpy as np
import pytest

from baselines.policies import TASK_SCRIPTED
from capsule_gym import Capsule, CapsuleVectorEnv, Randomization
from capsule_gym.control.laws.gait import FIRST_PULSE, goal_pulses, velocity_pulses
from capsule_gym.core import _core
from capsule_gym.parameters import NOMINAL
from capsule_gym.tasks.task import TORQUE_LIMIT

COUNT = 100
BETWEEN = {
    "capsule": Capsule(static_ratio=1.1),
    "randomization": Randomization(M=(0.45, 0.55), mu=(0.015, 0.07), log_mu=True),
}
PAPER = {"capsule": Capsule(), "randomization": "paper"}


def run(name, steps, floor, options=None):
    """The metrics of episodes of a scripted policy, and the infos of their steps."""
    policy = TASK_SCRIPTED[name]
    env = CapsuleVectorEnv(COUNT, autoreset_mode="DISABLED", **policy.env_kwargs, **floor)
    observations, info = env.reset(seed=3, options=options)
    act = policy.start(range(COUNT))
    infos = [info]
    for _ in range(steps):
        observations, *_, info = env.step(act(observations))
        infos.append(info)
    return env.episode_metrics(), infos


@pytest.mark.parametrize("floor", [{}, BETWEEN])
def test_the_goal_is_reached_from_both_sides_on_every_floor(floor):
    metrics, _ = run("goal-pulses", 750, floor)
    assert metrics["success"].mean() >= 0.99
    assert metrics["failed"].sum() == 0.0
    assert np.median(metrics["goal_time"]) < 3.8


@pytest.mark.parametrize("goal", [0.3, -0.3])
def test_a_platform_at_its_goal_rests_there(goal):
    metrics, infos = run("goal-pulses", 750, {}, {"goal": goal})
    assert metrics["success"].mean() >= 0.99
    assert np.median(abs(infos[-1]["error"])) < 0.002
    # Mirrored, the gait is as fast backwards.
    assert 2.5 < np.median(metrics["goal_time"]) < 4.5


def test_a_smooth_floor_is_crossed_by_strokes():
    metrics, infos = run("goal-pulses", 750, PAPER)
    assert metrics["success"].all()
    assert metrics["failed"].sum() == 0.0
    assert np.median(metrics["goal_time"]) < 4.0
    # The platform rests at the goal before the pendulum does; friction absorbs the pendulum's
    # momentum.
    held = np.array([info["held"] for info in infos])
    states = np.array([info["state"] for info in infos])
    first = np.argmax(held > 0.0, axis=0)
    theta, theta_dot, _, _ = states[first, np.arange(COUNT)].T
    momentum = abs(NOMINAL.m * NOMINAL.l * np.cos(theta) * theta_dot)
    assert np.median(momentum) > 0.02
    assert momentum.max() < 0.15


def test_the_target_is_followed():
    metrics, infos = run("velocity-pulses", 1000, {})
    assert metrics["failed"].sum() == 0.0
    assert metrics["unsettled"].mean() <= 0.01
    assert np.median(metrics["velocity_error"]) < 10.0
    errors = [abs(info["error"]) for info in infos[75:]]
    assert np.mean(errors) < 0.025


@pytest.mark.parametrize("make", [goal_pulses, velocity_pulses])
@pytest.mark.parametrize(
    ("theta", "theta_dot"), [(0.9, 8.0), (-0.9, -8.0), (0.6, 9.0), (0.2, -12.0)]
)
def test_a_fast_pendulum_is_stopped_before_the_end_of_its_range(make, theta, theta_dot):
    controller, p = make(), NOMINAL
    row = (0.0,) * _core.LAWS[controller.law.name][2]
    torque, _ = controller.law(theta, theta_dot, 0.0, 0.0, controller.memory, row)
    # The platform sticks.
    gravity = p.m * p.l * p.g * np.sin(theta)
    theta_ddot = (torque - p.k * theta - p.c * theta_dot + gravity) / (p.m * p.l**2)
    # The stop at 1.25 rad has a reserve of 5 %.
    direction = np.sign(theta_dot)
    room = 1.25 - theta * direction
    assert theta_ddot == pytest.approx(-1.05 * direction * theta_dot**2 / (2.0 * room))


@pytest.mark.parametrize("rate", [0.7, 2.0, 5.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_pulse_is_as_fast_as_the_distance_asks(rate, side):
    law = goal_pulses().law
    mu = 0.08
    error = 0.01
    # Friction stops the platform after a distance proportional to the square of the rate.
    gain = error * mu / rate**2
    phase = FIRST_PULSE[0]
    # A certain estimate, and a pendulum that rests where a pulse starts.
    estimator = (1.0, 0.5, np.log(mu), 1e-4, 0.0, 1e-4, 0.0, 0.0, 0.0)
    memory = (*estimator, phase, -side, 0.0, 0.0, gain, 0.0)
    # The goal stands behind the two numbers of the reference.
    row = (0.0, 0.0, side * error, 0.0, 0.0, 0.0, 0.0, 0.0)
    torque, memory = law(-0.9 * side, 0.0, 0.0, 0.0, memory, row)
    assert memory[10] == side
    assert memory[11] == pytest.approx(rate)
    assert torque == side * TORQUE_LIMIT
