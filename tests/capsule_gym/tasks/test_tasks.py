import math
import sys

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, Controller
from capsule_gym.core import _core
from capsule_gym.envs.resets import random_stream
from capsule_gym.tasks.registry import TASKS, find_task
from capsule_gym.tasks.velocity import with_commands

OTHERS = [name for name in TASKS if name != "speed"]
COMMANDS = [{"t": 0.1 * n, "v": 0.05 - 0.01 * n} for n in range(8)]
# For each task: options of a reset, the entry and value that `info` then shows, and what its page
# says of the draws.
GIVEN = {
    "goal": ({"goal": -0.2}, "goal", -0.2, {(0.05, 0.5, True)}),
    "velocity": ({"commands": COMMANDS}, "command", 0.05, {(-0.1, 0.1, False), (4.0, 8.0, False)}),
}


@pytest.mark.parametrize("name", OTHERS)
def test_what_an_episode_draws_are_numpys_numbers_and_a_reset_may_set_it(name):
    own, all_draws = find_task(name), _core.TASKS[name].draws
    batch = CapsuleVectorEnv(5, task=name)
    end = batch.simulation.layout.task_end
    for episode in range(3):
        batch.reset(seed=[2**64 + 3, 1, 2, 3, 4] if episode == 0 else None)
        drawn = batch.simulation.rows(end - len(all_draws), end)
        for i, seed in enumerate((2**64 + 3, 1, 2, 3, 4)):
            shares = random_stream(seed, episode, "task").random(len(all_draws))
            for (_, low, high, signed), share, value in zip(
                all_draws, shares, drawn[:, i], strict=True
            ):
                either = math.copysign(low + (high - low) * abs(2 * share - 1), share - 0.5)
                assert value == pytest.approx(either if signed else low + (high - low) * share)
                assert low <= (abs(value) if signed else value) <= high
    options, shown, value, draws = GIVEN[name]
    ranges = str(own.defaults["randomization"]).replace("M in", "M uniform in")
    weights = "`energy_weight={energy_weight:g}` and `termination_penalty={termination_penalty:g}`"
    said = f"Capsule(static_ratio={own.defaults['capsule'].static_ratio})`, {ranges}, {weights.format(**own.defaults)}"
    page = sys.modules[f"capsule_gym.tasks.{name}"].__doc__
    assert {(low, high, bool(signed)) for _, low, high, signed in all_draws} == draws
    assert said in " ".join(page.split())
    assert CapsuleEnv(task=name).reset(seed=0, options=options)[1][shown] == value
    assert (
        batch.reset(options={key: [given] * 5 for key, given in options.items()})[1][shown] == value
    ).all()
    # The plant and the first angle are the same draws as those of the speed task.
    masses = [
        CapsuleEnv(task=each, randomization="paper").reset(seed=3)[1]["M"]
        for each in (name, "speed")
    ]
    assert masses[0] == masses[1]


def test_a_law_belongs_to_its_task():
    def law(theta, theta_dot, x, x_dot, memory, reference):
        # The task's memory follows the two columns of the reference.
        return 0.1 * reference[2], memory

    with pytest.raises(TypeError, match=r"the control law of 'follows' must be .* a trial call"):
        Controller("follows", law, np.zeros((1, 2)))
    with pytest.raises(
        ValueError,
        match=r"^controller must be a law for the task 'speed' or .* for the task 'goal'",
    ):
        CapsuleEnv(controller=Controller("follows", law, np.zeros((1, 2)), task="goal"))


def test_velocity_is_measured_as_its_definition_says():
    schedule = [{"t": 0.0, "v": 0.05}, {"t": 4.0, "v": -0.05}, {"t": 9.0, "v": 0.1}]
    env = CapsuleEnv(task="velocity", controller="baselines:gait", randomization="none")
    env.reset(seed=0, options={"commands": schedule, "mu": 0.2})
    x, commands, target, gains = [0.0], [0.05], 0.0, []
    for n in range(1, 501):
        _, _, _, _, info = env.step(np.zeros(1, np.float32))
        x.append(info["state"][2])
        commands.append(info["command"])
        # The target moves with the previous command, and restarts at the platform with the next
        # command.
        target = x[-1] + np.clip(target + 0.02 * commands[-2] - x[-1], -0.3, 0.3)
        error = abs(target - x[-1])
        gains.append(info["reward_tracking"])
        expected = 0.02 * (np.exp(-error / 0.02) + 0.5 * np.exp(-error / 0.1) - 0.5 * error)
        assert gains[-1] == pytest.approx(expected, rel=1e-9)
        target = x[-1] if n in (200, 450) else target
        assert info["target"] == pytest.approx(target, abs=1e-12)
        assert info["error"] == pytest.approx(target - x[-1], abs=1e-12)
    assert (
        commands[:200] == [0.05] * 200
        and commands[200:450] == [-0.05] * 250
        and commands[450:] == [0.1] * 51
    )
    # The third command has lasted for 1 s.
    spans = [(75, 200, 0.05), (275, 450, -0.05)]
    missed = sum(abs(x[last] - x[first] - v * 0.02 * (last - first)) for first, last, v in spans)
    commanded = sum(abs(v) * 0.02 * (last - first) for first, last, v in spans)
    metrics = env.episode_metrics(750)
    assert metrics["velocity_error"] == pytest.approx(100.0 * missed / commanded, rel=1e-9)
    # The gait runs forwards at 20 cm/s, away from every target.
    assert metrics["unsettled"] == 1.0


