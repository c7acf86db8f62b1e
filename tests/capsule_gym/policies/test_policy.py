import json
import pickle
import struct
import tracemalloc
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from safetensors.numpy import load_file, save

import capsule_gym
from agents.distillation.config import STUDENTS
from capsule_gym import Capsule, Policy, Randomization, load_policy, policy_names
from capsule_gym.envs.config import EnvConfig
from capsule_gym.policies.policy import ENV_ARGUMENTS, IMITATION, POLICY
from capsule_gym.tasks.task import START_THETA
from tests.capsule_gym.policies.test_network import make_layers


def make_policy(**changes):
    rng = np.random.default_rng(5)
    values = {
        "name": "made",
        "algorithm": "ppo",
        "activation": "tanh",
        "squashing": "clip",
        "revision": "0123456789ab",
        "clip": 10.0,
        "epsilon": 1e-8,
        "training_seed": 3,
        "env_kwargs": {"torque_limit": 1.25, "randomization": "wide"},
        "mean": rng.normal(size=5),
        "variance": rng.uniform(0.1, 2.0, 5),
        "layers": tuple(make_layers((5, 8, 1))),
    }
    return Policy(**(values | changes))  # type: ignore[arg-type]


def make_linear_policy(entries, **env_kwargs):
    """A policy of one layer for an environment whose observation has this number of entries."""
    return make_policy(
        mean=np.zeros(entries),
        variance=np.ones(entries),
        layers=tuple(make_layers((entries, 1))),
        env_kwargs=env_kwargs,
    )


def make_policy_on(law):
    return make_linear_policy(10, controller=law)


@pytest.fixture
def path(tmp_path):
    """The path of a policy file in a folder."""
    make_policy().save(tmp_path / POLICY)
    return tmp_path / POLICY


@pytest.fixture
def policy():
    return make_policy()


OBSERVATIONS = np.random.default_rng(6).normal(size=(20, 5)).astype(np.float32)


@pytest.mark.parametrize("name", ["direct-sac", "efficient", "residual-ppo", "noisy"])
def test_the_environment_of_a_policy_starts_at_rest(name):
    noisy = {"initial_noise": 0.3}
    policy = make_policy(env_kwargs=noisy) if name == "noisy" else load_policy(name)
    env = gym.make(capsule_gym.ENV_ID, **policy.env_kwargs)
    for seed in range(3):
        _, info = env.reset(seed=seed)
        np.testing.assert_array_equal(info["state"], [START_THETA, 0.0, 0.0, 0.0])


def test_a_file_gives_back_what_was_saved(tmp_path):
    ranges = Randomization(M=(0.4, 0.6), mu=(0.01, 0.1), log_mu=True)
    env_kwargs = {"capsule": Capsule(m=0.2), "randomization": ranges}
    policy = make_policy(env_kwargs=env_kwargs, training_seed=np.int64(2**63 - 1), clip=0.5)

    policy.save(tmp_path / POLICY)
    loaded = load_policy(tmp_path)

    for field in fields(Policy):
        if field.name != "name":
            np.testing.assert_equal(getattr(loaded, field.name), getattr(policy, field.name))
    assert loaded.name == tmp_path.name
    assert loaded(OBSERVATIONS).tobytes() == policy(OBSERVATIONS).tobytes()


def test_a_policy_gives_the_same_file_after_loading_and_pickling(path, tmp_path):
    again = pickle.loads(pickle.dumps(load_policy(path)))
    again.save(tmp_path / "again")
    assert (tmp_path / "again").read_bytes() == path.read_bytes()


def test_a_file_with_another_name_gives_the_policy_its_name(policy, tmp_path):
    policy.save(tmp_path / "mine.safetensors")
    assert load_policy(tmp_path / "mine.safetensors").name == "mine"


def test_a_policy_may_name_every_argument_of_its_environment():
    defaults = {name: getattr(EnvConfig(), name) for name in ENV_ARGUMENTS}
    assert make_policy(env_kwargs=defaults).entries == 5


