import sys

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, Controller
from capsule_gym.core import _core
from capsule_gym.envs.env import shown_state
from capsule_gym.envs.resets import random_stream
from capsule_gym.tasks.registry import TASKS, find_task
from capsule_gym.tasks.task import Task
from capsule_gym.tasks.velocity import with_commands

NO_TORQUE = np.zeros(1, np.float32)
CONTROL_DT = 0.02
SEEDS = [2**64 + 3, 1, 2, 3, 4]
EACH_TASK = pytest.mark.parametrize("name", [name for name in TASKS if name != "speed"])
COMMANDS = [{"t": 0.1 * n, "v": 0.05 - 0.01 * n} for n in range(8)]
# Options of a reset, the entry of `info` that shows them, and its value.
OPTIONS = {
    "goal": ({"goal": -0.2}, "goal", -0.2),
    "velocity": ({"commands": COMMANDS}, "command", 0.05),
}
# What the page of a task says of its draws: low, high, and whether of either sign.
DRAWS = {"goal": {(0.05, 0.5, True)}, "velocity": {(-0.1, 0.1, False), (4.0, 8.0, False)}}


@EACH_TASK
@pytest.mark.parametrize("episode", range(3))
def test_an_episode_draws_numpys_numbers(name, episode):
    draws = _core.TASKS[name].draws
    batch = CapsuleVectorEnv(len(SEEDS), task=name)
    batch.reset(seed=SEEDS)
    for _ in range(episode):
        batch.reset()
    end = batch.simulation.layout.task_end
    drawn = batch.simulation.rows(end - len(draws), end)
    shares = np.transpose(
        [random_stream(seed, episode, "task").random(len(draws)) for seed in SEEDS]
    )
    for (_, low, high, signed), share, values in zip(draws, shares, drawn, strict=True):
        expected = low + (high - low) * share
        sizes = values
        if signed:
            expected = np.copysign(low + (high - low) * abs(2 * share - 1), share - 0.5)
            sizes = abs(values)
        assert values == pytest.approx(expected)
        assert (low <= sizes).all()
        assert (sizes <= high).all()


@EACH_TASK
def test_the_ranges_of_the_draws_are_those_of_the_page(name):
    draws = {(low, high, bool(signed)) for _, low, high, signed in _core.TASKS[name].draws}
    assert draws == DRAWS[name]


@EACH_TASK
def test_the_page_states_the_defaults(name):
    defaults = find_task(name).defaults
    ranges = str(defaults["randomization"]).replace("M in", "M uniform in")
    said = (
        f"Capsule(static_ratio={defaults['capsule'].static_ratio})`, {ranges}, "
        f"`energy_weight={defaults['energy_weight']:g}` and "
        f"`termination_penalty={defaults['termination_penalty']:g}`"
    )
    page = sys.modules[f"capsule_gym.tasks.{name}"].__doc__
    assert said in " ".join(page.split())


@EACH_TASK
def test_a_reset_may_set_what_an_episode_draws(name):
    options, shown, value = OPTIONS[name]
    _, info = CapsuleEnv(task=name).reset(seed=0, options=options)
    assert info[shown] == value


@pytest.mark.parametrize(("value", "numbers"), [(0.2, [0.2]), ((0.2, 0.3), [0.2, 0.3])])
def test_an_option_without_a_parser_is_a_number_or_several(value, numbers):
    assert Task(name="goal").parse("goal", value) == numbers


@EACH_TASK
def test_a_reset_of_a_batch_may_set_what_an_episode_draws(name):
    options, shown, value = OPTIONS[name]
    options = {key: [given] * 5 for key, given in options.items()}
    _, info = CapsuleVectorEnv(5, task=name).reset(seed=0, options=options)
    assert (info[shown] == value).all()


@EACH_TASK
def test_a_rendering_marks_the_goal_or_the_target_with_an_upright_pendulum(name):
    env = CapsuleEnv(task=name)
    _, info = env.reset(seed=0, options={"state": [0.0, 0.0, 3.0, 0.0]})
    marked, theta, x = shown_state(env.simulation, 0)["ghost"]
    assert theta == 0.0
    assert x == info[marked]
    assert abs(x - 3.0) <= 0.5


