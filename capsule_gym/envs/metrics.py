"""The metrics of episodes, from the sums that the core keeps."""

import math
from types import SimpleNamespace

import numpy as np

from capsule_gym.core.layout import Row
from capsule_gym.tasks.task import Task


def episode_metrics(world: np.ndarray, horizon: float | None, task: Task) -> dict[str, np.ndarray]:
    """The metrics of episodes, one column of `Simulation.world` each, with the rows down to the task's memory.

    The length of a whole episode, `horizon` in s, is by default the time that has passed.

    Returns:
        One float64 array of shape (n,) for each of `capsule_gym.tasks.task.METRICS`, and for each metric of the task.
    """
    rows = SimpleNamespace(**{name: world[row] for name, row in vars(Row).items()})
    failed, distance = rows.termination != 0, rows.x - rows.start_x
    # Before the first step every integral is 0, and so is every ratio.
    elapsed = np.where(rows.duration > 0.0, rows.duration, 1.0)
    whole = elapsed if horizon is None else np.where(failed, horizon, elapsed)
    nowhere, never = np.where(rows.backward > 0.0, math.inf, 0.0), np.full(len(failed), math.inf)
    memory = SimpleNamespace(**dict(zip(task.fields, world[len(world) - task.rows :], strict=True)))
    advances, moves_forwards = rows.weight_distance > 0.0, rows.forward > 0.0
    return {
        "mean_speed": 100.0 * distance / whole,
        "cost_of_transport": np.divide(rows.episode_energy, rows.weight_distance, out=never, where=advances),
        "peak_torque": rows.peak_torque,
        "rms_torque": np.sqrt(rows.torque_squared / elapsed),
        "backward_ratio": np.divide(rows.backward, rows.forward, out=nowhere, where=moves_forwards),
        "stuck_fraction": rows.stuck / elapsed,
        "smallest_normal_ratio": rows.smallest_normal_ratio,
        "largest_theta": rows.largest_theta,
        "largest_theta_dot": rows.largest_theta_dot,
        "distance": distance,
        "energy": rows.episode_energy,
        "duration": rows.duration,
        "failed": failed.astype(np.float64),
        **task.metrics(memory, whole),
    }
