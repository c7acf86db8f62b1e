"""Random arguments: errors name invalid ones, valid ones give finite numbers (`make fuzz`)."""

import dataclasses
import re
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, Disturbances, Randomization
from capsule_gym.core.layout import LANES
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.simulation import MOST_ENVS
from capsule_gym.parameters.limits import DIVISORS
from capsule_gym.tasks.task import CHANGE

# numpy may warn of imaginary parts, and of numbers beyond float32, before an action is refused.
pytestmark = pytest.mark.filterwarnings(
    "ignore::numpy.exceptions.ComplexWarning", "ignore:overflow encountered in cast"
)

# Infinite in an episode without forward travel, or in one that has not been stepped.
INFINITE = ("cost_of_transport", "backward_ratio", "smallest_normal_ratio")

extremes = st.sampled_from([10**400, -(10**400), 5e-324, np.float32(0.1)])
numbers = st.floats() | st.integers() | extremes
words = st.text(max_size=3) | st.binary(max_size=3)
scalars = numbers | st.none() | st.booleans() | words | st.complex_numbers()
shapes = arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)
some_arrays = arrays.arrays(arrays.scalar_dtypes(), shapes)


def containers(values):
    dicts = st.dictionaries(st.sampled_from(CHANGE), values)
    return st.lists(values, max_size=4) | dicts | st.tuples(values, values)


anything = st.recursive(scalars | some_arrays | st.builds(object), containers, max_leaves=8)
# Numbers of which some are valid.
likely = st.floats(1e-12, 1e12) | st.floats(0.0, 2.0) | st.integers(0, 3)
states = st.lists(st.floats(-1.6, 1.6) | st.floats(-2e6, 2e6), min_size=4, max_size=4)
change = st.fixed_dictionaries(dict.fromkeys(CHANGE, likely))
changes = st.lists(change, max_size=3)


def three(values):
    return st.lists(values, min_size=3, max_size=3)


def taken(names, function, **arguments):
    """The result of a call; None if the call raises an error that contains one of the names."""
    try:
        return function(**arguments)
    except (TypeError, ValueError) as error:
        message = str(error)
        assert re.search(rf"\b({'|'.join(names)})\b", message), message
        return None


def check_finite(where, value):
    """Checks that a value is finite, also inside dictionaries and arrays of objects."""
    if isinstance(value, dict):
        for name, entry in value.items():
            if name in INFINITE:
                entry = np.where(np.isposinf(entry), 0.0, entry)
            check_finite(f"{where}[{name!r}]", entry)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        for entry in value.ravel():
            check_finite(where, entry)
    else:
        assert value is None or np.isfinite(value).all(), f"{where} is not finite: {value}"


def check(env, method="reset", names=(), **arguments):
    """Checks the result of a method, unless the environment or the arguments have been refused."""
    if env is None:
        return
    result = taken(names, getattr(env, method), **arguments)
    if result is not None:
        assert env.observation_space.contains(result[0])
        check_finite("info", result[-1])


def names_of(kind):
    return [field.name for field in dataclasses.fields(kind)]


BATCH_NAMES = ("num_envs", "max_episode_steps", "autoreset_mode")


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *((CapsuleEnv, name) for name in names_of(EnvConfig)),
        *((CapsuleVectorEnv, name) for name in (*BATCH_NAMES, *names_of(EnvConfig))),
    ],
)
@given(value=anything | likely)
def test_an_argument_of_an_environment(kind, name, value):
    # Such a large number would be accepted, and would fill the memory.
    if name != "num_envs" or not isinstance(value, int) or not 1000 < value <= MOST_ENVS:
        check(taken((name,), kind, **{name: value}), seed=0)


