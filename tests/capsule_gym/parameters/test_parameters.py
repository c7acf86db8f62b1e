import ast
import dataclasses
import math
import re
from contextlib import suppress

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, dynamics
from capsule_gym.control.controller import Controller, CoreLaw
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.simulation import Simulation
from capsule_gym.parameters import (
    DISTURBANCES,
    RANDOMIZATIONS,
    REAL,
    Capsule,
    Disturbances,
    Randomization,
)
from tests import ROOT

POSITIVE = ("M", "m", "l", "g", "backward_ratio")
NON_NEGATIVE = ("k", "c", "mu", "viscous", "motor_friction")
LOWEST = dict.fromkeys(POSITIVE, 1e-12) | dict.fromkeys(NON_NEGATIVE, 0.0) | {"static_ratio": 1.0}
BELOW = {0.0: -5e-324, 1e-12: 9e-13, 1.0: 0.999}
EACH_CONSTANT = pytest.mark.parametrize("field", LOWEST)


def test_a_plant_is_computed_in_float64_even_if_its_constants_were_narrower():
    narrow = {
        "M": np.float16(0.5),
        "m": np.float16(0.1),
        "l": np.float32(0.3),
        "c": np.float16(0.01),
    }
    wide = {name: float(value) for name, value in narrow.items()}
    assert Capsule(**narrow).plant() == Capsule(**wide).plant()


def refuses(error, field, value, more=""):
    """Asserts that the error names a constant, its value and what is accepted."""
    accepted = f"a finite number from {LOWEST[field]:g} to 1e+12"
    message = f"Capsule.{field} must be {accepted}, got {value!r}{more}"
    with pytest.raises(error, match=re.escape(message)):
        Capsule(**{field: value})


@EACH_CONSTANT
@pytest.mark.parametrize("value", [math.nan, math.inf, 1.1e12, 10**400], ids=repr)
def test_a_constant_out_of_range_is_named(field, value):
    refuses(ValueError, field, value)


@pytest.mark.parametrize("kind", [Capsule, Disturbances, EnvConfig, Randomization])
def test_settings_cannot_be_changed(kind):
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(kind(), dataclasses.fields(kind)[0].name, 1.0)


@pytest.mark.parametrize("kind", [Capsule, Disturbances, Randomization])
def test_settings_have_names(kind):
    with pytest.raises(TypeError, match="positional argument"):
        kind(0.1)


@EACH_CONSTANT
def test_a_constant_below_its_lowest_value_is_named(field):
    refuses(ValueError, field, BELOW[LOWEST[field]])


@EACH_CONSTANT
@pytest.mark.parametrize(
    "value", ["0.3", None, True, np.True_, np.array(True), np.array([0.3])], ids=repr
)
def test_a_constant_that_is_no_number_is_named_with_its_type(field, value):
    refuses(TypeError, field, value, " of type")


@pytest.mark.parametrize("value", [np.array(0.3), np.float32(0.3), np.array(1)], ids=repr)
def test_a_number_of_numpy_is_a_constant(value):
    found = Capsule(mu=value).mu
    assert type(found) is float
    assert found == value


@pytest.mark.parametrize("field", NON_NEGATIVE)
def test_a_constant_may_be_zero(field):
    plant = Capsule(**{field: 0}).plant()
    assert getattr(plant, field) == 0.0


def draw_with_paradox(rng):
    """Random fields of a capsule, the ratio of the largest coefficient that acts to mu, and
    whether the determinant of the slip equations vanishes with it at some angle."""
    M, m, mu = rng.uniform(0.01, 1.0), rng.uniform(0.1, 2.0), rng.uniform(0.0, 3.0)
    static, backward = rng.uniform(1.0, 2.0), rng.uniform(0.2, 2.0)
    ratio = static * max(1.0, backward)
    theta = np.linspace(-math.pi, math.pi, 200_001)
    sine, cosine = np.sin(theta), np.cos(theta)
    determinant = M + m * sine**2 - ratio * mu * m * sine * cosine
    fields = {"M": M, "m": m, "mu": mu, "static_ratio": static, "backward_ratio": backward}
    return fields, ratio, determinant.min() <= 0.0


def test_painleves_paradox_is_refused_exactly_where_the_slip_equations_are_singular():
    rng = np.random.default_rng(3)
    outcomes = set()
    for _ in range(60):
        fields, ratio, singular = draw_with_paradox(rng)
        outcomes.add(bool(singular))
        if not singular:
            Capsule(**fields)
            continue
        with pytest.raises(ValueError, match=r"M=\d.*mu=\d.*must stay below") as caught:
            Capsule(**fields)
        # The message names the largest coefficient that is accepted.
        *_, largest = str(caught.value).split()
        limit = float(largest) / ratio
        Capsule(**fields | {"mu": 0.999 * limit})
        with pytest.raises(ValueError, match="Painleve"):
            Capsule(**fields | {"mu": 1.001 * limit})
    assert outcomes == {True, False}


