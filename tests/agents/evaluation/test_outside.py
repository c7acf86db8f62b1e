import sys

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from agents import evaluate as command
from agents.evaluation import outside
from agents.evaluation.candidates import find_candidate
from agents.evaluation.episodes import evaluate as evaluate_policy
from agents.evaluation.outside import adopt, evaluate, find
from agents.evaluation.sets import parse_set
from capsule_gym.sb3 import CapsuleSB3VecEnv
from tests.agents.fakes import PLANTS, Sine, make_policy, write_run

TINY = parse_set(PLANTS)
PUMP = """
import numpy as np

def pump(observations):
    return np.clip(0.1 * observations[:, 1:2], -1.0, 1.0)

number = 3
"""


def pump(observations):
    """Energy into the pendulum: what `make_policy` does, in numpy."""
    # Within 10, as the network's are.
    theta, theta_dot = np.clip(observations.astype(np.float64), -10.0, 10.0).T[:2, :, None]
    return np.clip(0.1 - theta + np.float64(np.float32(0.05)) * theta_dot, -1.0, 1.0)


def test_a_function_that_computes_what_a_network_does_gives_its_episodes():
    ours, theirs = evaluate(pump, TINY, horizon=2.0), evaluate(make_policy(), TINY, horizon=2.0)
    for one, other in zip(ours, theirs, strict=True):
        assert one.keys() == other.keys()
        assert one["mean_speed"] == pytest.approx(other["mean_speed"], rel=1e-4)


def test_a_policy_of_this_project_stays_what_it_is():
    for policy in (make_policy(), Sine(0.3)):
        assert adopt(policy) is policy
        with pytest.raises(TypeError, match="env_kwargs must not be given with a policy that has its own"):
            adopt(policy, env_kwargs={})


def test_a_torch_module_that_is_not_of_stable_baselines3():
    network = torch.nn.Linear(5, 1, dtype=torch.float32)
    torch.nn.init.zeros_(network.weight)
    torch.nn.init.zeros_(network.bias)

    def act(observations):
        return network(torch.as_tensor(observations))

    with pytest.raises(ValueError, match=r"act must return finite actions .* got Tensor: Can't call numpy"):
        evaluate(act, TINY, horizon=0.1)

    def detached(observations):
        return act(observations).detach()

    assert evaluate(detached, TINY, horizon=1.0) == evaluate(Sine(0.0), TINY, horizon=1.0)


def test_a_model_of_stable_baselines3():
    model = PPO("MlpPolicy", CapsuleSB3VecEnv(2, seed=0), n_steps=8, batch_size=16, seed=0, device="cpu")
    policy = adopt(model)
    assert policy.name == "PPO"
    episodes = evaluate(model, TINY, horizon=0.5)
    by_hand = evaluate(lambda observations: model.predict(observations, deterministic=True)[0], TINY, horizon=0.5)
    assert episodes == by_hand == evaluate(model.policy, TINY, horizon=0.5)
    assert episodes[0]["peak_torque"] > 0.0


class Counting:
    """A recurrent policy: what it does hangs on how often it was asked."""

    env_kwargs = {"control_dt": 0.01}  # noqa: RUF012

    def __init__(self):
        self.starts = []

    def predict(self, observations, state=None, episode_start=None, deterministic=False):
        assert deterministic
        self.starts.append(episode_start.tolist())
        state = (0 if state is None else state) + 1
        return np.full((len(observations), 1), 0.01 * state), state


def test_a_recurrent_policy_is_handed_its_state_anew_in_every_batch():
    policy = Counting()
    first, second = (evaluate(policy, TINY, horizon=0.05) for _ in range(2))
    assert first == second
    assert policy.starts == [[True] * 3, *[[False] * 3] * 4] * 2
    assert first[0]["peak_torque"] == pytest.approx(1.5 * 0.05)


def test_arguments_of_the_environment_come_from_the_caller_or_the_policy():
    assert adopt(Counting()).env_kwargs == {"control_dt": 0.01}
    assert adopt(Counting(), env_kwargs={}, name="mine").env_kwargs == {}
    kwargs = {"controller": "baselines:adaptive", "residual_limit": 3.0}
    shapes = []

    def zero(observations):
        shapes.append(observations.shape)
        return np.zeros((len(observations), 1))

    law = evaluate_policy(find_candidate("adaptive").runs[0].policy, TINY, horizon=0.2)
    assert evaluate(zero, TINY, env_kwargs=kwargs, horizon=0.2) == law
    assert shapes[0] == (3, 10)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.zeros(3), r"of shape \(3, 1\), one line per observation, got \(3,\)"),
        (np.zeros((1, 1)), r"got \(1, 1\)"),
        (np.full((3, 1), np.nan), "got NaN or infinity"),
        ("full", "got str"),
        (None, "got "),
    ],
)
def test_wrong_actions_are_refused(answer, message):
    with pytest.raises(ValueError, match=message):
        evaluate(lambda observations: answer, TINY, horizon=0.1)


@pytest.mark.parametrize("policy", [3, None, Counting, object()])
def test_what_is_no_policy_is_refused(policy):
    with pytest.raises(TypeError, match="policy must be an object with predict"):
        evaluate(policy, TINY)


def test_a_folder_or_a_name(world):
    write_run(world / "mine" / "seed-3", 3)
    episodes = evaluate(world / "mine", TINY, horizon=0.2)
    assert [episode["training_seed"] for episode in episodes] == [3, 3, 3]
    assert len(evaluate("learnt", TINY, horizon=0.2)) == 6
    with pytest.raises(TypeError, match="must not be given with a policy's name"):
        evaluate("learnt", TINY, env_kwargs={})


@pytest.fixture
def module(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_rules.py").write_text(PUMP)
    yield "my_rules"
    sys.modules.pop("my_rules", None)


@pytest.mark.usefixtures("world")
def test_the_command_runs_code_only_where_it_is_trusted(module, tiny_file, capsys):
    with pytest.raises(SystemExit) as stop:
        command.main([f"{module}:pump", "--set", tiny_file])
    assert stop.value.code == 2 and module not in sys.modules
    assert "is code, which importing it runs: --trust accepts that" in capsys.readouterr().err
    path = list(sys.path)
    assert command.main([f"{module}:pump", "--set", tiny_file, "--trust"]) == 0
    assert f"{module}:pump on the set tiny" in capsys.readouterr().out
    assert sys.path == path


def test_what_is_not_there_is_named(module):
    for name, message in (
        ("no_such_module:pump", "names the module 'no_such_module', which does not exist"),
        (f"{module}:jump", "has no 'jump'"),
        (f"{module}:number", "policy must be an object with predict.* got a int"),
    ):
        with pytest.raises(ValueError, match=message):
            find(name, trust=True)
    assert outside.REFERENCE.fullmatch("runs/a:b") is None