@pytest.mark.parametrize(
    ("argument", "kind", "name"),
    [
        (argument, kind, name)
        for argument, kind in (
            ("capsule", Capsule),
            ("randomization", Randomization),
            ("disturbances", Disturbances),
        )
        for name in names_of(kind)
    ],
)
@given(value=anything | likely | st.tuples(likely, likely).map(sorted), log_mu=st.booleans())
def test_a_field_of_an_argument(argument, kind, name, value, log_mu):
    fields = {"mu": (0.01, 0.1), "log_mu": log_mu} if kind is Randomization else {}
    fields[name] = value
    # A mass or a friction may admit Painleve's paradox with the other constants.
    made = taken((name, "mu"), kind, **fields)
    if made is not None:
        names = ("Randomization", "physics_dt")
        arguments = {"randomization": "none", argument: made}
        env = taken(names, CapsuleEnv, observe_parameters=True, **arguments)
        check(env, seed=0)


@lru_cache
def made(batch):
    """A shared environment or batch that the tests reset again and again."""
    return CapsuleVectorEnv(3) if batch else CapsuleEnv()


OPTIONS = {
    "M": likely | three(likely),
    "mu": likely | three(likely),
    "state": states | three(states),
    "changes": changes | three(changes),
    "reset_mask": three(st.booleans()).map(np.array),
}


@pytest.mark.parametrize("batch", [False, True])
@pytest.mark.parametrize("name", OPTIONS)
@given(data=st.data())
def test_an_option_of_a_reset(batch, name, data):
    value = data.draw(anything | OPTIONS[name])
    check(made(batch), "reset", (name, "physics_dt"), seed=0, options={name: value})


@pytest.mark.parametrize("batch", [False, True])
@given(seed=anything | st.integers(0) | three(st.integers(0) | st.none()))
def test_a_seed_of_a_reset(batch, seed):
    check(made(batch), "reset", ("seed",), seed=seed)


@pytest.mark.parametrize("batch", [False, True])
@given(actions=anything | arrays.arrays(np.float32, st.sampled_from([(1,), (3, 1)])))
def test_the_actions_of_a_step(batch, actions):
    env = made(batch)
    env.reset(seed=0)
    name = "actions" if batch else "action"
    check(env, "step", ("action", "actions"), **{name: actions})


def optional(**strategies):
    return st.fixed_dictionaries({}, optional=strategies)


@pytest.mark.parametrize("batch", [False, True])
@given(
    plant=optional(
        **dict.fromkeys(("M", "m", "l", "g"), st.floats(0.01, 100.0)),
        **dict.fromkeys(("k", "c", "mu"), st.floats(0.0, 3.0)),
        **dict.fromkeys(("static_ratio", "backward_ratio"), st.floats(1.0, 3.0)),
    ),
    arguments=optional(
        controller=st.sampled_from([None, "baselines:adaptive"]),
        residual_limit=st.floats(1e-6, 30.0),
        total_torque=st.booleans(),
        torque_limit=st.floats(0.1, 50.0),
        observe_parameters=st.booleans(),
        randomization=st.sampled_from(["none", "paper", "wide"]),
        energy_weight=st.floats(0.0, 100.0),
        initial_noise=st.floats(0.0, 0.5),
        initial_range=st.none(),
        control_dt=st.sampled_from([0.02, 0.01, 0.1]),
        physics_dt=st.sampled_from([1e-3, 5e-4]),
    ),
    of_batch=st.fixed_dictionaries(
        {
            "num_envs": st.sampled_from([1, 2, LANES + 1]),
            "max_episode_steps": st.sampled_from([1, 7, 1650]),
            "threads": st.integers(1, 3),
            "autoreset_mode": st.sampled_from(["NEXT_STEP", "SAME_STEP", "DISABLED"]),
        }
    ),
    options=optional(state=states),
    # Noise, bang-bang, full torque, none, numbers next to the largest and the smallest.
    drive=st.sampled_from(
        [
            lambda rng, step, n: rng.uniform(-1.5, 1.5, (n, 1)),
            lambda rng, step, n: np.full((n, 1), 1.0 if step % 20 < 10 else -1.0),
            lambda rng, step, n: np.full((n, 1), rng.choice([-1.0, 1.0])),
            lambda rng, step, n: np.zeros((n, 1)),
            lambda rng, step, n: np.full((n, 1), rng.choice([-0.0, 1e-45, 3e38, -3e38])),
        ]
    ),
    steps=st.integers(1, 60),
)
def test_a_short_episode(batch, plant, arguments, of_batch, options, drive, steps):
    arguments |= {"capsule": taken(("Capsule", "mu"), Capsule, **plant)}
    if batch:
        arguments |= of_batch
    kind = CapsuleVectorEnv if batch else CapsuleEnv
    names = ("physics_dt", "Randomization", "M", "randomization", "total_torque")
    env = taken(names, kind, **arguments)
    # A plant may be too stiff for the step, or the ranges may admit Painleve's paradox.
    if env is None:
        return
    rng = np.random.default_rng(steps)
    n = arguments.get("num_envs", 1)
    if taken(("state",), env.reset, seed=0, options=options) is None:
        env.reset(seed=0)
    for step in range(steps):
        actions = drive(rng, step, n).astype(np.float32)
        observation, reward, terminated, _, info = env.step(actions if batch else actions[0])
        assert env.observation_space.contains(observation)
        check_finite("info", {**info, "reward": reward})
        if not batch and terminated:
            break
    check_finite("metrics", env.episode_metrics() if batch else env.episode_metrics(1650))
    env.close()


