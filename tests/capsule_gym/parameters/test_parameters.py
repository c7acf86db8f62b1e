import ast
import dataclasses
import math
import re

import numpy as np
import pytest

from capsule_gym import CapsuleEnv, CapsuleVectorEnv, dynamics
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.simulation import Simulation
from capsule_gym.parameters import RANDOMIZATIONS, Capsule, Randomization

POSITIVE = ("M", "m", "l", "g", "backward_ratio")
NON_NEGATIVE = ("k", "c", "mu", "viscous", "motor_friction")


def test_a_plant_is_computed_in_float64_even_if_its_constants_were_narrower():
    narrow = {
        "M": np.float16(0.5),
        "m": np.float16(0.1),
        "l": np.float32(0.3),
        "c": np.float16(0.01),
    }
    assert (
        Capsule(**narrow).plant()
        == Capsule(**{name: float(value) for name, value in narrow.items()}).plant()
    )


@pytest.mark.parametrize("field", [*POSITIVE, *NON_NEGATIVE, "static_ratio"])
def test_constants_out_of_range_are_refused_by_name_value_and_what_is_accepted(field):
    lowest = "1" if field == "static_ratio" else "1e-12" if field in POSITIVE else "0"
    below = 0.999 if field == "static_ratio" else 9e-13 if field in POSITIVE else -5e-324
    for value in (
        math.nan,
        math.inf,
        below,
        1.1e12,
        10**400,
        "0.3",
        None,
        True,
        np.True_,
        np.array(0.3),
    ):
        error, more = (ValueError, "") if type(value) in (float, int) else (TypeError, " of type")
        said = (
            f"Capsule.{field} must be a finite number from {lowest} to 1e+12, got {value!r}{more}"
        )
        with pytest.raises(error, match=re.escape(said)):
            Capsule(**{field: value})
    if field in NON_NEGATIVE:
        assert getattr(Capsule(**{field: 0}).plant(), field) == 0.0


def test_painleves_paradox_is_refused_exactly_where_the_slip_equations_are_singular():
    rng, theta = np.random.default_rng(3), np.linspace(-math.pi, math.pi, 200_001)
    outcomes = set()
    for _ in range(60):
        M, m, mu = rng.uniform(0.01, 1.0), rng.uniform(0.1, 2.0), rng.uniform(0.0, 3.0)
        static, backward = rng.uniform(1.0, 2.0), rng.uniform(0.2, 2.0)
        fields = {"M": M, "m": m, "static_ratio": static, "backward_ratio": backward}
        # True if the determinant of the slip equations vanishes at some angle with the largest
        # coefficient that acts.
        ratio = static * max(1.0, backward)
        singular = bool(
            np.any(
                M + m * np.sin(theta) ** 2 - ratio * mu * m * np.sin(theta) * np.cos(theta) <= 0.0
            )
        )
        outcomes.add(singular)
        if singular:
            with pytest.raises(ValueError, match=r"M=\d.*mu=\d.*must stay below") as caught:
                Capsule(**fields, mu=mu)
            # The message names the largest coefficient that is accepted.
            limit = float(str(caught.value).rsplit(" ", 1)[1]) / ratio
            Capsule(**fields, mu=0.999 * limit)
            with pytest.raises(ValueError, match="Painleve"):
                Capsule(**fields, mu=1.001 * limit)
        else:
            Capsule(**fields, mu=mu)
    assert outcomes == {True, False}
    assert Capsule().plant(M=0.7, mu=0.2) == Capsule(M=0.7, mu=0.2).plant()
    for M, mu in (
        (0.0, 0.1),
        (math.nan, 0.1),
        (0.5, -1.0),
        (0.01, 3.0),
        (1e300, 0.1),
        (0.5, 1e300),
    ):
        for check in (Capsule().plant, Capsule().check_plant):
            with pytest.raises(ValueError, match=r"must be|Painleve"):
                check(M, mu)


def largest_eigenvalue(theta, p, x_dot=0.0):
    """The largest eigenvalue, by size, of the motion linearised at these angles, where a torque
    holds the pendulum."""
    found, offsets = 0.0, 1e-5 * np.concatenate([np.eye(3), -np.eye(3)]).T[..., None]
    for slip in (1.0, -1.0):
        still, pushed = (
            dynamics.accelerations(theta, 0.0, slip * x_dot, slip, u, p).theta_ddot
            for u in (0.0, 1.0)
        )
        (angle, rate, speed), u = offsets, still / (still - pushed)
        turns, pushes, _ = dynamics.accelerations(
            theta + angle, rate, slip * x_dot + speed, slip, u, p
        )
        motions = np.stack(np.broadcast_arrays(rate, turns, pushes))
        slopes = (motions[:, :3] - motions[:, 3:]) / 2e-5
        found = max(found, np.abs(np.linalg.eigvals(slopes.T)).max())
    return found


