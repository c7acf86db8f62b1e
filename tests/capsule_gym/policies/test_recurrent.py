"""Policies with a memory: a GRU or an LSTM between linear layers.

`recurrent-ppo/policy.safetensors` is an agent of sb3-contrib, trained on one core for 80 s:

    env = CapsuleSB3VecEnv(64, max_episode_steps=250)
    model = RecurrentPPO(
        "MlpLstmPolicy",
        env,
        n_steps=64,
        batch_size=1024,
        n_epochs=4,
        learning_rate=2e-3,
        policy_kwargs={"lstm_hidden_size": 16, "net_arch": [16], "log_std_init": -1.0},
        seed=0,
        device="cpu",
    )
    Policy.from_sb3(model.learn(200_000)).save("recurrent-ppo/policy.safetensors")
"""

import copy
import pickle
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from torch import nn

import capsule_gym
from capsule_gym import Policy, load_policy
from capsule_gym.policies.network import Cell
from tests.capsule_gym.policies.test_policy import POLICY, make_policy, ones, refused_message

ENTRIES = 5
CELLS = {"gru": nn.GRU, "lstm": nn.LSTM}
each_cell = pytest.mark.parametrize("kind", CELLS)
TRAINED = Path(__file__).with_name("recurrent-ppo") / POLICY


class Network(nn.Module):
    """A random network in double precision; the head may read the normalised inputs, too."""

    def __init__(self, kind, units, hidden, head, *, skip, activation, squashing):
        super().__init__()
        self.before = nn.ModuleList()
        width = ENTRIES
        for size in hidden:
            self.before.append(nn.Linear(width, size))
            width = size
        self.cell = CELLS[kind](width, units)
        width = units + ENTRIES * skip
        self.after = nn.ModuleList()
        for size in (*head, 1):
            self.after.append(nn.Linear(width, size))
            width = size
        self.skip = skip
        self.activation = activation
        self.squashing = squashing

    def forward(self, inputs, state):
        activate = getattr(torch, self.activation)
        values = inputs
        for layer in self.before:
            values = activate(layer(values))
        values, state = self.cell(values[None], state)
        values = values[0]
        if self.skip:
            values = torch.cat([values, inputs], dim=1)
        *hidden, last = self.after
        for layer in hidden:
            values = activate(layer(values))
        values = last(values)
        return torch.tanh(values) if self.squashing == "tanh" else values.clamp(-1.0, 1.0), state


def random_network(rng):
    def sizes():
        count = rng.integers(0, 3)
        return rng.integers(1, 20, size=count).tolist()

    kind = rng.choice(list(CELLS))
    units = int(rng.integers(1, 30))
    options = {
        "skip": bool(rng.integers(2)),
        "activation": str(rng.choice(["tanh", "relu"])),
        "squashing": str(rng.choice(["clip", "tanh"])),
    }
    return Network(kind, units, sizes(), sizes(), **options)


def converted(network, mean=None, variance=None):
    return Policy.from_torch(
        network,
        activation=network.activation,
        squashing=network.squashing,
        mean=mean,
        variance=variance,
    )


def recurrent_policy(kind="gru", units=12, seed=0, **changes):
    """A random policy."""
    torch.manual_seed(seed)
    options = {"skip": True, "activation": "tanh", "squashing": "clip"}
    return converted(Network(kind, units, [7], [6], **(options | changes)))


@pytest.fixture(
    params=[
        partial(recurrent_policy, "gru"),
        partial(recurrent_policy, "lstm"),
        partial(load_policy, TRAINED),
    ],
    ids=["gru", "lstm", "trained"],
)
def policy(request):
    return request.param()


def observations(steps, episodes, seed=0):
    shape = (steps, episodes, ENTRIES)
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def vectors(state, policy):
    """The memory of a batch as torch has it: h, and for an LSTM c, each without padding."""
    parts = 1 if policy.cell.kind == "gru" else 2
    by_part = state[0].reshape(len(state[0]), parts, -1)
    return by_part[:, :, : policy.cell.units].transpose(1, 0, 2)


