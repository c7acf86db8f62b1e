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
from capsule_gym.policies.policy import IMITATION, POLICY
from tests.capsule_gym.policies.test_network import make_layers


def make_policy(**changes):
    rng = np.random.default_rng(5)
    words = {
        "name": "made",
        "algorithm": "ppo",
        "activation": "tanh",
        "squashing": "clip",
        "revision": "0123456789ab",
    }
    arrays = {
        "mean": rng.normal(size=5),
        "variance": rng.uniform(0.1, 2.0, 5),
        "layers": tuple(make_layers((5, 8, 1))),
    }
    env_kwargs = {"torque_limit": 1.25, "randomization": "wide"}
    values = {
        **words,
        **arrays,
        "clip": 10.0,
        "epsilon": 1e-8,
        "training_seed": 3,
        "env_kwargs": env_kwargs,
    }
    return Policy(**{**values, **changes})  # type: ignore[arg-type]


# Fields of a policy on top of a control law.
TEN_ENTRIES = {"layers": tuple(make_layers((10, 1))), "mean": np.zeros(10), "variance": np.ones(10)}
OBSERVATIONS = np.random.default_rng(6).normal(size=(20, 5)).astype(np.float32)


def test_a_file_gives_back_what_was_saved(tmp_path):
    ranges = Randomization(M=(0.4, 0.6), mu=(0.01, 0.1), log_mu=True)
    policy = make_policy(
        env_kwargs={"capsule": Capsule(m=0.2), "randomization": ranges}, training_seed=np.int64(3)
    )
    policy.save(tmp_path / POLICY)
    loaded = load_policy(tmp_path)
    for field in fields(Policy):
        if field.name != "name":
            np.testing.assert_equal(getattr(loaded, field.name), getattr(policy, field.name))
    assert (
        loaded(OBSERVATIONS).tobytes() == policy(OBSERVATIONS).tobytes()
        and loaded.name == tmp_path.name
    )
    assert "array(" not in repr(loaded)
    again = pickle.loads(pickle.dumps(loaded))
    again.save(tmp_path / "again")
    assert (tmp_path / "again").read_bytes() == (tmp_path / POLICY).read_bytes()
    assert int.from_bytes((tmp_path / POLICY).read_bytes()[:8], "little") % 8 == 0


def test_one_observation_or_many():
    policy = make_policy()
    actions = policy(OBSERVATIONS)
    assert (actions.shape, actions.dtype) == ((20, 1), np.float32)
    for observation, action in zip(OBSERVATIONS, actions, strict=True):
        alone = policy(observation)
        assert (alone.shape, alone.dtype, alone.tobytes()) == ((1,), np.float32, action.tobytes())
    for same in (
        OBSERVATIONS.astype(np.float64),
        np.asfortranarray(OBSERVATIONS),
        OBSERVATIONS.tolist(),
    ):
        assert policy(same).tobytes() == actions.tobytes()
    assert policy(OBSERVATIONS[::-1])[::-1].tobytes() == actions.tobytes()
    assert policy(OBSERVATIONS[:0]).shape == (0, 1)
    act = policy.start(range(20))
    assert act(OBSERVATIONS).tobytes() == actions.tobytes()
    with pytest.raises(
        ValueError, match=r"observations must have one row for each of 20 episodes, got 3 rows"
    ):
        act(OBSERVATIONS[:3])


WRONG = [
    np.zeros(4),
    np.zeros((2, 6)),
    np.zeros((1, 1, 5)),
    0.0,
    [0, 0, 0, 0, np.nan],
    ["a"] * 5,
    [10**400] * 5,
]


@pytest.mark.parametrize("observation", WRONG)
def test_what_is_no_observation_is_refused(observation):
    with pytest.raises(ValueError, match="observation must be"):
        make_policy()(observation)


