"""The task: clips, reward, termination, observation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from capsule_gym import Capsule, Randomization, task
from capsule_gym.observation import write_observation


@pytest.mark.parametrize(("value", "limit", "expected"), [(3.0, 1.0, 1.0), (-3.0, 1.0, -1.0), (0.5, 1.0, 0.5)])
def test_clip(value, limit, expected):
    assert task.clip(value, limit) == expected
    assert np.isnan(task.clip(float("nan"), limit))


def test_reward_terms_are_centimetres_forward_minus_the_price_of_energy_and_failure():
    assert task.reward_terms(0.03, 0.5, False, 0.1, 10.0) == (3.0, -0.05, 0.0)
    assert task.reward_terms(-0.03, 2.0, True, 0.25, 7.0) == (-3.0, -0.5, -7.0)


@pytest.mark.parametrize(
    ("theta", "normal_force", "ends"),
    [
        (0.0, 5.0, task.Termination.none),
        (np.nextafter(math.pi / 2, 0.0), 5.0, task.Termination.none),
        (math.pi / 2, 5.0, task.Termination.pendulum),
        (-math.pi / 2, 5.0, task.Termination.pendulum),
        (0.0, np.nextafter(0.0, 1.0), task.Termination.none),
        (0.0, 0.0, task.Termination.contact),
        (math.pi / 2, 0.0, task.Termination.pendulum),
    ],
)
def test_termination_is_at_the_limit_itself(theta, normal_force, ends):
    assert task.termination(theta, normal_force) == ends
    assert task.continues(theta, normal_force) == (ends == task.Termination.none)


def test_the_codes_of_infos_are_those_that_the_reference_says():
    codes = {"none": 0, "pendulum": 1, "contact": 2, "diverged": 3}
    assert {kind.name: int(kind) for kind in task.Termination} == codes


@pytest.mark.parametrize(("theta", "normal_force"), [(math.nan, 5.0), (math.inf, 5.0), (0.0, math.nan)])
def test_what_is_no_number_does_not_continue(theta, normal_force):
    assert not task.continues(theta, normal_force)


@pytest.mark.parametrize(
    ("theta_dot", "x_dot", "resolved"),
    [
        (0.0, 0.0, True),
        (-1e3, 1e3, True),
        (1e4, 0.0, True),
        (0.0, -1.1e4, False),
        (6e3, 6e3, False),
        (math.inf, 0.0, False),
        (math.nan, 0.0, False),
        (0.0, math.nan, False),
    ],
)
def test_rates_that_no_step_resolves_are_not_bounded(theta_dot, x_dot, resolved):
    assert task.bounded(theta_dot, x_dot) is resolved


def observe(with_reference: bool, with_parameters: bool, **values: float) -> dict[str, float]:
    """An observation by the names of its entries."""
    names = task.observation_names(with_reference, with_parameters)
    given = (
        dict.fromkeys((*names, "phase"), 0.25) | dict.fromkeys(("theta_d", "theta_d_dot", "law_torque"), 0.5) | values
    )
    out = np.full(len(names), np.nan, np.float32)
    write_observation(
        out,
        (given["theta"], given["theta_dot"], given["x_dot"]),
        given["last_action"],
        (given["theta_d"], given["theta_d_dot"], given["phase"]),
        given["law_torque"],
        (given.get("M", 0.0), given.get("mu", 0.0)),
        with_reference,
        with_parameters,
    )
    return dict(zip(names, out.tolist(), strict=True))


@pytest.mark.parametrize("with_reference", [False, True])
@pytest.mark.parametrize("with_parameters", [False, True])
def test_every_entry_stands_where_its_name_does(with_reference, with_parameters):
    own = {"theta": 0.125, "theta_dot": 2.0, "x_dot": 0.75, "last_action": -0.5, "M": 0.625, "mu": 0.0625}
    own |= {"theta_d": 0.375, "theta_d_dot": -3.0, "law_torque": 1.25, "phase": 0.25}
    seen = observe(with_reference, with_parameters, **own)
    derived = {"stick": 0.0, "sin_phase": 1.0, "cos_phase": 0.0}
    assert len(seen) == 5 + 5 * with_reference + 2 * with_parameters
    for name, value in seen.items():
        assert value == pytest.approx((own | derived)[name], abs=1e-6), name


def test_the_bounds_of_the_parameters_are_those_of_the_capsule_unless_ranges_go_further():
    paper, wide = Randomization.named("paper"), Randomization(M=(0.1, 9.0), mu=(0.0, 2.0))
    assert task.parameter_bounds(Capsule(), paper) == (2.0, 1.0)
    assert task.parameter_bounds(Capsule(), wide) == pytest.approx((9.0, 2.0), rel=1e-5)
    assert task.parameter_bounds(Capsule(M=0.1), paper) == pytest.approx((0.55, 1.0), rel=1e-5)
    assert task.parameter_bounds(Capsule(mu=1.5), Randomization(M=(0.1, 0.2))) == pytest.approx((2.0, 1.5), rel=1e-5)


def test_only_a_platform_at_rest_sticks():
    assert observe(False, False, x_dot=0.0)["stick"] == 1.0
    assert observe(False, False, x_dot=-0.0)["stick"] == 1.0
    assert observe(False, False, x_dot=5e-324)["stick"] == 0.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_observations_end_at_their_bounds(sign):
    low, high = task.observation_bounds(True, True, Capsule(), Randomization(), task.TORQUE_LIMIT)
    # No wider than what can be.
    assert low.tolist()[7:9] == [-1.0, -1.0] and high.tolist()[7:9] == [1.0, 1.0]
    bounds = dict(zip(task.observation_names(True, True), (high if sign > 0.0 else low).tolist(), strict=True))
    far = observe(
        True, True, **{name: sign * 1e9 for name in ("theta", "theta_dot", "x_dot", "theta_d", "theta_d_dot")}
    )
    for name in ("theta", "theta_dot", "x_dot", "theta_d", "theta_d_dot"):
        assert far[name] == bounds[name]