@pytest.mark.parametrize(("normal_force", "close"), [("newton", 0.5), ("paper", 0.2)])
def test_the_fastest_rate_bounds_every_eigenvalue_closely(normal_force, close):
    rng = np.random.default_rng(7)
    tested = 0
    while tested < 20:
        names = ("M", "m", "l", "k", "c", "mu", "backward_ratio")
        fields = dict(
            zip(names, (10.0 ** rng.uniform(-1.5, 0.5, len(names))).tolist(), strict=True)
        )
        fields["k"] *= 30.0 ** (tested % 2)  # every other spring is stiffer than gravity
        try:
            capsule = Capsule(**fields, normal_force=normal_force)
        except ValueError:  # Painleve
            continue
        tested += 1
        rate = capsule.fastest_rate(capsule.M, capsule.mu)
        found = largest_eigenvalue(np.linspace(-1.57, 1.57, 50), capsule.plant())
        assert close * rate < found < rate * (1.0 + 1e-4), fields
        # A lighter platform and a rougher floor give faster rates, so only one corner of the ranges
        # has to be checked.
        assert capsule.fastest_rate(1.1 * capsule.M, capsule.mu) < rate
        assert capsule.fastest_rate(capsule.M, 0.9 * capsule.mu) < rate
    # Constants that dominate the rate; the Stribeck curve is steepest at this velocity.
    falling, rough = (
        {"stribeck_speed": 1e-3, "static_ratio": 2, "mu": 0.1},
        {"viscous": 300.0, "mu": 1.0, "M": 0.1},
    )
    for fields in ({"viscous": 30.0}, rough, {"motor_friction": 1.0}, falling):
        capsule, x_dot = Capsule(**fields), fields.get("stribeck_speed", 0.0) / math.sqrt(3.0)
        found = largest_eigenvalue(np.linspace(-1.57, 1.57, 51), capsule.plant(), x_dot)
        assert 0.85 < found / capsule.fastest_rate(capsule.M, capsule.mu) < 1.0


def test_every_corner_of_the_ranges_is_checked():
    with pytest.raises(
        ValueError, match=r"Randomization\(M in \[0\.05, 1\] kg, mu in \[0, 2\]\): .*Painleve"
    ):
        Randomization(M=(0.05, 1.0), mu=(0.0, 2.0)).corners(Capsule())
    for randomization, capsule in (
        (Randomization(M=(0.05, 1.0)), Capsule(mu=2.0)),
        (Randomization(M=(0.1, 1e300)), Capsule()),
        (Randomization(mu=(0.0, 1e300)), Capsule()),
    ):
        with pytest.raises(
            ValueError, match=r"^Randomization\(.*(Painleve|must be a finite number from)"
        ):
            randomization.corners(capsule)
    for randomization in (
        *RANDOMIZATIONS.values(),
        Randomization(M=(0.05, 1.0)),
        Randomization(mu=(0.0, 2.0)),
    ):
        randomization.corners(Capsule())


FIELDS = {field.name: field for field in dataclasses.fields(EnvConfig)}
NUMBERS = [name for name, field in FIELDS.items() if field.type in ("float", "float | None")]
OPTIONS = [*NUMBERS, "initial_range", "observe_parameters", "capsule", "randomization", "threads"]
SUMMED = ["torque_limit", "residual_limit", "energy_weight", "termination_penalty"]
REFUSED = [
    *(
        (name, value, r"a .*number.*")
        for name in NUMBERS
        for value in (math.nan, math.inf, -1.0, 10**400)
    ),
    # Sums of larger numbers would be infinite.
    *((name, 1e300, r"a finite number .*, at most 1e\+\d+") for name in SUMMED),
    *((name, value, ".*") for name in OPTIONS for value in ([1.0], 1j, b"1")),
]


@pytest.mark.parametrize(("name", "value", "accepted"), REFUSED)
def test_what_an_option_does_not_accept_is_refused_by_name_and_value(name, value, accepted):
    error = TypeError if isinstance(value, (list, complex, bytes)) else ValueError
    with pytest.raises(error, match=rf"^{name} must be {accepted}, got {re.escape(repr(value))}"):
        EnvConfig(**{name: value})


def test_what_is_none_follows_from_the_others():
    direct = Simulation(1, EnvConfig(torque_limit=2.0)).settings
    assert (direct.residual_limit, direct.physics_dt, direct.physics_steps, direct.law_steps) == (
        2.0,
        2e-3,
        10,
        1,
    )
    law = Simulation(1, EnvConfig(controller="baselines:adaptive")).settings
    assert (law.residual_limit, law.physics_dt, law.physics_steps, law.law_steps) == (
        1.5,
        1e-3,
        1,
        20,
    )


def test_the_documentation_states_defaults_and_ranges():
    rows = dict(re.findall(r"\| `(\w+)` \| `(.*?)` \|", CapsuleEnv.__doc__))
    assert (rows.pop("residual_limit"), rows.pop("capsule")) == ("torque_limit", "Capsule()")
    assert EnvConfig(**{name: ast.literal_eval(text) for name, text in rows.items()}) == EnvConfig()
    assert all(
        f'"{name}": {ranges}' in CapsuleEnv.__doc__ for name, ranges in RANDOMIZATIONS.items()
    )


@pytest.mark.parametrize("name", FIELDS)
def test_a_value_that_python_does_not_write_out_is_refused_by_name(name):
    with pytest.raises(
        (TypeError, ValueError), match=f"^{name} must be .*, got int of more digits"
    ):
        CapsuleVectorEnv(**{name: 10**5000})
