"""Random arguments: invalid ones raise an error that names them, valid ones give finite numbers
(`make fuzz`: more)."""

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

numbers = (
    st.floats() | st.integers() | st.sampled_from([10**400, -(10**400), 5e-324, np.float32(0.1)])
)
scalars = (
    numbers
    | st.none()
    | st.booleans()
    | st.text(max_size=3)
    | st.binary(max_size=3)
    | st.complex_numbers()
)
some_arrays = arrays.arrays(
    arrays.scalar_dtypes(), arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)
)
anything = st.recursive(
    scalars | some_arrays | st.builds(object),
    lambda any_: (
        st.lists(any_, max_size=4)
        | st.dictionaries(st.sampled_from(CHANGE), any_)
        | st.tuples(any_, any_)
    ),
    max_leaves=8,
)
# Numbers of which some are valid.
likely = st.floats(1e-12, 1e12) | st.floats(0.0, 2.0) | st.integers(0, 3)
states = st.lists(st.floats(-1.6, 1.6) | st.floats(-2e6, 2e6), min_size=4, max_size=4)
changes = st.lists(st.fixed_dictionaries(dict.fromkeys(CHANGE, likely)), max_size=3)


def taken(names, function, **arguments):
    """Returns the result of a call; None if the call raises an error that contains one of the
    names."""
    try:
        return function(**arguments)
    except (TypeError, ValueError) as error:
        assert re.search(rf"\b({'|'.join(names)})\b", str(error)), str(error)
        return None


def check_finite(where, value):
    """Checks that a value is finite, also inside dictionaries and arrays of objects."""
    if isinstance(value, dict):
        for name, entry in value.items():
            check_finite(
                f"{where}[{name!r}]",
                np.where(np.isposinf(entry), 0.0, entry) if name in INFINITE else entry,
            )
    elif isinstance(value, np.ndarray) and value.dtype == object:
        for entry in value.ravel():
            check_finite(where, entry)
    else:
        assert value is None or np.isfinite(value).all(), f"{where} is not finite: {value}"


def check(env, method="reset", names=(), **arguments):
    """Checks the observations and the info of a method, unless the environment or the arguments
    have been refused."""
    if env and (result := taken(names, getattr(env, method), **arguments)) is not None:
        assert env.observation_space.contains(result[0])
        check_finite("info", result[-1])


OWN = {CapsuleEnv: [each.name for each in dataclasses.fields(EnvConfig)]}
OWN[CapsuleVectorEnv] = ["num_envs", "max_episode_steps", "autoreset_mode", *OWN[CapsuleEnv]]


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in OWN for name in OWN[kind]])
@given(value=anything | likely)
def test_an_argument_of_an_environment(kind, name, value):
    # Such a large number would be accepted, and would fill the memory.
    if name != "num_envs" or not isinstance(value, int) or not 1000 < value <= MOST_ENVS:
        check(taken((name,), kind, **{name: value}), seed=0)


PARTS = {Capsule: "capsule", Randomization: "randomization", Disturbances: "disturbances"}


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, each.name) for kind in PARTS for each in dataclasses.fields(kind)]
)
@given(value=anything | likely | st.tuples(likely, likely).map(sorted), log_mu=st.booleans())
def test_a_constant_a_range_and_a_disturbance(kind, name, value, log_mu):
    others = {"log_mu": log_mu} if kind is Randomization else {}
    # A mass or a friction may admit Painleve's paradox with the other constants.
    made = taken((name, "mu"), kind, **{**others, name: value})
    if made is not None:
        env = taken(
            ("Randomization", "physics_dt"),
            CapsuleEnv,
            observe_parameters=True,
            **{PARTS[kind]: made},
        )
        check(env, seed=0)


@lru_cache
def made(batch):
    """A shared environment or batch that the tests reset again and again."""
    return CapsuleVectorEnv(3) if batch else CapsuleEnv()


OPTIONS = {
    "M": likely | st.lists(likely, min_size=3, max_size=3),
    "mu": likely | st.lists(likely, min_size=3, max_size=3),
    "state": states | st.lists(states, min_size=3, max_size=3),
    "changes": changes | st.lists(changes, min_size=3, max_size=3),
    "reset_mask": st.lists(st.booleans(), min_size=3, max_size=3).map(np.array),
}


@pytest.mark.parametrize("batch", [False, True])
@pytest.mark.parametrize("name", OPTIONS)
@given(data=st.data())
def test_an_option_of_a_reset(batch, name, data):
    value = data.draw(anything | OPTIONS[name])
    check(made(batch), "reset", (name, "physics_dt"), seed=0, options={name: value})


