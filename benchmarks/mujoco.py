"""The same capsule in MuJoCo (`capsule.xml`).

Without friction it agrees with `capsule_gym` to 1e-8 over 2 s.
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
    "frictionloss": 'integrator="implicitfast"',
    "contact": 'integrator="implicitfast"',
    "impratio": 'integrator="implicitfast" impratio="100"',
    "no-slip": 'integrator="implicitfast" noslip_iterations="50"',
    "stiff": 'integrator="implicitfast"',
    "no-slip, discrete": 'integrator="discrete" noslip_iterations="50"',
}


def build(friction: str, timestep: float, capsule: Capsule) -> tuple[Any, Any]:
    """MuJoCo's model of a plant, and its data at rest at -pi/3.

    A platform on a contact has sunk for a second.
    """
    import mujoco

    contact = friction != "frictionloss"
    stiff = ""
    if friction == "stiff":
        # The smallest time constant, in steps, and the largest impedance of a contact that MuJoCo
        # accepts.
        stiff = f'solref="{2.0 * timestep} 1" solimp="0.9999 0.9999 0.001 0.5 2"'
    coulomb = 0.0 if contact else capsule.mu * (capsule.M + capsule.m) * capsule.g
    text = Template(XML).substitute(
        vars(capsule),
        timestep=timestep,
        options=FRICTIONS[friction],
        stiff=stiff,
        coulomb=coulomb,
    )
    spec = mujoco.MjSpec.from_string(text)
    if not contact:
        for part in (spec.joint("y"), spec.joint("z"), spec.geom("foot")):
            spec.delete(part)
    model = spec.compile()
    data = mujoco.MjData(model)

    def put_to_start() -> None:
        for name, place in (("theta", task.START_THETA), ("x", 0.0)):
            joint = data.joint(name)
            joint.qpos[0] = place
            joint.qvel[0] = 0.0

    put_to_start()
    for _ in range(round(1.0 / timestep) if contact else 0):
        mujoco.mj_step(model, data)
        put_to_start()
    return model, data


def hold(model: Any, data: Any, torque: float, seconds: float = task.CONTROL_DT) -> np.ndarray:
    """Holds a torque in N m, by default for one control interval.

    Returns:
        theta, theta_dot, x, x_dot at its end.
    """
    import mujoco

    data.ctrl[0] = torque
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    joints = data.joint("theta"), data.joint("x")
    return np.ravel([[joint.qpos, joint.qvel] for joint in joints])


def creep(model: Any, data: Any, load: float) -> float:
    """The speed of the platform in the sixth second under a horizontal force in N, m/s."""
    data.joint("x").qfrc_applied[0] = load
    begin = hold(model, data, 0.0, 5.0)[2]
    end = hold(model, data, 0.0, 1.0)[2]
    return abs(end - begin)