@EACH_TASK
def test_the_plant_is_the_same_draw_as_that_of_the_speed_task(name):
    def mass(task):
        _, info = CapsuleEnv(task=task, randomization="paper").reset(seed=3)
        return info["M"]

    assert mass(name) == mass("speed")


def follow(theta, theta_dot, x, x_dot, memory, reference):
    # The task's memory follows the two columns of the reference.
    return 0.1 * reference[2], memory


def test_a_law_that_reads_a_task_needs_one():
    with pytest.raises(TypeError, match=r"the control law of 'follow' must be .* a trial call"):
        Controller("follow", follow, np.zeros((1, 2)))


def test_a_law_belongs_to_its_task():
    law = Controller("follow", follow, np.zeros((1, 2)), task="goal")
    message = r"^controller must be a law for the task 'speed' or .* for the task 'goal'"
    with pytest.raises(ValueError, match=message):
        CapsuleEnv(controller=law)


def start(task, **options):
    env = CapsuleEnv(task=task)
    env.reset(seed=0, options=options)
    return env


def velocity_episode():
    """The positions and infos of 500 steps of the gait along three commands, and its metrics."""
    schedule = [{"t": 0.0, "v": 0.05}, {"t": 4.0, "v": -0.05}, {"t": 9.0, "v": 0.1}]
    env = CapsuleEnv(task="velocity", controller="baselines:gait", randomization="none")
    env.reset(seed=0, options={"commands": schedule, "mu": 0.2})
    infos = [env.step(NO_TORQUE)[4] for _ in range(500)]
    x = np.array([0.0, *(info["state"][2] for info in infos)])
    return x, infos, env.episode_metrics(750)


def test_the_target_moves_with_the_command_and_stays_near_the_platform():
    x, infos, _ = velocity_episode()
    commands = [0.05] * 200 + [-0.05] * 250 + [0.1] * 51
    assert [info["command"] for info in infos] == commands[1:]
    target = 0.0
    for n, info in enumerate(infos, 1):
        moved = target + CONTROL_DT * commands[n - 1]
        target = x[n] + np.clip(moved - x[n], -0.3, 0.3)
        error = abs(target - x[n])
        rate = np.exp(-error / 0.02) + 0.5 * np.exp(-error / 0.1) - 0.5 * error
        assert info["reward_tracking"] == pytest.approx(CONTROL_DT * rate, rel=1e-9)
        # It restarts at the platform with the next command.
        if commands[n] != commands[n - 1]:
            target = x[n]
        assert info["target"] == pytest.approx(target, abs=1e-12)
        assert info["error"] == pytest.approx(target - x[n], abs=1e-12)


def test_the_velocity_error_is_measured_as_its_definition_says():
    x, _, metrics = velocity_episode()
    missed = commanded = 0.0
    # From 1.5 s after each change; the third command has lasted for 1 s.
    for first, last, v in ((75, 200, 0.05), (275, 450, -0.05)):
        distance = v * CONTROL_DT * (last - first)
        missed += abs(x[last] - x[first] - distance)
        commanded += abs(distance)
    assert metrics["velocity_error"] == pytest.approx(100.0 * missed / commanded, rel=1e-9)
    # The gait runs forwards at 20 cm/s, away from every target.
    assert metrics["unsettled"] == 1.0


def test_commands_are_drawn_from_the_given_range():
    law = "baselines:velocity_pulses"
    batch = CapsuleVectorEnv(512, task=with_commands(0.15, 0.2), controller=law)
    _, info = batch.reset(seed=0)
    assert 0.15 <= info["command"].min() < 0.151
    assert 0.199 < info["command"].max() <= 0.2