def test_the_tensors_of_a_file_are_aligned(path):
    size_of_header = path.read_bytes()[:8]
    assert int.from_bytes(size_of_header, "little") % 8 == 0


def test_the_text_of_a_policy_leaves_out_arrays(policy):
    assert "array(" not in repr(policy)


def test_an_observation_alone_gets_the_action_that_it_has_in_a_batch(policy):
    actions = policy(OBSERVATIONS)
    assert (actions.shape, actions.dtype) == ((20, 1), np.float32)
    for observation, action in zip(OBSERVATIONS, actions, strict=True):
        alone = policy(observation)
        assert (alone.shape, alone.dtype) == ((1,), np.float32)
        assert alone.tobytes() == action.tobytes()


@pytest.mark.parametrize(
    "convert", [partial(np.asarray, dtype=np.float64), np.asfortranarray, np.ndarray.tolist]
)
def test_number_type_and_layout_of_observations_do_not_matter(convert, policy):
    assert policy(convert(OBSERVATIONS)).tobytes() == policy(OBSERVATIONS).tobytes()


def test_the_order_of_observations_does_not_matter(policy):
    assert policy(OBSERVATIONS[::-1])[::-1].tobytes() == policy(OBSERVATIONS).tobytes()


def test_no_observations_get_no_actions(policy):
    assert policy(OBSERVATIONS[:0]).shape == (0, 1)


def test_a_started_policy_needs_a_row_for_each_episode(policy):
    act = policy.start(range(20))
    assert act(OBSERVATIONS).tobytes() == policy(OBSERVATIONS).tobytes()
    message = r"observations must have one row for each of 20 episodes, got 3 rows"
    with pytest.raises(ValueError, match=message):
        act(OBSERVATIONS[:3])


@pytest.mark.parametrize(
    "observation",
    [
        np.zeros(4),
        np.zeros((2, 6)),
        np.zeros((1, 1, 5)),
        0.0,
        [0, 0, 0, 0, np.nan],
        ["a"] * 5,
        [10**400] * 5,
    ],
)
def test_what_is_no_observation_is_refused(observation, policy):
    with pytest.raises(ValueError, match="observation must be"):
        policy(observation)


@pytest.mark.parametrize("run", policy_names(seeds=True))
def test_a_pretrained_run_says_how_it_was_trained(run):
    policy = load_policy(run)
    name, _, seed = run.partition("/seed-")
    algorithm = IMITATION if name in STUDENTS else "ppo"
    if "sac" in name:
        algorithm = "sac"
    if "recurrent" in name:
        algorithm = "recurrentppo"
    assert (policy.name, policy.training_seed) == (run, int(seed))
    assert policy.algorithm == algorithm
    assert policy.revision not in ("", "unknown")


def test_a_policy_without_a_memory_predicts_as_it_acts():
    policy = make_policy()
    observations = np.random.default_rng(1).normal(size=(3, policy.entries)).astype(np.float32)
    actions, state = policy.predict(observations)
    assert state is None
    assert actions.tobytes() == policy(observations).tobytes()


@pytest.mark.parametrize("name", policy_names())
def test_the_plain_name_means_the_first_run(name):
    policy = load_policy(name)
    assert (policy.name, policy.training_seed) == (name, 0)


@pytest.mark.parametrize("name", policy_names())
def test_every_pretrained_policy_drives_its_environment(name):
    policy = load_policy(name)
    env = gym.make(capsule_gym.ENV_ID, **policy.env_kwargs)
    # The plant comes from the ranges of the policy's training.
    observation, _ = env.reset(seed=0)
    act = policy.start([0])
    for _ in range(round(3.0 / env.unwrapped.simulation.options.control_dt)):
        observation, _, terminated, _, _ = env.step(act(observation))
        assert not terminated
    if policy.env_kwargs.get("task", "speed") == "speed":
        # The laws alone reach 1.4 cm/s.
        assert env.unwrapped.episode_metrics(1650)["mean_speed"] > 3.0