JUMP = {"t": 1.0, "M": 0.5, "mu": 0.01}
COMMAND = {"t": 0.0, "v": 0.1}
NO_GOAL = r"^options\['goal'\] must be a finite number of m within 1e\+06 of 0, got "
NO_CHANGES = r"options\['changes'\]\[0\] must be a dict with the keys"
NO_COMMAND = r"^options\['commands'\]\[0\]\['t'\] must be 0 s for the"


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("speed", {"mass": 1.0}, ValueError, "mass"),
        ("speed", [1.0], TypeError, "options must be a dict"),
        (
            "speed",
            {"state": [0.3, 1e120, 0.0, 0.0]},
            ValueError,
            r"\|theta_dot\| <= 1000 rad/s, .* and \|x_dot\| <= 1000 m/s, got \[0\.3, ",
        ),
        ("speed", {"state": [0.5 * np.pi, 0.0, 0.0, 0.0]}, ValueError, r"\|theta\| < pi/2"),
        ("speed", {"changes": [{"t": 1.0, "M": 0.5}]}, ValueError, NO_CHANGES),
        (
            "speed",
            {"changes": [JUMP, {**JUMP, "t": 0.5}]},
            ValueError,
            r"\[1\]\['t'\] must be later .*, 1 s, got 0.5 s",
        ),
        (
            "speed",
            {"changes": [JUMP, JUMP]},
            ValueError,
            r"\[1\]\['t'\] must be later .*, 1 s, got 1 s",
        ),
        (
            "speed",
            {"changes": [{"t": 1.0, "M": 0.001, "mu": 2.0}]},
            ValueError,
            r"options\['changes'\]\[0\]: .*Painleve",
        ),
        (
            "speed",
            {"capsule": {"l": 0.3}},
            ValueError,
            r"options\['capsule'\] needs an environment with disturbances",
        ),
        (
            "velocity",
            {"commands": [COMMAND] * 9},
            ValueError,
            "must be a list of 1 to 8 .* got 9",
        ),
        ("velocity", {"commands": [{**COMMAND, "t": 1.0}]}, ValueError, NO_COMMAND),
        (
            "velocity",
            {"commands": [{**COMMAND, "v": 0.3}]},
            ValueError,
            r"\['v'\] must be a number of m/s within 0.2 of 0",
        ),
        ("goal", {"goal": np.inf}, ValueError, NO_GOAL),
        ("goal", {"goal": -2e6}, ValueError, NO_GOAL),
        ("goal", {"goal": "far"}, TypeError, NO_GOAL),
        ("goal", {"goal": [0.1]}, TypeError, NO_GOAL),
        (
            "batch",
            {"state": [[0.0] * 4, [0.1]]},
            TypeError,
            r"options\['state'\] must be .*, got \[\[0\.0, ",
        ),
        (
            "batch",
            {"changes": 1.0},
            TypeError,
            r"options\['changes'\] must be .* one entry per environment .*, got 1.0",
        ),
        (
            "batch",
            {"M": [0.5] * 3},
            ValueError,
            r"options\['M'\] must be .* one entry per environment \(2\), got 3",
        ),
        ("batch", {"state": [[0.0] * 4] * 3}, ValueError, r"of shape \(3, 4\)"),
        (
            "batch",
            {"state": [[0.0] * 4, [0.5 * np.pi, 0.0, 0.0, 0.0]]},
            ValueError,
            r"\|theta\| < pi/2",
        ),
        ("batch", {"capsule": [{}, {"l": 0.3}]}, ValueError, r"options\['capsule'\] needs an"),
        ("batch", {"reset_mask": np.array([False, False])}, ValueError, "reset_mask"),
    ],
)
def test_bad_options_are_named_and_change_nothing(name, options, error, message):
    def make():
        env = CapsuleVectorEnv(2) if name == "batch" else CapsuleEnv(task=name)
        env.reset(seed=0)
        return env

    env = make()
    before = env.simulation.world.tobytes()
    with pytest.raises(error, match=message):
        env.reset(options=options)
    assert env.simulation.world.tobytes() == before
    assert np.array_equal(env.reset()[0], make().reset()[0])


