"""The creep of MuJoCo's capsule under the loads of `benchmarks.creep`. Needs the extra `bench`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.optimize import brentq

from benchmarks import mujoco_capsule
from benchmarks.creep import CENTRE, LAST_PART, SECONDS, SWING, Creep, torque
from benchmarks.frictions import Friction
from capsule_gym.parameters import Capsule, Plant


def in_mujoco(load: float, friction: Friction, integrator: str, timestep: float) -> Creep:
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
        data.ctrl[0] = torque(load, theta.qpos[0], theta.qvel[0], plant)
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