@pytest.mark.parametrize("batch", [False, True])
@given(
    seed=anything | st.integers(0) | st.lists(st.integers(0) | st.none(), min_size=3, max_size=3)
)
def test_a_seed_of_a_reset(batch, seed):
    check(made(batch), "reset", ("seed",), seed=seed)


@pytest.mark.parametrize("batch", [False, True])
@given(actions=anything | arrays.arrays(np.float32, st.sampled_from([(1,), (3, 1)])))
def test_the_actions_of_a_step(batch, actions):
    made(batch).reset(seed=0)
    check(made(batch), "step", ("action", "actions"), **{"actions" if batch else "action": actions})


PLANTS = {
    **dict.fromkeys(("M", "m", "l", "g"), st.floats(0.01, 100.0)),
    **dict.fromkeys(("k", "c", "mu"), st.floats(0.0, 3.0)),
    **dict.fromkeys(("static_ratio", "backward_ratio"), st.floats(1.0, 3.0)),
}
ARGUMENTS = {
    "controller": st.sampled_from([None, "baselines:adaptive"]), "residual_limit": st.floats(1e-6, 30.0),
    "total_torque": st.booleans(), "torque_limit": st.floats(0.1, 50.0), "observe_parameters": st.booleans(),
    "randomization": st.sampled_from(["none", "paper", "wide"]), "energy_weight": st.floats(0.0, 100.0),
    "initial_noise": st.floats(0.0, 0.5), "initial_range": st.none(),
    "control_dt": st.sampled_from([0.02, 0.01, 0.1]), "physics_dt": st.sampled_from([1e-3, 5e-4]),
}  # fmt: skip
BATCH_ARGUMENTS = {
    "num_envs": st.sampled_from([1, 2, LANES + 1]), "max_episode_steps": st.sampled_from([1, 7, 1650]),
    "threads": st.integers(1, 3), "autoreset_mode": st.sampled_from(["NEXT_STEP", "SAME_STEP", "DISABLED"]),
}  # fmt: skip
# Actions of an episode: noise, bang-bang, full torque, none, numbers next to the largest and the
# smallest.
DRIVES = (
    lambda rng, step, n: rng.uniform(-1.5, 1.5, (n, 1)),
    lambda rng, step, n: np.full((n, 1), 1.0 if step % 20 < 10 else -1.0),
    lambda rng, step, n: np.full((n, 1), rng.choice([-1.0, 1.0])),
    lambda rng, step, n: np.zeros((n, 1)),
    lambda rng, step, n: np.full((n, 1), rng.choice([-0.0, 1e-45, 3e38, -3e38])),
)


