from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import training


def test_a_training_that_does_not_arrive_is_marked_in_the_table(monkeypatch, tmp_path, capsys):
    def trainer(speed):
        def train(seed, clock):
            clock.seconds = 12.0 + seed
            clock.steps = 65_536
            clock.speed = speed

        return train

    contenders = {"fast": trainer(training.SPEED), "slow": trainer(3.25)}
    monkeypatch.setattr(training, "CONTENDERS", contenders)
    path = tmp_path / "page.md"
    assert training.main(["--seeds", "2", "--markdown", str(path)]) == 0
    assert "fast, seed 1: 13 s\n" in capsys.readouterr().err
    page = path.read_text(encoding="utf-8")
    assert "|trainer|seed 0, s|seed 1, s|thousands of steps|" in page
    assert "|fast|12|13|66, 66|" in page
    assert "|slow|> 12 (3.2 cm/s)|> 13 (3.2 cm/s)|66, 66|" in page


class Hoard(gym.Env):
    """The last of five steps costs the sum of all actions, by the sign that is observed."""

    observation_space = gym.spaces.Box(-9.0, 9.0, (2,))
    action_space = gym.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.sign = self.np_random.choice([-1.0, 1.0])
        self.paid = 0.0
        return np.float32([self.steps, self.sign]), {}

    def step(self, action):
        self.steps += 1
        self.paid -= float(self.sign * action[0])
        done = self.steps == 5
        return np.float32([self.steps, self.sign]), self.paid * done, done, False, {}


@pytest.fixture(scope="module")
def loop():
    """Steps and actions at the evaluations of a training, and its updates' rates and weights."""
    evaluations, rates, weights = [], [], []
    both_signs = np.float32([[0.0, -1.0], [0.0, 1.0]])

    def check(steps, policy):
        evaluations.append((steps, policy().start([0, 1])(both_signs).ravel()))
        return len(evaluations) < 4

    def note(adam, *_):
        (group,) = adam.param_groups
        rates.append(group["lr"])
        weights.append([float(each.detach().square().sum()) for each in group["params"]])

    optimizer = pytest.importorskip("torch.optim.optimizer")
    with pytest.MonkeyPatch.context() as patch, optimizer.register_optimizer_step_pre_hook(note):
        patch.setattr(training.gym, "make", lambda *_, **__: Hoard())
        training.train_loop(0, SimpleNamespace(check=check))
    return evaluations, rates, weights


def test_the_loop_learns_what_pays_in_the_end(loop):
    evaluations, _, _ = loop
    (_, first), *_, (_, last) = evaluations
    assert [steps for steps, _ in evaluations] == [0, 2048, 4096, 6144]
    assert max(abs(first)) < 0.05
    assert (last * [-1.0, 1.0] < -0.3).all(), evaluations


def test_the_loop_updates_at_a_falling_rate(loop):
    _, rates, _ = loop
    # 10 epochs in batches of 64.
    updates = np.repeat(range(3), 320)
    assert rates == pytest.approx(3e-4 * (1.0 - 2048e-6 * updates))


def test_the_loop_begins_with_orthogonal_weights(loop):
    _, _, (first, *_) = loop
    # Of gains sqrt(2), sqrt(2), and 0.01 or 1.
    actor = [4.0, 0.0, 128.0, 0.0, 1e-4, 0.0]
    critic = [4.0, 0.0, 128.0, 0.0, 1.0, 0.0]
    log_std = 0.0
    assert first == pytest.approx([*actor, *critic, log_std])


@pytest.fixture
def clock(monkeypatch):
    """A clock whose evaluations take 50 s and find speeds of 3, 15 and 3 cm/s."""
    speeds = iter((3.0, 15.0, 3.0))
    clock = training.Clock(None, _began=0.0)
    clock.now = 0.0

    def evaluate(*_):
        clock.now += 50.0
        return [{"mean_speed": next(speeds)}]

    monkeypatch.setattr(training, "evaluate", evaluate)
    monkeypatch.setattr(training.time, "process_time", lambda: clock.now)
    return clock


def test_an_evaluation_waits_until_it_is_due(clock):
    assert clock.check(training.EVERY - 1, list)
    assert clock.seconds == 0.0


def test_evaluations_do_not_count_and_the_clock_stops_at_the_speed_or_the_time(clock):
    expected = (4.0, True), (10.0, False), (training.MOST_SECONDS, False)
    for n, (seconds, going) in enumerate(expected, start=1):
        clock.now += seconds - clock.seconds
        assert clock.check(n * training.EVERY, list) is going
        assert clock.seconds == seconds
        assert clock.steps == n * training.EVERY


@pytest.mark.parametrize(
    ("library", "num_envs"),
    [("", training.CONFIG.num_envs), ("stable_baselines3", training.NUM_ENVS)],
)
def test_an_agent_is_evaluated_while_it_learns(library, num_envs):
    seen = []

    def check(steps, policy):
        seen.append((steps, policy().env_kwargs))
        return len(seen) < 3

    training.train_model(library, 0, SimpleNamespace(check=check))
    assert seen == [(n * num_envs, training.ENV_KWARGS) for n in (1, 2, 3)]