@pytest.mark.parametrize("first", [0, 300])
def test_600_random_networks_are_those_of_torch(first):
    for seed in range(first, first + 300):
        rng = np.random.default_rng(seed)
        torch.manual_seed(seed)
        network = random_network(rng)
        mean = rng.normal(size=ENTRIES)
        variance = rng.uniform(0.1, 2.0, ENTRIES)
        policy = converted(network, mean, variance)
        network.double()
        inputs = observations(5, int(rng.integers(1, 7)), seed)
        state = memory = None
        for values in inputs:
            actions, state = policy.predict(values, state)
            with torch.no_grad():
                normalised = torch.from_numpy((values - mean) / np.sqrt(variance))
                expected, memory = network(normalised, memory)
            # The actions are rounded to float32; the memory is not.
            np.testing.assert_allclose(actions, expected, rtol=6.1e-8, atol=1e-12)
            exact = memory if isinstance(memory, tuple) else (memory,)
            for found, vector in zip(vectors(state, policy), exact, strict=True):
                np.testing.assert_allclose(found, vector[0], rtol=0.0, atol=1e-12)


def test_an_episode_alone_has_the_bits_of_a_batch(policy):
    inputs = observations(20, 9)
    act = policy.start(range(9))
    together = np.array([act(values) for values in inputs])
    for i in range(9):
        act = policy.start([0])
        alone = np.array([act(values) for values in inputs[:, i]])
        assert alone.tobytes() == together[:, i].tobytes()


def test_whole_episodes_in_the_core_are_those_of_a_loop(policy):

    class InPython:
        name = "loop"
        env_kwargs = policy.env_kwargs
        start = policy.start

    in_core = capsule_gym.evaluate(policy, "paper")
    in_python = capsule_gym.evaluate(InPython(), "paper")
    assert [each["distance"] for each in in_core] == [each["distance"] for each in in_python]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made))])
def test_a_copy_acts_as_the_policy(policy, copied):
    acts = [each.start(range(3)) for each in (policy, copied(policy))]
    for values in observations(5, 3):
        one, other = (act(values) for act in acts)
        assert one.tobytes() == other.tobytes()


def test_starts_clears_the_memory_of_the_episodes_that_begin(policy):
    inputs = observations(6, 2)
    act = policy.start(range(2))
    for values in inputs[:3]:
        act(values)
    begun = act(inputs[3], np.array([True, False]))
    other = policy.start([0])
    assert begun[0].tobytes() == other(inputs[3, 0]).tobytes()
    assert act(inputs[4])[0].tobytes() == other(inputs[4, 0]).tobytes()


def test_the_text_of_a_policy_leaves_out_arrays():
    assert "array(" not in repr(recurrent_policy())


def test_a_cell_may_have_1_to_512_units():
    for units in (1, 512):
        assert recurrent_policy(units=units).cell.units == units


def test_the_memory_changes_the_action():
    act = recurrent_policy().start([0])
    (values,) = observations(1, 1)
    assert act(values).tobytes() != act(values).tobytes()


@pytest.mark.parametrize("starts", [np.ones(3, bool), np.ones(2), [1, 0], "yes"])
def test_starts_that_are_no_bool_per_episode_are_refused(starts):
    act = recurrent_policy().start(range(2))
    with pytest.raises(ValueError, match=r"starts must be an array of bool of shape \(2,\)"):
        act(observations(1, 2)[0], starts)


def test_a_call_without_a_memory_names_start():
    with pytest.raises(TypeError, match=r"policy\.start\(seeds\)"):
        recurrent_policy()(observations(1, 1)[0])


def test_predict_carries_the_memory_as_its_state(policy):
    inputs = observations(8, 3)
    act = policy.start(range(3))
    state = None
    begins = np.zeros(3, bool)
    for n, values in enumerate(inputs):
        begins[1] = n == 5
        actions, state = policy.predict(values, state, begins)
        assert actions.tobytes() == act(values, begins).tobytes()


def test_sb3_evaluates_it(policy):
    env = make_vec_env("capsule_gym:CapsuleStickSlip-v0", n_envs=2)
    mean, _ = evaluate_policy(policy, env, n_eval_episodes=2)
    assert np.isfinite(mean)