def test_velocity_draws_its_commands_and_a_platform_that_moves_as_it_is_told_has_no_error():
    batch = CapsuleVectorEnv(
        512, task=with_commands(0.15, 0.2), controller="baselines:velocity_pulses"
    )
    commands = batch.reset(seed=0)[1]["command"]
    assert 0.15 <= commands.min() < 0.151 and 0.199 < commands.max() <= 0.2
    for ends, message in [
        ((-0.3, 0.1), "low must be .* within 0.2 of 0"),
        ((0.1, 0.05), "high must be .* not below"),
    ]:
        with pytest.raises(ValueError, match=message):
            with_commands(*ends)
    # Without friction and torque, a platform in motion goes on.
    env = CapsuleEnv(task="velocity", randomization="none")
    env.reset(
        seed=0,
        options={"commands": [{"t": 0.0, "v": 0.08}], "mu": 0.0, "state": [0.0, 0.0, 0.0, 0.08]},
    )
    for _ in range(200):
        observation, reward, _, _, info = env.step(np.zeros(1, np.float32))
    metrics = env.episode_metrics(750)
    assert metrics["velocity_error"] == pytest.approx(0.0, abs=1e-9) and metrics["unsettled"] == 0.0
    assert reward == pytest.approx(0.03) and abs(info["error"]) < 1e-12
    assert observation[-1] == pytest.approx(0.08, rel=1e-5)
    # A command does not count if too little of it was measured.
    env.reset(options={"commands": [{"t": 0.0, "v": 0.08}], "mu": 0.0})
    assert env.episode_metrics(750)["velocity_error"] == 100.0


def test_the_goal_is_reached_after_a_second_of_rest_within_2_mm():
    # The platform starts at rest, 1.9 mm or 2.1 mm from the goal; without a torque it stays in
    # stick.
    for goal, reached in ((0.0019, 1.0), (-0.0019, 1.0), (0.0021, 0.0)):
        env = CapsuleEnv(task="goal")
        env.reset(seed=0, options={"goal": goal, "mu": 0.4, "state": [0.0, 0.0, 3.0, 0.0]})
        size = abs(goal)
        expected = (
            -size / 0.5
            + 0.5 * np.exp(-size / 0.1)
            + 0.5 * np.exp(-size / 0.02)
            + 2.0 * np.exp(-size / 0.004)
        )
        for n in range(60):
            observation, reward, _, _, info = env.step(np.zeros(1, np.float32))
            assert info["goal"] == 3.0 + goal and info["error"] == pytest.approx(goal)
            assert reward == pytest.approx(0.02 * (expected + 2.0 * reached), rel=1e-9)
            assert info["held"] == pytest.approx(0.02 * (n + 1) * reached)
            assert observation[-3:] == pytest.approx(
                [goal, np.tanh(goal / 0.02), min(1.0, info["held"])], rel=1e-5
            )
            metrics = env.episode_metrics(750)
            assert (
                metrics["success"] == (reached if n >= 49 else 0.0)
                and metrics["backward_ratio"] == 0.0
            )
            assert metrics["goal_time"] == pytest.approx(
                1.0 if metrics["success"] else 0.02 * (n + 1)
            )
    # A step that began in slip does not count, and a reached goal stays reached.
    env.reset(options={"goal": 0.001, "mu": 0.4, "state": [0.0, 0.0, 0.0, 0.02]})
    for n in range(120):
        _, _, _, _, info = env.step(np.full(1, 1.0 if n == 100 else 0.0, np.float32))
        assert n > 100 or (info["held"] == 0.0) == (n in (0, 100))
    first = env.episode_metrics(750)
    assert first["success"] == 1.0 and first["goal_time"] == pytest.approx(1.02)
    # After a failure, the time is that of the whole episode.
    env.reset(options={"state": [1.5, 5.0, 0.0, 0.0]})
    assert env.step(np.zeros(1, np.float32))[2]
    assert env.episode_metrics(750)["goal_time"] == 15.0
