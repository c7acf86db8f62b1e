"""Processor time of trainers: the clock, the table, and CleanRL's loop, which learns from a reward at the end."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import training


def test_evaluations_do_not_count_and_the_clock_stops_at_the_speed_or_the_time(monkeypatch):
    now, speeds = [0.0], iter((3.0, 15.0, 3.0))

    def evaluate(*_):
        now[0] += 50.0
        return [{"mean_speed": next(speeds)}]

    monkeypatch.setattr(training, "evaluate", evaluate)
    monkeypatch.setattr(training.time, "process_time", lambda: now[0])
    clock = training.Clock(None, _began=0.0)
    assert clock.check(training.EVERY - 1, list) and clock.seconds == 0.0
    for n, (seconds, going) in enumerate(((4.0, True), (10.0, False), (training.MOST_SECONDS, False)), start=1):
        now[0] += seconds - clock.seconds
        assert clock.check(n * training.EVERY, list) is going
        assert (clock.seconds, clock.steps) == (seconds, n * training.EVERY)


def test_a_training_that_does_not_arrive_is_marked_in_the_table(monkeypatch, tmp_path):
    def trainer(speed):
        return lambda seed, clock: vars(clock).update(seconds=12.0 + seed, steps=65_536, speed=speed)

    contenders = {"fast": trainer(training.SPEED), "slow": trainer(3.25)}
    monkeypatch.setattr(training, "CONTENDERS", contenders)
    assert training.main(["--seeds", "2", "--markdown", str(tmp_path / "page.md")]) == 0
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "|trainer|seed 0, s|seed 1, s|thousands of steps|" in page
    assert "|fast|12|13|66, 66|" in page and "|slow|> 12 (3.2 cm/s)|> 13 (3.2 cm/s)|66, 66|" in page


@pytest.mark.parametrize(("library", "num_envs"), [("", training.CONFIG.num_envs), ("stable_baselines3", 8)])
def test_the_agent_of_a_library_is_evaluated_while_it_learns(library, num_envs):
    seen, zeros = [], np.zeros((1, 5), np.float32)

    def check(steps, policy):
        seen.append((steps, policy().start([0])(zeros), policy().env_kwargs))
        return len(seen) < 3

    training.train_model(library, 0, SimpleNamespace(check=check))
    (first, action, kwargs), (second, *_), (third, later, _) = seen
    assert (first, second, third) == (num_envs, 2 * num_envs, 3 * num_envs) and kwargs == training.ENV_KWARGS
    # The statistics of the observations change.
    assert action.shape == (1, 1) and 0.0 < abs(action - later).max() < 1.0


class Hoard(gym.Env):
    """The last of five steps costs the sum of all actions."""

    observation_space, action_space = gym.spaces.Box(-9.0, 9.0, (2,)), gym.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        self.seen = np.zeros(2, np.float32)
        return self.seen, {}

    def step(self, action):
        self.seen = self.seen + np.float32([1.0, action[0]])
        done = bool(self.seen[0] == 5.0)
        return self.seen, -float(self.seen[1]) * done, done, False, {}


def test_the_loop_learns_what_pays_in_the_end(monkeypatch):
    monkeypatch.setattr(training.gym, "make", lambda *_, **__: Hoard())
    seen = []

    def check(steps, policy):
        seen.append((steps, policy().start([0])(np.float32([[0.0, 0.0]]))))
        return len(seen) < 4

    training.train_loop(0, SimpleNamespace(check=check))
    assert [steps for steps, _ in seen] == [0, 2048, 4096, 6144]
    assert abs(seen[0][1]) < 0.05 and seen[-1][1] < -0.3