def test_a_name_on_disk_does_not_hide_a_pretrained_policy(policy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "direct-ppo").mkdir()
    policy.save(tmp_path / "direct-ppo" / POLICY)
    assert load_policy("direct-ppo").training_seed == 0
    assert load_policy(Path("direct-ppo")).training_seed == 3


def test_a_folder_without_a_policy_is_refused(tmp_path):
    message = r"a run's folder, which holds best/policy.safetensors or policy.safetensors"
    with pytest.raises(ValueError, match=message):
        load_policy(tmp_path)


@pytest.mark.parametrize("name", ["my-run", "my-row/seed-0"])
@pytest.mark.parametrize(
    ("place", "seed"), [(".", 2), (POLICY, 1), ("best", 2), (f"best/{POLICY}", 2)]
)
@pytest.mark.parametrize("kind", [str, Path])
def test_a_run_folder_means_its_best_policy(name, place, seed, kind, tmp_path):
    run = tmp_path / name
    (run / "best").mkdir(parents=True)
    make_policy(training_seed=1).save(run / POLICY)
    assert load_policy(run).training_seed == 1
    make_policy(training_seed=2).save(run / "best" / POLICY)

    loaded = load_policy(kind(run / place))

    assert (loaded.name, loaded.training_seed) == (name, seed)


@pytest.mark.parametrize(
    "law",
    [
        "os:getcwd",
        "baselines.paper.__main__:main",
        "baselines:_hidden",
        "baselines:x:y",
        "baselinesx:y",
    ],
)
def test_a_foreign_law_asks_for_consent(law, tmp_path):
    make_policy_on(law).save(tmp_path / POLICY)
    message = r"does not come with this package.*trust_controller=True"
    with pytest.raises(ValueError, match=message):
        load_policy(tmp_path)
    trusted = load_policy(tmp_path, trust_controller=True)
    assert trusted.env_kwargs["controller"] == law


def test_a_law_of_the_package_needs_no_consent(tmp_path):
    make_policy_on("baselines:adaptive").save(tmp_path / POLICY)
    assert load_policy(tmp_path).env_kwargs["controller"] == "baselines:adaptive"


def with_header(header):
    return struct.pack("<Q", len(header)) + header + bytes(8)


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(b"", id="empty"),
        pytest.param(pickle.dumps({"a": 1}), id="pickle"),
        pytest.param(struct.pack("<Q", 2**63) + b"{}", id="header of all memory"),
        pytest.param(with_header(b"{'a': 1}"), id="no JSON"),
        pytest.param(with_header(b'{"a":' + b"[" * 100_000), id="deep JSON"),
        pytest.param(
            with_header(
                b'{"a":{"dtype":"F32","shape":[1099511627776,1099511627776],"data_offsets":[0,0]}}'
            ),
            id="huge shape",
        ),
        pytest.param(
            with_header(
                b'{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},'
                b'"b":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}'
            ),
            id="overlapping tensors",
        ),
    ],
)
def test_what_is_no_policy_file_is_refused_by_name_without_taking_memory(content, path):
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"policy\.safetensors is not a policy file: "):
            load_policy(path)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 0.99])
def test_a_truncated_file_is_refused(share, path):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match="is not a policy file: "):
        load_policy(path)


def test_a_file_that_is_too_large_is_refused(path):
    with path.open("ab") as file:
        file.truncate(10**12)  # sparse: it takes no room
    with pytest.raises(ValueError, match=r"must have at most 33554432 bytes, got 1000000000000"):
        load_policy(path)


def refused_message(path, tensors, metadata):
    """The error for the file with these changes of tensors and metadata; None removes one."""
    content = path.read_bytes()
    end = 8 + int.from_bytes(content[:8], "little")
    words = json.loads(content[8:end])["__metadata__"] | metadata
    arrays = load_file(path) | tensors
    path.write_bytes(
        save(
            {name: array for name, array in arrays.items() if array is not None},
            {name: word for name, word in words.items() if word is not None},
        )
    )
    with pytest.raises(ValueError, match=r"policy\.safetensors is not a policy file: ") as caught:
        load_policy(path)
    return str(caught.value)


