import numpy as np

from capsule_gym import Controller
from capsule_gym.core.layout import ROW_NAMES

# Inputs of a step, and values that every step overwrites; all other rows belong to the episode.
SCRATCH = {
    "action",
    "active",
    "mass_ratio",
    "before_x",
    "read_before_x",
    "slip",
    "elapsed",
    "halt",
    "cursor",
    "next_theta",
    "next_theta_dot",
    "next_x",
    "next_x_dot",
    "theta_ddot",
    "x_ddot",
    "first_normal_force",
    "least_normal_force",
}
EPISODE_ROWS = [row for row, name in enumerate(ROW_NAMES) if name not in SCRATCH]


def picky(theta, theta_dot, x, x_dot, memory, reference):
    """A law that counts its calls, and whose torque is too large or not finite in some places."""
    (count,) = memory
    torque = 0.1
    if x > 50.0:
        torque = 1e308
    elif x > 5.0:
        torque = np.inf if count == 30.0 else 0.1
    if x < -5.0:
        torque = np.nan
    return torque, (count + 1.0,)


def picky_controller():
    return Controller("picky", picky, np.zeros((1, 2)))


def flatten(info):
    """The values of an info, also those inside dictionaries."""
    values = []
    for value in info.values():
        values += flatten(value) if isinstance(value, dict) else [value]
    return values


def layout(info):
    """The type, dtype and shape of each value of an info, also inside dictionaries."""
    described = {}
    for key, value in info.items():
        if isinstance(value, dict):
            described[key] = layout(value)
        else:
            described[key] = (type(value), np.asarray(value).dtype, np.shape(value))
    return described