@pytest.mark.parametrize("name", policy_names())
def test_every_pretrained_policy_loads_and_drives_its_environment(name):
    for run in (run for run in policy_names(seeds=True) if run.startswith(f"{name}/")):
        policy = load_policy(run)
        assert (policy.name, policy.training_seed) == (run, int(run.rpartition("-")[2]))
        assert policy.algorithm == (
            "sac" if "sac" in name else IMITATION if name in STUDENTS else "ppo"
        )
        assert policy.revision not in ("", "unknown")
    policy = load_policy(name)
    assert (policy.name, policy.training_seed) == (name, 0)
    env = gym.make(capsule_gym.ENV_ID, **policy.env_kwargs)
    # The plant comes from the ranges of the policy's training.
    observation, _ = env.reset(seed=0)
    for _ in range(round(3.0 / env.unwrapped.simulation.options.control_dt)):
        observation, _, terminated, _, _ = env.step(policy(observation))
        assert not terminated
    # The laws alone reach 1.4 cm/s.
    assert (
        env.unwrapped.episode_metrics(1650)["mean_speed"] > 3.0
        or policy.env_kwargs.get("task", "speed") != "speed"
    )


def test_a_name_on_disk_does_not_hide_a_pretrained_policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "direct-ppo").mkdir()
    make_policy().save(tmp_path / "direct-ppo" / POLICY)
    assert load_policy("direct-ppo").training_seed == 0
    assert load_policy(Path("direct-ppo")).training_seed == 3


@pytest.mark.parametrize("name", ["my-run", "my-row/seed-0"])
def test_a_run_folder_means_its_best_policy(name, tmp_path):
    run = tmp_path / name
    (run / "best").mkdir(parents=True)
    with pytest.raises(
        ValueError,
        match=r"a run's folder, which holds best/policy.safetensors or policy.safetensors",
    ):
        load_policy(run)
    make_policy(training_seed=1).save(run / POLICY)
    assert load_policy(run).training_seed == 1
    make_policy(training_seed=2).save(run / "best" / POLICY)
    for path, seed in (
        (run, 2),
        (str(run), 2),
        (run / POLICY, 1),
        (run / "best", 2),
        (run / "best" / POLICY, 2),
    ):
        loaded = load_policy(path)
        assert (loaded.name, loaded.training_seed) == (name, seed)


def test_another_law_asks_for_consent(tmp_path):
    foreign = (
        "os:getcwd",
        "baselines.paper.__main__:main",
        "baselines:_hidden",
        "baselines:x:y",
        "baselinesx:y",
    )
    for controller in foreign:
        make_policy(**TEN_ENTRIES, env_kwargs={"controller": controller}).save(tmp_path / POLICY)
        with pytest.raises(
            ValueError, match=r"does not come with this package.*trust_controller=True"
        ):
            load_policy(tmp_path)
        assert load_policy(tmp_path, trust_controller=True).env_kwargs["controller"] == controller
    make_policy(**TEN_ENTRIES, env_kwargs={"controller": "baselines:adaptive"}).save(
        tmp_path / POLICY
    )
    assert load_policy(tmp_path).env_kwargs["controller"] == "baselines:adaptive"


HUGE = b'{"a":{"dtype":"F32","shape":[%s],"data_offsets":[0,%s]}}'
TWICE = b'{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},"b":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}'
HEADERS = {
    "no JSON": b"{'a': 1}",
    "deep JSON": b'{"a":' + b"[" * 100_000,
    "huge shape": HUGE % (b"1099511627776,1099511627776", b"0"),
    "overlapping tensors": TWICE,
}
HOSTILE_BYTES = {
    "empty": b"",
    "pickle": pickle.dumps({"a": 1}),
    "header of all memory": struct.pack("<Q", 2**63) + b"{}",
    **{
        name: struct.pack("<Q", len(header)) + header + bytes(8) for name, header in HEADERS.items()
    },
}


@pytest.mark.parametrize("content", HOSTILE_BYTES.values(), ids=HOSTILE_BYTES)
def test_what_is_no_policy_file_is_refused_by_name_without_taking_memory(content, tmp_path):
    path = tmp_path / POLICY
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"policy\.safetensors is not a policy file: "):
            load_policy(path)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_a_truncated_file_and_one_too_large_are_refused(tmp_path):
    path = tmp_path / POLICY
    make_policy().save(path)
    content = path.read_bytes()
    with path.open("ab") as file:
        file.truncate(10**12)  # sparse: it takes no room
    with pytest.raises(ValueError, match=r"must have at most 33554432 bytes, got 1000000000000"):
        load_policy(path)
    for kept in (0.0, 0.05, 0.5, 0.99):
        path.write_bytes(content[: int(kept * len(content))])
        with pytest.raises(ValueError, match="is not a policy file: "):
            load_policy(path)


