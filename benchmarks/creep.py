"""How fast a platform creeps that friction should hold: capsule_gym beside MuJoCo.

Two loads, both given as shares of the friction limit:

- `driven`, for all: the motor swings the pendulum about `CENTRE` so that its horizontal force on the platform is
  that share of mu N, constant until the pendulum passes `CENTRE` again, where its sign changes. The torque is computed
  from the state at every step of the integrator.
- `steady`, for MuJoCo alone, because the capsule of capsule_gym knows no outer force: a constant force on the joint x
  of that share of mu (M + m) g, with the pendulum at rest where spring and gravity balance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from benchmarks import driver, mujoco_capsule
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


def _torque(load: float, theta: float, theta_dot: float, plant: Plant) -> float:
    """The motor torque of the driven load."""
    return driver.torque_for_load(-load if theta > CENTRE else load, theta, theta_dot, plant)


def ours(load: float, physics_dt: float) -> Creep:
    """The plant of capsule_gym."""
    plant = Capsule().plant()
    state = (CENTRE - SWING, 0.0, 0.0, 0.0)
    speeds = []
    for _ in range(round(SECONDS / physics_dt)):
        motion = driver.step(*state, _torque(load, state[0], state[1], plant), plant, physics_dt)
        state = (motion.theta, motion.theta_dot, motion.x, motion.x_dot)
        speeds.append(abs(motion.x_dot))
    return Creep(load, float(np.median(speeds)), max(speeds))


def in_mujoco(load: float, friction: mujoco_capsule.Friction, integrator: str, timestep: float) -> Creep:
    """The same plant in MuJoCo."""
    capsule = Capsule()
    model = mujoco_capsule.build_model(capsule, friction, integrator, timestep)
    speeds = _driven_in_mujoco(model, load, capsule.plant())
    return Creep(load, float(np.median(speeds)), max(speeds), _steady_in_mujoco(model, load, capsule))


def _driven_in_mujoco(model: Any, load: float, plant: Plant) -> list[float]:
    """|x'| after every step under the driven load."""
    data = mujoco_capsule.start_data(model, (CENTRE - SWING, 0.0, 0.0, 0.0))
    theta, x = data.joint("theta"), data.joint("x")
    speeds = []
    for _ in range(round(SECONDS / model.opt.timestep)):
        data.ctrl[0] = _torque(load, theta.qpos[0], theta.qvel[0], plant)
        mujoco_capsule.advance(model, data)
        speeds.append(abs(float(x.qvel[0])))
    return speeds


def resting_angle(capsule: Capsule) -> float:
    """The angle at which spring and gravity balance, rad."""
    gravity = capsule.m * capsule.g * capsule.l
    return float(brentq(lambda theta: gravity * math.sin(theta) - capsule.k * theta, 0.1, math.pi))


def _steady_in_mujoco(model: Any, load: float, capsule: Capsule) -> float:
    """Mean velocity under the steady load."""
    data = mujoco_capsule.start_data(model, (resting_angle(capsule), 0.0, 0.0, 0.0))
    x = data.joint("x")
    x.qfrc_applied[0] = load * capsule.mu * (capsule.M + capsule.m) * capsule.g
    steps = round(SECONDS / model.opt.timestep)
    first = round((1.0 - LAST_PART) * steps)
    before = 0.0
    for n in range(steps):
        if n == first:
            before = float(x.qpos[0])
        mujoco_capsule.advance(model, data)
    return (float(x.qpos[0]) - before) / ((steps - first) * model.opt.timestep)


def table(physics_dt: float, with_mujoco: bool) -> dict[str, list[Creep]]:
    """Every model under every load, by name.

    Args:
        physics_dt: step of the integrator, s.
        with_mujoco: whether MuJoCo is installed.
    """
    results = {"capsule_gym": [ours(load, physics_dt) for load in LOADS]}
    frictions = mujoco_capsule.HOLDING_FRICTIONS if with_mujoco else ()
    progress = Progress("creep", len(frictions) * len(mujoco_capsule.INTEGRATORS))
    for friction in frictions:
        for integrator in mujoco_capsule.INTEGRATORS:
            name = f"MuJoCo {friction.name}, {integrator}"
            results[name] = [in_mujoco(load, friction, integrator, physics_dt) for load in LOADS]
            progress.step(name)
    return results
