"""The same capsule in MuJoCo. Without friction it agrees with `capsule_gym` to 1e-8 over two seconds."""

from __future__ import annotations

from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from capsule_gym import task
from capsule_gym.parameters import Capsule

XML = Path(__file__).with_name("capsule.xml")
# The settings that MuJoCo documents against slip: the ratio of friction-to-normal impedance, the no-slip solver, the
# smallest time constant (in steps) and the largest impedance of a contact that it accepts, and the discrete integrator.
IMPRATIO, NO_SLIP_ITERATIONS = 100.0, 50
STIFF_STEPS, STIFF_IMPEDANCE = 2.0, (0.9999, 0.9999, 0.001, 0.5, 2.0)
# Friction of the joint x, or of a sphere on a plane with an elliptic cone and one or more of these settings.
FRICTIONS = ("frictionloss", "contact", "impratio", "no-slip", "stiff", "no-slip, discrete")
# Time in which a platform on a contact sinks into the floor, and in which it is loaded, s; the last second is measured.
SETTLING_SECONDS, LOADED_SECONDS = 1.0, 6


def build_model(friction: str, timestep: float, capsule: Capsule, integrator: str = "implicitfast") -> Any:
    """Compiles the model of a plant with one friction coefficient, with a friction out of `FRICTIONS`."""
    import mujoco

    constants = {name: getattr(capsule, name) for name in ("M", "m", "l", "g", "k", "c", "mu")}
    coulomb = capsule.mu * (capsule.M + capsule.m) * capsule.g if friction == "frictionloss" else 0.0
    text = Template(XML.read_text(encoding="utf-8")).substitute(constants, coulomb=coulomb)
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = timestep
    integrator = "discrete" if "discrete" in friction else integrator
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    if friction == "frictionloss":
        spec.delete(spec.joint("y"))
        spec.delete(spec.joint("z"))
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    if friction == "impratio":
        spec.option.impratio = IMPRATIO
    if "no-slip" in friction:
        spec.option.noslip_iterations = NO_SLIP_ITERATIONS
    if friction == "stiff":
        for geom in spec.geoms:
            geom.solref, geom.solimp = (STIFF_STEPS * timestep, 1.0), STIFF_IMPEDANCE
    return spec.compile()


def hold(model: Any, data: Any, torque: float, seconds: float = task.CONTROL_DT) -> None:
    """Holds a torque in N m, by default for one control interval."""
    import mujoco

    data.ctrl[0] = torque
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))


def start_data(model: Any) -> Any:
    """MuJoCo's data of a capsule at rest at -pi/3, after a platform on a contact has sunk into the floor."""
    import mujoco

    data = mujoco.MjData(model)
    for _ in range(round(SETTLING_SECONDS / model.opt.timestep) if model.nv > 2 else 0):
        data.joint("theta").qpos[0] = task.START_THETA
        mujoco.mj_step(model, data)
        for joint in ("theta", "x"):
            data.joint(joint).qpos[0] = data.joint(joint).qvel[0] = 0.0
    data.joint("theta").qpos[0] = task.START_THETA
    return data


def creep(model: Any, load: float) -> float:
    """The speed of the platform under a constant horizontal force in N below the friction limit, m/s; 0 in stick."""
    data, x = start_data(model), []
    data.qfrc_applied[model.joint("x").dofadr[0]] = load
    for _ in range(LOADED_SECONDS):
        hold(model, data, 0.0, 1.0)
        x.append(data.joint("x").qpos[0])
    return abs(x[-1] - x[-2])


def simulate(model: Any, torques: np.ndarray) -> np.ndarray:
    """Simulates a trajectory from theta = -pi/3 at rest under torques in N m, each held for `task.CONTROL_DT`.

    Returns:
        theta, theta_dot, x, x_dot at the end of each interval: shape (intervals, 4).
    """
    data, states = start_data(model), np.empty((len(torques), 4))
    for torque, state in zip(torques, states, strict=True):
        hold(model, data, torque)
        state[:] = [value for name in ("theta", "x") for value in (*data.joint(name).qpos, *data.joint(name).qvel)]
    return states
