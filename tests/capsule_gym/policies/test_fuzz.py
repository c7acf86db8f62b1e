"""Random policy files and arguments of policies: an error names them, or the policy acts.

`make fuzz` tries many.
"""

import json
from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays as arrays_of
from hypothesis.extra.numpy import scalar_dtypes
from safetensors.numpy import load, save

from capsule_gym import load_policy
from capsule_gym.policies.policy import POLICY, TEXTS, VALUES
from tests.capsule_gym.policies.test_policy import make_policy
from tests.capsule_gym.policies.test_recurrent import TRAINED, recurrent_policy
from tests.capsule_gym.test_arguments import anything, taken

# numpy may warn of imaginary parts, and of numbers beyond float32, before an argument is refused.
pytestmark = pytest.mark.filterwarnings(
    "ignore::numpy.exceptions.ComplexWarning", "ignore:overflow encountered in cast"
)

LARGEST = float(np.finfo(np.float32).max)
POLICIES = {
    "no cell": make_policy,
    "gru": partial(recurrent_policy, "gru", 3),
    "lstm": partial(recurrent_policy, "lstm", 5, skip=False, activation="relu"),
    "trained": partial(load_policy, TRAINED),
}
TENSORS = (
    "inputs.mean",
    "inputs.variance",
    "cell.weight_ih",
    "cell.weight_hh",
    "cell.bias_ih",
    "cell.bias_hh",
    "layers.0.weight",
    "layers.0.bias",
    "layers.1.weight",
    "layers.1.bias",
    "head.0.weight",
    "head.0.bias",
    "head.1.weight",
    "head.1.bias",
)
of_every_policy = pytest.mark.parametrize("name", POLICIES)
# Numbers of units of the policies, and others.
sizes = st.sampled_from([0, 1, 3, 5, 9, 16, 20, 64]) | st.integers(0, 40)
arrays = st.builds(
    np.full,
    st.lists(sizes, max_size=3).map(tuple),
    st.floats(width=32) | st.sampled_from([LARGEST, -LARGEST]),
    st.sampled_from([np.float32, np.float32, np.float64]),
)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)
words = st.text(max_size=8) | json_values.map(json.dumps) | st.sampled_from(["1", "2", "3", "4"])


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The path of the changed files."""
    return tmp_path_factory.mktemp("changed") / POLICY


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """Gives the bytes of the file of a policy."""

    @cache
    def read(name):
        whole = tmp_path_factory.mktemp("whole") / POLICY
        POLICIES[name]().save(whole)
        return whole.read_bytes()

    return read


def check(path, content):
    """Checks that the file is refused by its path, or that its policy gives finite actions."""
    path.write_bytes(content)
    try:
        policy = load_policy(path)
    except ValueError as error:
        assert str(path) in str(error)
        assert len(str(error)) < 4000
        return
    act = policy.start(range(3))
    rng = np.random.default_rng(0)
    for size in (1.0, 1e3, LARGEST, 1.0):
        observations = size * rng.choice([-1.0, 0.0, 0.7, 1.0], (3, policy.entries))
        actions = act(observations.astype(np.float32))
        assert (np.abs(actions) <= 1.0).all()


def header_end(content):
    return 8 + int.from_bytes(content[:8], "little")


@of_every_policy
@given(
    edits=st.lists(st.tuples(st.integers(0, 2**20), st.integers(0, 255)), max_size=5),
    in_header=st.booleans(),
)
def test_changed_bytes(name, edits, in_header, content, path):
    changed = bytearray(content(name))
    size = header_end(changed) if in_header else len(changed)
    for place, value in edits:
        changed[place % size] = value
    check(path, bytes(changed))


@of_every_policy
@given(first=st.integers(0, 2**20), count=st.integers(0, 100))
def test_missing_bytes(name, first, count, content, path):
    changed = bytearray(content(name))
    first %= len(changed)
    del changed[first : first + count]
    check(path, bytes(changed))


@of_every_policy
@given(changes=st.dictionaries(st.sampled_from(TENSORS), st.none() | arrays, max_size=3))
def test_changed_tensors(name, changes, content, path):
    whole = content(name)
    metadata = json.loads(whole[8 : header_end(whole)])["__metadata__"]
    tensors = {**load(whole), **changes}
    check(path, save({key: each for key, each in tensors.items() if each is not None}, metadata))


@of_every_policy
@given(
    changes=st.dictionaries(
        st.sampled_from(["format", "format_version", *TEXTS, *VALUES]), words, max_size=3
    )
)
def test_changed_metadata(name, changes, content, path):
    whole = content(name)
    metadata = json.loads(whole[8 : header_end(whole)])["__metadata__"]
    check(path, save(load(whole), {**metadata, **changes}))


@pytest.mark.parametrize("name", ["gru", "lstm"])
@given(
    units=st.integers(1, 12),
    inputs=st.integers(1, 12),
    gates=st.sampled_from([3, 4]),
    value=st.floats(-LARGEST, LARGEST, width=32),
)
def test_cells_of_other_sizes(name, units, inputs, gates, value, content, path):
    whole = content(name)
    metadata = json.loads(whole[8 : header_end(whole)])["__metadata__"]
    shapes = {
        "cell.weight_ih": (gates * units, inputs),
        "cell.weight_hh": (gates * units, units),
        "cell.bias_ih": (gates * units,),
        "cell.bias_hh": (gates * units,),
        "layers.0.weight": (inputs, 5),
        "layers.0.bias": (inputs,),
        "head.0.weight": (6, units),
    }
    changes = {key: np.full(shape, value, np.float32) for key, shape in shapes.items()}
    check(path, save({**load(whole), **changes}, metadata))
    assert load_policy(path).memory_size >= units


SHOWN = np.full((3, 5), 0.1, np.float32)


@pytest.fixture(scope="module")
def made():
    """A recurrent policy with 12 units."""
    return recurrent_policy("lstm")


@given(observations=anything | arrays_of(scalar_dtypes(), (3, 5)))
def test_observations(observations, made):
    act = made.start(range(3))
    actions = taken(("observations?",), act, observations=observations)
    assert actions is None or np.isfinite(actions).all()
    found = taken(("observation",), made.predict, observation=observations)
    assert found is None or np.isfinite(found[0]).all()


@given(starts=anything | arrays_of(bool, 3))
def test_starts(starts, made):
    taken(("starts",), made.start(range(3)), observations=SHOWN, starts=starts)
    taken(("episode_start",), made.predict, observation=SHOWN, episode_start=starts)


@given(state=anything | st.tuples(anything) | st.tuples(arrays_of(scalar_dtypes(), (3, 32))))
def test_states(state, made):
    found = taken(("state",), made.predict, observation=SHOWN, state=state)
    assert found is None or np.isfinite(found[0]).all()
