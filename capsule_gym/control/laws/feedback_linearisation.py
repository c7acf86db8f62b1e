"""Feedback linearisation (35) of the paper along a profile, as a `Controller`."""

from capsule_gym.control.controller import Controller, CoreLaw
from capsule_gym.control.laws.gains import check_gains, plant_constants
from capsule_gym.control.laws.profiles import EPC, PROPOSED, Profile, optimal, reference_table
from capsule_gym.parameters import NOMINAL, Capsule


def feedback_linearising(
    profile: Profile = PROPOSED, K_p: float = 400.0, K_v: float = 40.0, nominal: Capsule = NOMINAL
) -> Controller:
    """Feedback linearisation (35) along a profile.

    The paper does not publish its gains. The default is a double pole at -20 rad/s, well below the
    1 kHz of the law and well above the profile.

    Args:
        profile: reference of the pendulum.
        K_p: gain of the angle's error, 1/s^2.
        K_v: gain of the rate's error, 1/s.
        nominal: the nominal plant of the law.
    """
    gains = check_gains(K_p=K_p, K_v=K_v)
    plant = nominal.plant()
    law = CoreLaw("feedback_linearising", **plant_constants(plant), **gains)
    return Controller("feedback-linearising", law, reference_table(profile, plant))


def feedback_linearising_optimal_profile() -> Controller:
    """Feedback linearisation along the fastest profile (9) with 1.5 N m and without Principle 4.

    Without this principle the platform can move while the pendulum returns.
    """
    return feedback_linearising(optimal(1.5, dropped=4))


def epc() -> Controller:
    """Feedback linearisation along the EPC profile, with which the paper compares."""
    return feedback_linearising(EPC)