def test_a_plant_may_have_another_mass_and_friction():
    assert Capsule().plant(M=0.7, mu=0.2) == Capsule(M=0.7, mu=0.2).plant()


@pytest.mark.parametrize("check", [Capsule().plant, Capsule().check_plant])
@pytest.mark.parametrize(
    ("M", "mu"),
    [(0.0, 0.1), (math.nan, 0.1), (0.5, -1.0), (0.01, 3.0), (1e300, 0.1), (0.5, 1e300)],
)
def test_an_invalid_mass_or_friction_of_a_plant_is_refused(check, M, mu):
    with pytest.raises(ValueError, match=r"must be|Painleve"):
        check(M, mu)


def largest_eigenvalue(p, x_dot=0.0):
    """The largest absolute eigenvalue of the motion linearised at many angles.

    A torque holds the pendulum at each of them.
    """
    theta = np.linspace(-1.57, 1.57, 51)
    h = 1e-5
    angle, rate, speed = h * np.concatenate([np.eye(3), -np.eye(3)]).T[..., None]
    found = []
    for slip in (1.0, -1.0):
        v = slip * x_dot
        still = dynamics.accelerations(theta, 0.0, v, slip, 0.0, p).theta_ddot
        pushed = dynamics.accelerations(theta, 0.0, v, slip, 1.0, p).theta_ddot
        holding = still / (still - pushed)
        theta_ddot, x_ddot, _ = dynamics.accelerations(
            theta + angle, rate, v + speed, slip, holding, p
        )
        motions = np.stack(np.broadcast_arrays(rate, theta_ddot, x_ddot))
        slopes = (motions[:, :3] - motions[:, 3:]) / (2 * h)
        found.append(np.abs(np.linalg.eigvals(slopes.T)).max())
    return max(found)


def valid_capsules(normal_force):
    """Twenty random capsules without Painleve's paradox."""
    rng = np.random.default_rng(7)
    names = ("M", "m", "l", "k", "c", "mu", "backward_ratio")
    found = []
    while len(found) < 20:
        fields = dict(zip(names, 10.0 ** rng.uniform(-1.5, 0.5, len(names)), strict=True))
        if len(found) % 2 == 1:
            # Every other spring is stiffer than gravity.
            fields["k"] *= 30.0
        with suppress(ValueError):
            found.append(Capsule(**fields, normal_force=normal_force))
    return found


@pytest.mark.parametrize(("normal_force", "close"), [("newton", 0.5), ("paper", 0.2)])
def test_the_fastest_rate_bounds_every_eigenvalue_closely(normal_force, close):
    for capsule in valid_capsules(normal_force):
        rate = capsule.fastest_rate(capsule.M, capsule.mu)
        found = largest_eigenvalue(capsule.plant())
        assert close * rate < found < rate * (1.0 + 1e-4), capsule


@pytest.mark.parametrize("normal_force", ["newton", "paper"])
def test_a_lighter_platform_and_a_rougher_floor_have_faster_rates(normal_force):
    """Only one corner of the ranges has to be checked."""
    for capsule in valid_capsules(normal_force):
        rate = capsule.fastest_rate(capsule.M, capsule.mu)
        assert capsule.fastest_rate(1.1 * capsule.M, capsule.mu) < rate
        assert capsule.fastest_rate(capsule.M, 0.9 * capsule.mu) < rate


@pytest.mark.parametrize(
    "capsule",
    [
        Capsule(c=5.0, mu=0.5),
        Capsule(c=5.0, mu=0.5, normal_force="paper"),
        Capsule(k=500.0, mu=0.5),
        Capsule(k=500.0, mu=0.5, normal_force="paper"),
        Capsule(k=0.8, c=0.0, mu=1.5, M=50.0),
        Capsule(k=0.0, c=0.0, mu=0.5),
        Capsule(viscous=30.0),
        Capsule(viscous=300.0, mu=1.0, M=0.1),
        Capsule(motor_friction=1.0),
        Capsule(stribeck_speed=1e-3, static_ratio=2, mu=0.1),
    ],
)
def test_the_rate_of_a_constant_that_dominates_is_close(capsule):
    # The Stribeck curve is steepest at this velocity.
    x_dot = capsule.stribeck_speed / math.sqrt(3.0)
    found = largest_eigenvalue(capsule.plant(), x_dot)
    assert 0.85 < found / capsule.fastest_rate(capsule.M, capsule.mu) < 1.0