ones = partial(np.ones, dtype=np.float32)
WIDE = {
    "layers.0.weight": ones((2000, 5)),
    "layers.0.bias": ones(2000),
    "layers.1.weight": ones((1, 2000)),
}
DEEP = {
    f"layers.{n}.{kind}": ones(shape)
    for n in range(2, 7)
    for kind, shape in (("weight", (1, 1)), ("bias", (1,)))
}
# Tensors and entries of the metadata that replace those of a valid file (None removes one), and the
# error message.
HOSTILE = [
    (
        {"layers.0.weight": np.full((8, 5), np.nan, np.float32)},
        {},
        "layers.0.weight must be finite",
    ),
    ({"layers.1.weight": ones((2, 8)), "layers.1.bias": ones(2)}, {}, "and one in the last"),
    ({"inputs.mean": np.zeros(6)}, {}, "of shape (5,), one for each entry"),
    ({"layers.0.bias": None}, {}, "it must contain the tensors"),
    ({**DEEP}, {}, "1 to 6 layers, got 7"),
    ({**WIDE}, {}, "1 to 1024 units"),
    ({}, {"format": "pt"}, "must be ('capsule_gym policy', '2'), got ('pt', '2')"),
    ({}, {"output": "torque"}, "output must be 'action' in its metadata, got 'torque'"),
    (
        {},
        {"told_energy_weight": "true"},
        "told_energy_weight must be 'false' in its metadata, got 'true'",
    ),
    ({}, {"squashing": None}, "squashing must be text in its metadata, got None"),
    ({}, {"identifies": "true"}, "identifies must be 'false' in its metadata, got 'true'"),
    ({}, {"env_kwargs": '{"observe_estimates": true}'}, "of shape (9,), one for each entry"),
    ({}, {"activation": "gelu"}, "activation must be one of"),
    ({}, {"clip": "0.0"}, "clip must be a number in (0, 1e+06], got 0.0"),
    ({}, {"env_kwargs": '{"capsule":' + "[" * 60_000}, "is not a policy file: "),
    ({}, {"env_kwargs": '{"torque_limit": NaN}'}, "torque_limit must be a finite number > 0"),
    ({}, {"env_kwargs": '{"threads": 1000000000}'}, "env_kwargs must be a dict with keys out of"),
    (
        {},
        {"env_kwargs": '{"controller": "baselines:adaptive"}'},
        "of shape (10,), one for each entry",
    ),
    ({}, {"env_kwargs": '{"capsule": {"wheels": 4}}'}, "capsule must have fields out of"),
    *(({}, {name: "x" * 100_000}, "xxx") for name in ("format", "activation", "clip")),
]


@pytest.mark.parametrize(
    ("tensors", "metadata", "message"), HOSTILE, ids=[each[2] for each in HOSTILE]
)
def test_a_file_with_other_content_is_refused_by_name(tensors, metadata, message, tmp_path):
    path = tmp_path / POLICY
    make_policy().save(path)
    content = path.read_bytes()
    described = (
        json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])["__metadata__"]
        | metadata
    )
    parts = [load_file(path) | tensors, described]
    path.write_bytes(
        save(*({key: value for key, value in part.items() if value is not None} for part in parts))
    )
    with pytest.raises(ValueError, match=r"policy\.safetensors is not a policy file: ") as caught:
        load_policy(path)
    assert message in str(caught.value) and len(str(caught.value)) < 4000


def test_the_largest_weights_still_give_a_number(tmp_path):
    largest = np.finfo(np.float32).max
    layers = tuple(
        (np.sign(weights) * largest, bias)
        for weights, bias in make_layers((5, *[64] * 5, 1), seed=8)
    )
    statistics = {"mean": np.full(5, 1e300), "variance": np.full(5, 1e-300), "epsilon": 0.0}
    extreme = make_policy(layers=layers, activation="relu", clip=1e6, **statistics)
    observations = np.where(np.random.default_rng(7).random((50, 5)) < 0.5, largest, -largest)
    for changes in (
        {},
        {"variance": np.full(5, 1e300)},
        {"variance": np.zeros(5), "epsilon": 1e-300},
    ):
        assert np.isfinite(replace(extreme, **changes)(observations)).all()
