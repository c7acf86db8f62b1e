"""How fast a platform creeps that friction should hold: capsule_gym beside MuJoCo.

Two loads, both given as shares of the friction limit:

- `driven`, for all: the motor swings the pendulum about `CENTRE` so that its horizontal force on the platform is
  that share of mu N, constant until the pendulum passes `CENTRE` again, where its sign changes. The torque is computed
  from the state at every step of the integrator.
- `steady`, for MuJoCo alone, because the capsule of capsule_gym knows no outer force: a constant force on the joint x
  of that share of mu (M + m) g, with the pendulum at rest where spring and gravity balance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks import driver
from benchmarks.frictions import HOLDING_FRICTIONS, INTEGRATORS, series_name
from benchmarks.timing import Progress
from capsule_gym.parameters import Capsule, Plant

LOADS = (0.2, 0.5, 0.9)
SECONDS = 10.0
CENTRE = -0.6
SWING = 0.1
# The steady load's velocity is the mean over the last part of the run.
LAST_PART = 0.5


@dataclass(frozen=True)
class Creep:
    """One share of the limit.

    Attributes:
        load: the share.
        median: of |x'| under the driven load, m/s.
        largest: of |x'| under the driven load, m/s.
        steady: mean x' under the steady load, m/s; None where there is none.
    """

    load: float
    median: float
    largest: float
    steady: float | None = None


def torque(load: float, theta: float, theta_dot: float, plant: Plant) -> float:
    """The motor torque of the driven load."""
    return driver.torque_for_load(-load if theta > CENTRE else load, theta, theta_dot, plant)


def ours(load: float, physics_dt: float) -> Creep:
    """The plant of capsule_gym."""
    plant = Capsule().plant()
    state = (CENTRE - SWING, 0.0, 0.0, 0.0)
    speeds = []
    for _ in range(round(SECONDS / physics_dt)):
        motion = driver.step(*state, torque(load, state[0], state[1], plant), plant, physics_dt)
        state = (motion.theta, motion.theta_dot, motion.x, motion.x_dot)
        speeds.append(abs(motion.x_dot))
    return Creep(load, float(np.median(speeds)), max(speeds))


def table(physics_dt: float, with_mujoco: bool) -> dict[str, list[Creep]]:
    """Every model under every load, by name.

    Args:
        physics_dt: step of the integrator, s.
        with_mujoco: whether MuJoCo is installed.
    """
    results = {"capsule_gym": [ours(load, physics_dt) for load in LOADS]}
    if with_mujoco:
        from benchmarks.mujoco_creep import in_mujoco

        progress = Progress("creep", len(HOLDING_FRICTIONS) * len(INTEGRATORS))
        for friction in HOLDING_FRICTIONS:
            for integrator in INTEGRATORS:
                name = series_name(friction, integrator)
                results[name] = [in_mujoco(load, friction, integrator, physics_dt) for load in LOADS]
                progress.step(name)
    return results