@pytest.mark.parametrize(
    ("low", "high", "message"),
    [
        (-0.3, 0.1, "low must be .* within 0.2 of 0"),
        (0.1, 0.05, "high must be .* not below"),
    ],
)
def test_an_invalid_range_of_commands_is_named(low, high, message):
    with pytest.raises(ValueError, match=message):
        with_commands(low, high)


SLOW = [{"t": 0.0, "v": 0.08}]


def test_a_platform_that_moves_with_the_command_has_no_error():
    # Without friction and torque, a platform in motion goes on.
    env = start("velocity", commands=SLOW, mu=0.0, state=[0.0, 0.0, 0.0, 0.08])
    for _ in range(200):
        observation, reward, _, _, info = env.step(NO_TORQUE)
    assert observation[-1] == pytest.approx(0.08, rel=1e-5)
    assert reward == pytest.approx(0.03)
    assert abs(info["error"]) < 1e-12
    metrics = env.episode_metrics(750)
    assert metrics["velocity_error"] == pytest.approx(0.0, abs=1e-9)
    assert metrics["unsettled"] == 0.0


def test_a_command_of_which_too_little_was_measured_does_not_count():
    env = start("velocity", commands=SLOW)
    assert env.episode_metrics(750)["velocity_error"] == 100.0


@pytest.mark.parametrize(("goal", "reached"), [(0.0019, 1.0), (-0.0019, 1.0), (0.0021, 0.0)])
def test_the_goal_is_reached_after_a_second_of_rest_within_2_mm(goal, reached):
    # The platform starts at rest; without a torque it stays in stick.
    env = start("goal", goal=goal, mu=0.4, state=[0.0, 0.0, 3.0, 0.0])
    size = abs(goal)
    rate = 0.5 * np.exp(-size / 0.1) + 0.5 * np.exp(-size / 0.02) - size / 0.5
    # At rest, the last exponential counts twice.
    rate += 2.0 * np.exp(-size / 0.004) + 2.0 * reached
    for n in range(1, 61):
        observation, reward, _, _, info = env.step(NO_TORQUE)
        held = CONTROL_DT * n * reached
        seen = [goal, np.tanh(goal / 0.02), min(1.0, held)]
        assert info["goal"] == 3.0 + goal
        assert info["error"] == pytest.approx(goal)
        assert info["held"] == pytest.approx(held)
        assert reward == pytest.approx(CONTROL_DT * rate, rel=1e-9)
        assert observation[-3:] == pytest.approx(seen, rel=1e-5)
        metrics = env.episode_metrics(750)
        success = reached if n >= 50 else 0.0
        assert metrics["success"] == success
        assert metrics["goal_time"] == pytest.approx(1.0 if success else CONTROL_DT * n)
        assert metrics["backward_ratio"] == 0.0


def test_a_step_that_began_in_slip_is_no_rest():
    env = start("goal", goal=0.001, mu=0.4, state=[0.0, 0.0, 0.0, 0.02])
    held = [env.step(NO_TORQUE)[4]["held"] for _ in range(60)]
    assert held[0] == 0.0
    assert min(held[1:]) > 0.0
    assert env.episode_metrics(750)["goal_time"] == pytest.approx(1.02)


def test_a_reached_goal_stays_reached():
    env = start("goal", goal=0.001, mu=0.4, state=[0.0, 0.0, 0.0, 0.0])
    for _ in range(100):
        env.step(NO_TORQUE)
    # A step with a torque ends the rest.
    _, _, _, _, info = env.step(np.ones(1, np.float32))
    assert info["held"] == 0.0
    for _ in range(19):
        env.step(NO_TORQUE)
    metrics = env.episode_metrics(750)
    assert metrics["success"] == 1.0
    assert metrics["goal_time"] == pytest.approx(1.0)


def test_the_time_of_a_failed_episode_is_that_of_the_whole():
    env = start("goal", state=[1.5, 5.0, 0.0, 0.0])
    _, _, terminated, _, _ = env.step(NO_TORQUE)
    assert terminated
    assert env.episode_metrics(750)["goal_time"] == 15.0
