import numpy as np


def random_actions(seed, steps, n):
    """Uniform actions of n environments, float32, shape (steps, n, 1)."""
    actions = np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, n, 1))
    return actions.astype(np.float32)
