"""The same capsule in MuJoCo (`capsule.xml`). Without friction it agrees with `capsule_gym` to 1e-8
over 2 s.
"""

from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from capsule_gym.parameters import Capsule
from capsule_gym.tasks import task

XML = Path(__file__).with_name("capsule.xml").read_text(encoding="utf-8")
# Friction of the joint x, or of a sphere on a plane, and the options that MuJoCo documents against
# slip.
FRICTIONS = {
    **{"frictionloss": 'integrator="implicitfast"', "contact": 'integrator="implicitfast"'},
    **{"impratio": 'integrator="implicitfast" impratio="100"'},
    **{
        "no-slip": 'integrator="implicitfast" noslip_iterations="50"',
        "stiff": 'integrator="implicitfast"',
    },
    **{"no-slip, discrete": 'integrator="discrete" noslip_iterations="50"'},
}


def build(friction: str, timestep: float, capsule: Capsule) -> tuple[Any, Any]:
    """MuJoCo's model of a plant, and its data at rest at -pi/3, after a platform on a contact has
    sunk for a second.
    """
    import mujoco

    contact = friction != "frictionloss"
    # The smallest time constant, in steps, and the largest impedance of a contact that MuJoCo
    # accepts.
    stiff = (
        f'solref="{2.0 * timestep} 1" solimp="0.9999 0.9999 0.001 0.5 2"'
        if friction == "stiff"
        else ""
    )
    values = {**vars(capsule), "timestep": timestep, "options": FRICTIONS[friction], "stiff": stiff}
    coulomb = 0.0 if contact else capsule.mu * (capsule.M + capsule.m) * capsule.g
    spec = mujoco.MjSpec.from_string(Template(XML).substitute(values, coulomb=coulomb))
    for part in () if contact else (spec.joint("y"), spec.joint("z"), spec.geom("foot")):
        spec.delete(part)
    data = mujoco.MjData(model := spec.compile())
    for settling in range(1 + contact * round(1.0 / timestep)):
        if settling:
            mujoco.mj_step(model, data)
        for joint, angle in (("theta", task.START_THETA), ("x", 0.0)):
            data.joint(joint).qpos[0], data.joint(joint).qvel[0] = angle, 0.0
    return model, data


def hold(model: Any, data: Any, torque: float, seconds: float = task.CONTROL_DT) -> np.ndarray:
    """Holds a torque in N m, by default for one control interval; returns theta, theta_dot, x,
    x_dot at its end.
    """
    import mujoco

    data.ctrl[0] = torque
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    return np.ravel([[data.joint(name).qpos, data.joint(name).qvel] for name in ("theta", "x")])


def creep(model: Any, data: Any, load: float) -> float:
    """The speed of the platform in the sixth second under a horizontal force in N, m/s."""
    data.joint("x").qfrc_applied[0] = load
    fifth, sixth = (hold(model, data, 0.0, seconds)[2] for seconds in (5.0, 1.0))
    return abs(sixth - fifth)