ARGUMENT_OF_DIVISOR = dict.fromkeys(DIVISORS, (Disturbances, "disturbances"))
ARGUMENT_OF_DIVISOR["stribeck_speed"] = (Capsule, "capsule")


@pytest.mark.parametrize("name", DIVISORS)
@pytest.mark.parametrize("value", [1e-320, 0.5e-12])
def test_what_the_core_divides_by_must_not_be_small(name, value):
    kind, argument = ARGUMENT_OF_DIVISOR[name]
    message = f"must be 0 or at least 1e-12, got {value!r}"
    with pytest.raises(ValueError, match=f"{name} {message}"):
        kind(**{name: value})
    with pytest.raises(ValueError, match=f"{name}.* {message}"):
        CapsuleEnv(disturbances="real").reset(options={argument: {name: value}})


@pytest.mark.parametrize("name", DIVISORS)
@pytest.mark.parametrize("value", [0.0, 1e-12])
def test_what_the_core_divides_by_may_be_0_or_the_smallest_size(name, value):
    kind, argument = ARGUMENT_OF_DIVISOR[name]
    arguments = {"disturbances": "real", argument: kind(**{name: value})}
    env = CapsuleEnv(**arguments, randomization="none")
    env.reset(seed=0)
    for _ in range(5):
        observation, *_ = env.step(np.full(1, 0.3, np.float32))
        assert np.isfinite(observation).all()


@pytest.mark.parametrize("make", [CapsuleEnv, CapsuleVectorEnv])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_largest_state_is_accepted(make, sign):
    state = [0.0, sign * 1e3, sign * 1e6, sign * 1e3]
    _, info = make().reset(options={"state": state})
    assert np.ravel(info["state"]).tolist() == state


@pytest.mark.parametrize("make", [CapsuleEnv, CapsuleVectorEnv])
def test_an_option_of_none_is_not_given(make):
    env = make(randomization="wide")
    drawn, plain = (env.reset(seed=3, options=options)[1] for options in ({"M": None}, {}))
    assert drawn["M"] == plain["M"]


@pytest.mark.parametrize(
    "action",
    [
        np.zeros(2),
        np.array([np.nan]),
        np.zeros((1, 1)),
        0.5,
        np.array([np.inf]),
        np.array([1j]),
        ["a"],
        None,
        {},
    ],
)
def test_a_bad_action_is_named(action):
    env = CapsuleEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"^actions? must be"):
        env.step(action)


@pytest.mark.parametrize(
    "actions",
    [np.zeros(2), np.zeros((3, 1)), np.array([[0.0], [np.nan]]), [["a"], ["b"]], None],
)
def test_bad_actions_of_a_batch_are_named(actions):
    batch = CapsuleVectorEnv(2)
    batch.reset(seed=0)
    with pytest.raises(ValueError, match=r"^actions? must be"):
        batch.step(actions)
