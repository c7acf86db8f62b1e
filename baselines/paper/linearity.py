"""Property 3, Eq. (4): the model's left side is linear in its constants, and what (4) leaves out is not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.paper import published
from capsule_gym.parameters import NOMINAL, Plant

SAMPLES = 1000
SEED = 0
# Of the random motions: angle (rad), rates (rad/s, m/s), accelerations (rad/s^2, m/s^2).
SCALES = (1.5, 10.0, 0.5, 100.0, 5.0)


@dataclass(frozen=True)
class Linearity:
    """What holds of Property 3 on random motions.

    Attributes:
        residual: largest |M q'' + C q' + G - Y alpha| over the largest term, alpha = [m l^2, m l, M + m, m g l].
        products: likewise of the friction mu N in [mu (M + m), mu m l].
        defect: of the friction as a function of M and mu: by how much, relatively, it lies above the straight line
            between two opposite corners of the paper's ranges, at their middle.
    """

    residual: float
    products: float
    defect: float


def check_linearity(samples: int = SAMPLES, seed: int = SEED) -> Linearity:
    """Evaluates Property 3.

    Args:
        samples: number of random motions, each on a plant of its own.
        seed: of the drawing.
    """
    rng = np.random.default_rng(seed)
    motions = np.array(SCALES) * rng.uniform(-1.0, 1.0, (samples, len(SCALES)))
    factors = rng.uniform(0.5, 2.0, (samples, 3))
    plants = [NOMINAL.plant(NOMINAL.M * a, NOMINAL.mu * b)._replace(m=NOMINAL.m * c) for a, b, c in factors.tolist()]
    residual = products = 0.0
    for motion, p in zip(motions, plants, strict=True):
        left, terms = _left_side(motion, p), _regressor(motion) * [p.m * p.l**2, p.m * p.l, p.M + p.m, p.m * p.g * p.l]
        residual = max(residual, float(np.abs(left - terms.sum(axis=1)).max() / np.abs(terms).max()))
        friction = p.mu * _normal(motion, p)
        parts = _normal_regressor(motion, p.g) * [p.mu * (p.M + p.m), p.mu * p.m * p.l]
        products = max(products, float(abs(friction - parts.sum()) / np.abs(parts).max()))
    rest = np.zeros(len(SCALES))
    light, heavy = (
        plant.mu * _normal(rest, plant) for plant in map(NOMINAL.plant, published.M_RANGE, published.MU_RANGE)
    )
    middle = NOMINAL.plant(sum(published.M_RANGE) / 2.0, sum(published.MU_RANGE) / 2.0)
    defect = 0.5 * (light + heavy) / (middle.mu * _normal(rest, middle)) - 1.0
    return Linearity(residual, products, float(defect))


def _left_side(motion: np.ndarray, p: Plant) -> np.ndarray:
    """M(q) q'' + C(q, q') q' + G(q) of Eq. (4), by the matrices under Eq. (1)."""
    theta, theta_dot, x_dot, theta_ddot, x_ddot = motion
    ml, sin, cos = p.m * p.l, np.sin(theta), np.cos(theta)
    inertia = np.array([[ml * p.l, -ml * cos], [-ml * cos, p.M + p.m]])
    coriolis = np.array([[0.0, 0.0], [ml * sin * theta_dot, 0.0]])
    gravity = np.array([-ml * p.g * sin, 0.0])
    left: np.ndarray = inertia @ [theta_ddot, x_ddot] + coriolis @ [theta_dot, x_dot] + gravity
    return left


def _regressor(motion: np.ndarray) -> np.ndarray:
    """Y(q, q', q'') of Eq. (4) for alpha = [m l^2, m l, M + m, m g l], shape (2, 4); Y_0 is zero."""
    theta, theta_dot, _, theta_ddot, x_ddot = motion
    sin, cos = np.sin(theta), np.cos(theta)
    pushed = sin * theta_dot**2 - cos * theta_ddot
    return np.array([[theta_ddot, -cos * x_ddot, 0.0, -sin], [0.0, pushed, x_ddot, 0.0]])


def _normal(motion: np.ndarray, p: Plant) -> float:
    """Newton's normal force, N."""
    theta, theta_dot, _, theta_ddot, _ = motion
    lift = theta_ddot * np.sin(theta) + theta_dot**2 * np.cos(theta)
    return float((p.M + p.m) * p.g - p.m * p.l * lift)


def _normal_regressor(motion: np.ndarray, g: float) -> np.ndarray:
    """What M + m and m l are multiplied with in the normal force, shape (2,)."""
    theta, theta_dot, _, theta_ddot, _ = motion
    return np.array([g, -theta_ddot * np.sin(theta) - theta_dot**2 * np.cos(theta)])