def test_predict_refuses_random_actions_and_foreign_states():
    policy = recurrent_policy()
    values = observations(1, 2)[0]
    with pytest.raises(ValueError, match="deterministic must be True"):
        policy.predict(values, deterministic=False)
    infinite = np.zeros((2, 16))
    infinite[1, 3] = np.inf
    for foreign in ((np.zeros((2, 3)),), (infinite,), ("a", "b"), 1.0):
        with pytest.raises(ValueError, match="state must be None or a tuple of an array"):
            policy.predict(values, foreign)
    with pytest.raises(ValueError, match="episode_start must be an array of bool"):
        policy.predict(values, episode_start=np.ones(3, bool))


@each_cell
@pytest.mark.parametrize("skip", [False, True])
def test_a_file_gives_back_the_policy(kind, skip, tmp_path):
    policy = recurrent_policy(kind, skip=skip)
    policy.save(tmp_path / POLICY)
    loaded = load_policy(tmp_path / POLICY)
    assert loaded._network.tobytes() == policy._network.tobytes()
    assert loaded.cell.kind == kind


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"weight_hh": ones((12, 12))},
            r"cell.weight_hh must be float32 of shape \(36, 12\), with 3",
        ),
        ({"weight_hh": ones(12)}, "cell.weight_hh must be of 1 to 512 units"),
        ({"weight_hh": ones((1800, 600))}, "cell.weight_hh must be of 1 to 512 units"),
        ({"weight_ih": ones((36, 6))}, r"cell.weight_ih must be float32 of shape \(36, 7\)"),
        ({"bias_ih": ones(35)}, "cell.bias_ih must be float32"),
        ({"bias_hh": np.full(36, np.inf, np.float32)}, "cell.bias_hh must be finite"),
        ({"weight_hh": np.ones((36, 12))}, "cell.weight_hh must be float32"),
    ],
)
def test_a_wrong_cell_is_refused_by_name(changes, message):
    policy = recurrent_policy()
    cell = policy.cell._replace(**changes)
    with pytest.raises(ValueError, match=message):
        make_policy(layers=policy.layers, cell=cell, head=policy.head)


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ((), "head must be 1 to 3 layers, got 0"),
        (((ones((1, 13)), ones(1)),), r"head.0.weight must be float32 of shape \(1, 12\)"),
        (((ones((2, 12)), ones(2)),), "and one in the last"),
    ],
)
def test_a_wrong_head_is_refused_by_name(head, message):
    policy = recurrent_policy()
    with pytest.raises(ValueError, match=message):
        make_policy(layers=policy.layers, cell=policy.cell, head=head)


def test_a_head_needs_a_cell():
    with pytest.raises(ValueError, match="head must be empty without a cell"):
        make_policy(head=recurrent_policy().head)


def test_a_file_of_the_older_version_has_no_cell(tmp_path):
    make_policy().save(tmp_path / POLICY)
    cell = recurrent_policy().cell
    tensors = {f"cell.{name}": array for name, array in cell._asdict().items()}
    assert "it must contain the tensors" in refused_message(tmp_path / POLICY, tensors, {})


def test_a_file_of_the_newer_version_needs_every_array_of_the_cell(tmp_path):
    make_policy().save(tmp_path / POLICY)
    metadata = {"format_version": "3"}
    assert "it must contain the tensors" in refused_message(tmp_path / POLICY, {}, metadata)


def test_the_largest_weights_still_give_a_number():
    largest = np.finfo(np.float32).max
    policy = recurrent_policy("lstm")

    def full(array):
        return np.full_like(array, largest)

    huge = make_policy(
        activation="relu",
        layers=tuple((full(weights), full(bias)) for weights, bias in policy.layers),
        cell=Cell(*map(full, policy.cell)),
        head=tuple((full(weights), full(bias)) for weights, bias in policy.head),
    )
    act = huge.start([0])
    for _ in range(3):
        assert np.isfinite(act(np.full(ENTRIES, largest, np.float32))).all()