ones = partial(np.ones, dtype=np.float32)


def test_arrays_of_another_byte_order_are_refused(policy):
    with pytest.raises(ValueError, match=r"inputs\.mean must be float64 .*, got >f8 of shape"):
        replace(policy, mean=policy.mean.astype(">f8"))


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({"layers.0.weight": np.nan * ones((8, 5))}, "layers.0.weight must be finite"),
        ({"layers.1.weight": ones((2, 8)), "layers.1.bias": ones(2)}, "and one in the last"),
        ({"inputs.mean": np.zeros(6)}, "of shape (5,), one for each entry"),
        ({"layers.0.bias": None}, "it must contain the tensors"),
        (
            {f"layers.{n}.weight": ones((1, 1)) for n in range(2, 7)}
            | {f"layers.{n}.bias": ones(1) for n in range(2, 7)},
            "1 to 6 layers, got 7",
        ),
        (
            {
                "layers.0.weight": ones((2000, 5)),
                "layers.0.bias": ones(2000),
                "layers.1.weight": ones((1, 2000)),
            },
            "1 to 1024 units",
        ),
    ],
)
def test_a_file_with_other_tensors_is_refused_by_name(tensors, message, path):
    found = refused_message(path, tensors, {})
    assert message in found
    assert len(found) < 4000


@pytest.mark.parametrize(
    ("name", "word", "message"),
    [
        ("format", "pt", "got ('pt', '2')"),
        ("output", "torque", "output must be 'action' in its metadata, got 'torque'"),
        (
            "told_energy_weight",
            "true",
            "told_energy_weight must be 'false' in its metadata, got 'true'",
        ),
        ("squashing", None, "squashing must be text in its metadata, got None"),
        ("identifies", "true", "identifies must be 'false' in its metadata, got 'true'"),
        ("env_kwargs", '{"observe_estimates": true}', "of shape (9,), one for each entry"),
        ("activation", "gelu", "activation must be one of"),
        ("clip", "0.0", "clip must be a number in (0, 1e+06], got 0.0"),
        ("env_kwargs", '{"capsule":' + "[" * 60_000, "is not a policy file: "),
        ("env_kwargs", '{"torque_limit": NaN}', "torque_limit must be a finite number > 0"),
        ("env_kwargs", '{"threads": 1000000000}', "env_kwargs must be a dict with keys out of"),
        ("env_kwargs", '{"controller": "baselines:adaptive"}', "of shape (10,), one for each"),
        ("env_kwargs", '{"capsule": {"wheels": 4}}', "capsule must have fields out of"),
        ("format", "x" * 100_000, "xxx"),
        ("activation", "x" * 100_000, "xxx"),
        ("clip", "x" * 100_000, "xxx"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_file_with_other_metadata_is_refused_by_name(name, word, message, path):
    found = refused_message(path, {}, {name: word})
    assert message in found
    assert len(found) < 4000


@pytest.mark.parametrize(
    "changes",
    [{}, {"variance": np.full(5, 1e300)}, {"variance": np.zeros(5), "epsilon": 1e-300}],
)
def test_the_largest_weights_still_give_a_number(changes):
    largest = np.finfo(np.float32).max
    layers = make_layers((5, *[64] * 5, 1), seed=8)
    extreme = make_policy(
        layers=tuple((np.sign(weights) * largest, bias) for weights, bias in layers),
        activation="relu",
        clip=1e6,
        mean=np.full(5, 1e300),
        variance=np.full(5, 1e-300),
        epsilon=0.0,
    )
    signs = np.random.default_rng(7).choice([-1, 1], (50, 5))
    assert np.isfinite(replace(extreme, **changes)(signs * largest)).all()
