"""Feedback linearisation (35) of the paper along a profile, as a `Controller`."""

from __future__ import annotations

from baselines.laws.gains import K_P, K_V, check_gains
from baselines.laws.profiles import EPC, PROPOSED, Profile, optimal
from baselines.laws.reference import reference_table
from capsule_gym import dynamics
from capsule_gym.controller import Controller, Law
from capsule_gym.elementary import sincos
from capsule_gym.parameters import NOMINAL, Capsule, Plant


def feedback_linearising_law(p: Plant, K_p: float, K_v: float) -> Law:
    """The torque (35), with f the actual friction force: mu N sign(x') in slip, the reaction in stick.

    K_p is in 1/s^2, K_v in 1/s.
    """

    def law(
        theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
    ) -> tuple[float, tuple[float, ...]]:
        theta_d, theta_d_dot, theta_d_ddot = reference[0], reference[1], reference[2]
        a = theta_d_ddot - K_v * (theta_dot - theta_d_dot) - K_p * (theta - theta_d)
        sin, cos = sincos(theta)
        force = dynamics.driving_force(theta, theta_dot, a, p)
        limit = p.mu * max(0.0, dynamics.normal_force(theta, theta_dot, a, p))
        if x_dot > 0.0:
            f = limit
        elif x_dot < 0.0:
            f = -limit
        else:
            f = min(limit, max(-limit, force))
        ml = p.m * p.l
        inertia = ml * p.l * (1.0 - p.m * cos * cos / (p.M + p.m))
        coupling = ml * cos * (ml * sin * theta_dot * theta_dot + f) / (p.M + p.m)
        u = inertia * a + coupling - ml * p.g * sin + p.k * theta + p.c * theta_dot  # Eq. (35)
        return u, memory

    return law


def feedback_linearising(
    profile: Profile = PROPOSED, K_p: float = K_P, K_v: float = K_V, nominal: Capsule = NOMINAL
) -> Controller:
    """Feedback linearisation (35) along a profile.

    Args:
        profile: reference of the pendulum.
        K_p: gain of the angle's error, 1/s^2.
        K_v: gain of the rate's error, 1/s.
        nominal: the nominal plant of the law.
    """
    gains = check_gains(K_p=K_p, K_v=K_v)
    plant = nominal.plant()
    return Controller("feedback-linearising", feedback_linearising_law(plant, **gains), reference_table(profile, plant))


def feedback_linearising_optimal_profile() -> Controller:
    """Feedback linearisation along the fastest profile (9) with 0.54 N m and without Principle 4.

    Without this principle the platform can move while the pendulum returns.
    """
    return feedback_linearising(optimal(0.54, dropped=4))


def epc() -> Controller:
    """Feedback linearisation along the EPC profile, with which the paper compares."""
    return feedback_linearising(EPC)