@pytest.mark.parametrize(
    ("ranges", "capsule", "message"),
    [
        (
            {"M": (0.05, 1.0), "mu": (0.0, 2.0)},
            Capsule(),
            r"M in \[0\.05, 1\] kg, mu in \[0, 2\]\): .*Painleve",
        ),
        ({"M": (0.05, 1.0)}, Capsule(mu=2.0), ".*Painleve"),
        ({"m": (0.1, 40.0), "mu": (0.5, 9.0)}, Capsule(), ".*Painleve"),
        ({"M": (0.1, 1e300)}, Capsule(), ".*must be a finite number from"),
        ({"mu": (0.0, 1e300)}, Capsule(), ".*must be a finite number from"),
    ],
)
def test_every_corner_of_the_ranges_is_checked(ranges, capsule, message):
    randomization = Randomization(**ranges)
    with pytest.raises(ValueError, match=rf"^Randomization\({message}"):
        randomization.corners(capsule)


@pytest.mark.parametrize(
    "randomization",
    [*RANDOMIZATIONS.values(), Randomization(M=(0.05, 1.0)), Randomization(mu=(0.0, 2.0))],
    ids=str,
)
def test_ranges_without_the_paradox_are_accepted(randomization):
    assert len(randomization.corners(Capsule())) == 2 ** len(randomization.drawn)


FIELDS = {field.name: field for field in dataclasses.fields(EnvConfig)}
NUMBERS = [name for name, field in FIELDS.items() if field.type in ("float", "float | None")]
OPTIONS = [*NUMBERS, "initial_range", "observe_parameters", "capsule", "randomization", "threads"]


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 10**400], ids=repr)
def test_an_option_out_of_range_is_named(name, value):
    with pytest.raises(ValueError, match=rf"^{name} must be a .*number.*, got {value!r}"):
        EnvConfig(**{name: value})


@pytest.mark.parametrize(
    "name", ["torque_limit", "residual_limit", "energy_weight", "termination_penalty"]
)
def test_an_option_whose_sums_would_be_infinite_is_named(name):
    message = rf"^{name} must be a finite number .*, at most 1e\+\d+, got 1e\+300"
    with pytest.raises(ValueError, match=message):
        EnvConfig(**{name: 1e300})


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize("value", [[1.0], 1j, b"1"])
def test_an_option_of_a_wrong_type_is_named(name, value):
    with pytest.raises(TypeError, match=rf"^{name} must be .*, got {re.escape(repr(value))}"):
        EnvConfig(**{name: value})


BETWEEN = Controller("2.75 ms", CoreLaw("none"), np.zeros((1, 2)), dt=0.00275)


@pytest.mark.parametrize(
    ("options", "residual_limit", "physics_dt", "physics_steps", "law_steps"),
    [
        ({"torque_limit": 2.0}, 2.0, 2e-3, 10, 1),
        ({"controller": "baselines:adaptive"}, 1.5, 1e-3, 1, 20),
        # The longest step that divides the period.
        ({"control_dt": 0.005}, 1.5, 0.005 / 3, 3, 1),
        ({"control_dt": 0.006}, 1.5, 2e-3, 3, 1),
        ({"control_dt": 1e-3}, 1.5, 1e-3, 1, 1),
        ({"control_dt": 0.0055, "controller": BETWEEN}, 1.5, 0.00275 / 3, 3, 2),
    ],
)
def test_options_of_none_follow_from_the_others(
    options, residual_limit, physics_dt, physics_steps, law_steps
):
    settings = Simulation(1, EnvConfig(**options)).settings
    assert settings.residual_limit == residual_limit
    assert settings.physics_dt == physics_dt
    assert settings.physics_steps == physics_steps
    assert settings.law_steps == law_steps


def test_the_documentation_states_defaults():
    rows = dict(re.findall(r"\| `(\w+)` \| `(.*?)` \|", CapsuleEnv.__doc__))
    assert rows.pop("residual_limit") == "torque_limit"
    assert rows.pop("capsule") == "Capsule()"
    defaults = {name: ast.literal_eval(text) for name, text in rows.items()}
    assert EnvConfig(**defaults) == EnvConfig()


@pytest.mark.parametrize(("name", "ranges"), RANDOMIZATIONS.items())
def test_the_documentation_states_ranges(name, ranges):
    assert f'"{name}": {ranges}' in CapsuleEnv.__doc__


@pytest.mark.parametrize("name", DISTURBANCES)
def test_the_documentation_states_the_disturbances_of_real(name):
    value = getattr(REAL, name)
    if name == "latency":
        # The table states the middle of the range.
        value = np.mean(value)
    table = (ROOT / "docs" / "sensitivity_tables.md").read_text(encoding="utf-8")
    assert value == getattr(Disturbances(), name) or f"`{name}={value}`" in table


@pytest.mark.parametrize("name", FIELDS)
def test_a_value_that_python_does_not_write_out_is_refused_by_name(name):
    message = f"^{name} must be .*, got int of more digits"
    with pytest.raises((TypeError, ValueError), match=message):
        CapsuleVectorEnv(**{name: 10**5000})
