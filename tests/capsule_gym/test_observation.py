"""The observation: what stands where, and where its entries end."""

from __future__ import annotations

import numpy as np
import pytest

from capsule_gym import Capsule, Randomization, task
from capsule_gym.observation import observation_bounds, observation_names, parameter_bounds, write_observation


def observe(with_reference: bool, with_parameters: bool, **values: float) -> dict[str, float]:
    """An observation by the names of its entries."""
    names = observation_names(with_reference, with_parameters)
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


def test_only_a_platform_at_rest_sticks():
    assert observe(False, False, x_dot=0.0)["stick"] == 1.0
    assert observe(False, False, x_dot=-0.0)["stick"] == 1.0
    assert observe(False, False, x_dot=5e-324)["stick"] == 0.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_observations_end_at_their_bounds(sign):
    low, high = observation_bounds(True, True, Capsule(), Randomization(), task.TORQUE_LIMIT)
    # No wider than what can be.
    assert low.tolist()[7:9] == [-1.0, -1.0] and high.tolist()[7:9] == [1.0, 1.0]
    bounds = dict(zip(observation_names(True, True), (high if sign > 0.0 else low).tolist(), strict=True))
    far = observe(
        True, True, **{name: sign * 1e9 for name in ("theta", "theta_dot", "x_dot", "theta_d", "theta_d_dot")}
    )
    for name in ("theta", "theta_dot", "x_dot", "theta_d", "theta_d_dot"):
        assert far[name] == bounds[name]


def test_the_bounds_of_the_parameters_are_those_of_the_capsule_unless_ranges_go_further():
    paper, wide = Randomization.named("paper"), Randomization(M=(0.1, 9.0), mu=(0.0, 2.0))
    assert parameter_bounds(Capsule(), paper) == (2.0, 1.0)
    assert parameter_bounds(Capsule(), wide) == pytest.approx((9.0, 2.0), rel=1e-5)
    assert parameter_bounds(Capsule(M=0.1), paper) == pytest.approx((0.55, 1.0), rel=1e-5)
    assert parameter_bounds(Capsule(mu=1.5), Randomization(M=(0.1, 0.2))) == pytest.approx((2.0, 1.5), rel=1e-5)
