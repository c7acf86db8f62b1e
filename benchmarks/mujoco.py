"""The same capsule in MuJoCo (`capsule.xml`). Without friction it agrees with `capsule_gym` to 1e-8 over 2 s."""

from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from capsule_gym import task
from capsule_gym.parameters import Capsule

XML = Path(__file__).with_name("capsule.xml").read_text(encoding="utf-8")
# Friction of the joint x, or of a sphere on a plane with settings that MuJoCo documents against slip; `stiff` has the
# smallest time constant, in steps, and the largest impedance of a contact that it accepts.
FRICTIONS = ("frictionloss", "contact", "impratio", "no-slip", "stiff", "no-slip, discrete")


def build(friction: str, timestep: float, capsule: Capsule) -> tuple[Any, Any]:
    """MuJoCo's model of a plant, and its data at rest at -pi/3, after a platform on a contact has sunk for a second."""
    import mujoco

    contact = friction != "frictionloss"
    coulomb = 0.0 if contact else capsule.mu * (capsule.M + capsule.m) * capsule.g
    spec = mujoco.MjSpec.from_string(Template(XML).substitute(vars(capsule), coulomb=coulomb))
    spec.option.timestep = timestep
    kinds = mujoco.mjtIntegrator
    spec.option.integrator = kinds.mjINT_DISCRETE if "discrete" in friction else kinds.mjINT_IMPLICITFAST
    spec.option.impratio = 100.0 if friction == "impratio" else 1.0
    spec.option.noslip_iterations = 50 if "no-slip" in friction else 0
    if not contact:
        spec.delete(spec.joint("y"))
        spec.delete(spec.joint("z"))
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for geom in spec.geoms if friction == "stiff" else ():
        geom.solref, geom.solimp = (2.0 * timestep, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
    data = mujoco.MjData(model := spec.compile())
    for settling in range(1 + (round(1.0 / timestep) if contact else 0)):
        if settling:
            mujoco.mj_step(model, data)
        for joint, angle in (("theta", task.START_THETA), ("x", 0.0)):
            data.joint(joint).qpos[0], data.joint(joint).qvel[0] = angle, 0.0
    return model, data


def hold(model: Any, data: Any, torque: float, seconds: float = task.CONTROL_DT) -> np.ndarray:
    """Holds a torque in N m, by default for one control interval; returns theta, theta_dot, x, x_dot at its end."""
    import mujoco

    data.ctrl[0] = torque
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    return np.ravel([[data.joint(name).qpos, data.joint(name).qvel] for name in ("theta", "x")])


def creep(model: Any, data: Any, load: float) -> float:
    """The speed of the platform in the sixth second under a horizontal force in N, m/s."""
    data.joint("x").qfrc_applied[0] = load
    fifth, sixth = (hold(model, data, 0.0, seconds)[2] for seconds in (5.0, 1.0))
    return abs(sixth - fifth)