@pytest.mark.parametrize("batch", [False, True])
@given(data=st.data(), drive=st.sampled_from(DRIVES), steps=st.integers(1, 60))
def test_a_short_episode(batch, data, drive, steps):
    capsule = taken(
        ("Capsule", "mu"), Capsule, **data.draw(st.fixed_dictionaries({}, optional=PLANTS))
    )
    arguments = data.draw(st.fixed_dictionaries({}, optional=ARGUMENTS)) | {"capsule": capsule}
    if batch:
        arguments |= data.draw(st.fixed_dictionaries(BATCH_ARGUMENTS))
    env = taken(
        ("physics_dt", "Randomization", "M"), CapsuleVectorEnv if batch else CapsuleEnv, **arguments
    )
    # A plant may be too stiff for the step, or the ranges may admit Painleve's paradox.
    if env is None:
        return
    rng, n = np.random.default_rng(steps), arguments.get("num_envs", 1)
    options = data.draw(st.fixed_dictionaries({}, optional={"state": states}))
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
# For each environment: options of a reset.
BAD_OPTIONS = {
    "speed": [
        ({"mass": 1.0}, ValueError, "mass"),
        ([1.0], TypeError, "options must be a dict"),
        (
            {"state": [0.3, 1e120, 0.0, 0.0]},
            ValueError,
            r"\|theta_dot\| <= 1000 rad/s, .* and \|x_dot\| <= 1000 m/s",
        ),
        ({"state": [0.5 * np.pi, 0.0, 0.0, 0.0]}, ValueError, r"\|theta\| < pi/2"),
        (
            {"changes": [{"t": 1.0, "M": 0.5}]},
            ValueError,
            r"options\['changes'\]\[0\] must be a dict with the keys",
        ),
        (
            {"changes": [JUMP, {**JUMP, "t": 0.5}]},
            ValueError,
            r"\[1\]\['t'\] must be later .*, 1 s, got 0.5 s",
        ),
        ({"changes": [JUMP, JUMP]}, ValueError, r"\[1\]\['t'\] must be later .*, 1 s, got 1 s"),
        (
            {"changes": [{"t": 1.0, "M": 0.001, "mu": 2.0}]},
            ValueError,
            r"options\['changes'\]\[0\]: .*Painleve",
        ),
        (
            {"capsule": {"l": 0.3}},
            ValueError,
            r"options\['capsule'\] needs an environment with disturbances",
        ),
    ],
    "velocity": [
        ({"commands": [COMMAND] * 9}, ValueError, "must be a list of 1 to 8 .* got 9"),
        (
            {"commands": [{**COMMAND, "t": 1.0}]},
            ValueError,
            r"^options\['commands'\]\[0\]\['t'\] must be 0 s for the",
        ),
        (
            {"commands": [{**COMMAND, "v": 0.3}]},
            ValueError,
            r"\['v'\] must be a number of m/s within 0.2 of 0",
        ),
    ],
    "goal": [
        *(({"goal": goal}, ValueError, NO_GOAL) for goal in (np.inf, -2e6)),
        *(({"goal": goal}, TypeError, NO_GOAL) for goal in ("far", [0.1])),
    ],
    "batch": [
        (
            {"state": [[0.0] * 4, [0.1]]},
            TypeError,
            r"options\['state'\] must be .*, got \[\[0\.0, ",
        ),
        (
            {"changes": 1.0},
            TypeError,
            r"options\['changes'\] must be .* one entry per environment .*, got 1.0",
        ),
        (
            {"M": [0.5] * 3},
            ValueError,
            r"options\['M'\] must be .* one entry per environment \(2\), got 3",
        ),
        ({"state": [[0.0] * 4] * 3}, ValueError, r"of shape \(3, 4\)"),
        ({"reset_mask": np.array([False, False])}, ValueError, "reset_mask"),
    ],
}
BAD_CASES = [(name, *case) for name, cases in BAD_OPTIONS.items() for case in cases]


@pytest.mark.parametrize(("name", "options", "error", "message"), BAD_CASES)
def test_bad_options_are_named_and_change_nothing(name, options, error, message):
    env, other = (
        CapsuleVectorEnv(2) if name == "batch" else CapsuleEnv(task=name) for _ in range(2)
    )
    env.reset(seed=0), other.reset(seed=0)
    before = env.simulation.world.tobytes()
    with pytest.raises(error, match=message):
        env.reset(options=options)
    assert env.simulation.world.tobytes() == before
    assert np.array_equal(env.reset()[0], other.reset()[0])


@pytest.mark.parametrize("name", DIVISORS)
def test_what_the_core_divides_by_is_0_or_has_a_smallest_size(name):
    kind, argument = (
        (Capsule, "capsule") if name == "stribeck_speed" else (Disturbances, "disturbances")
    )
    for value in (1e-320, 0.5e-12):
        with pytest.raises(ValueError, match=f"{name} must be 0 or at least 1e-12, got {value!r}"):
            kind(**{name: value})
        env = CapsuleEnv(disturbances="real")
        with pytest.raises(
            ValueError, match=f"{name}.* must be 0 or at least 1e-12, got {value!r}"
        ):
            env.reset(options={argument: {name: value}})
    for value in (0.0, 1e-12):
        env = CapsuleEnv(
            **{"disturbances": "real", argument: kind(**{name: value})}, randomization="none"
        )
        env.reset(seed=0)
        assert all(np.isfinite(env.step(np.full(1, 0.3, np.float32))[0]).all() for _ in range(5))


ALONE = [
    np.zeros(2),
    np.array([np.nan]),
    np.zeros((1, 1)),
    0.5,
    np.array([np.inf]),
    ["a"],
    None,
    {},
]
SEVERAL = [np.zeros(2), np.zeros((3, 1)), np.array([[0.0], [np.nan]]), [["a"], ["b"]], None]


@pytest.mark.parametrize(
    ("n", "action"), [*((None, each) for each in ALONE), *((2, each) for each in SEVERAL)]
)
def test_bad_actions_are_named(n, action):
    env = CapsuleVectorEnv(n) if n else CapsuleEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"^actions? must be"):
        env.step(action)
