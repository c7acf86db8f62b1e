"""Logs without noise, of ideal motors and sensors: what is ideal lies in every range."""

import pytest

from capsule_gym import Capsule, CapsuleEnv, Excitation, identify, record
from tests.capsule_gym.identification.rig import CONSTANTS, EXACT, MOTOR, TRUTH, make_log

IDEAL = {**CONSTANTS, "static_ratio": 1.0, "motor_friction": 0.0, "viscous": 0.0}
NO_STICK = {**IDEAL, "mu": 0.02}


def make_ideal_log(constants):
    env = CapsuleEnv(capsule=Capsule(**constants), randomization="none", control_dt=0.01)
    rest = {"state": [0.0] * 4}
    return record(env, Excitation(amplitude=0.4), seconds=10.0, seed=1, options=rest)


def test_the_step_of_the_integrator_is_part_of_the_result():
    fit = identify(make_log(EXACT, 8.0, physics_dt=1e-3), physics_dt=1e-3)
    assert fit.env_kwargs()["physics_dt"] == fit.physics_dt == 1e-3
    for name, value in MOTOR.items():
        assert fit.estimates[name] == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize(
    ("log", "truth"),
    [
        (make_ideal_log(IDEAL), IDEAL),
        (make_ideal_log(NO_STICK), NO_STICK),
        (make_log(EXACT, 10.0), TRUTH),
    ],
    ids=["ideal", "without stick", "with delays and a bias"],
)
def test_a_log_without_noise_determines_everything(log, truth):
    """A warning would be an error; the torque, constant in each period, leaves ratios open."""
    fit = identify(log)
    truth = {**dict.fromkeys(MOTOR, 0.0), **truth}
    low, high = fit.intervals()["static_ratio"]
    assert low <= truth["static_ratio"] <= high
    for name in set(CONSTANTS) - {"static_ratio"}:
        assert fit.estimates[name] == pytest.approx(truth[name], abs=1e-4), name
    for name in MOTOR:
        assert fit.estimates[name] == pytest.approx(truth[name], abs=1e-6), name
    assert fit.chi2 < 1.2
