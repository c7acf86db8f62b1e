"""Error of the same capsule in MuJoCo, compared with this package: `python -m benchmarks.mujoco`.

Without friction and with RK4, MuJoCo agrees with `capsule_gym` to 1e-8 over two seconds: only friction differs.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks import accuracy
from benchmarks.measurement import OutputArgs, available_cores, machine
from capsule_gym import task
from capsule_gym.command_line import parse, refuse
from capsule_gym.config import DIRECT_PHYSICS_DT
from capsule_gym.parameters import Capsule

COMMAND = "python -m benchmarks.mujoco"
XML = Path(__file__).with_name("capsule.xml")
# The friction of the joint x, of a sphere on a plane with an elliptic cone, and the same with the smallest time constant
# and the largest impedance that MuJoCo accepts.
FRICTIONS = ("frictionloss", "contact", "contact, stiff")
INTEGRATORS = ("implicitfast", "RK4")
STIFF_STEPS, STIFF_IMPEDANCE = 2.0, (0.9999, 0.9999, 0.001, 0.5, 2.0)
# Time in which a platform on a contact sinks into the floor, s.
SETTLING_SECONDS = 1.0
# Friction coefficients and amplitudes of the random torque (N m) of the compared trajectories.
CASES = ((0.01, 0.5), (0.1, 1.0))


def build_model(
    friction: str, timestep: float, capsule: Capsule | None = None, integrator: str = INTEGRATORS[0]
) -> Any:
    """Compiles the model of a plant, by default the paper's; MuJoCo has a single friction coefficient."""
    import mujoco

    capsule = capsule or Capsule()
    constants = {name: getattr(capsule, name) for name in ("M", "m", "l", "g", "k", "c", "mu")}
    coulomb = capsule.mu * (capsule.M + capsule.m) * capsule.g if friction == "frictionloss" else 0.0
    text = Template(XML.read_text(encoding="utf-8")).substitute(constants, coulomb=coulomb)
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = timestep
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    if friction == "frictionloss":
        spec.delete(spec.joint("z"))
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    if friction.endswith("stiff"):
        for geom in spec.geoms:
            geom.solref, geom.solimp = (STIFF_STEPS * timestep, 1.0), STIFF_IMPEDANCE
    return spec.compile()


class Batch:
    """Copies of a model that `mujoco.rollout` steps together from theta = -pi/3 at rest.

    Args:
        model: from `build_model`.
        num_envs: number of copies.
        threads: number of threads that share the copies.
        restarts: whether a copy restarts when its ball meets the platform.
    """

    def __init__(self, model: Any, num_envs: int, threads: int, *, restarts: bool = True) -> None:
        import mujoco
        from mujoco import rollout

        self.model, self.restarts, self._substeps = model, restarts, round(task.CONTROL_DT / model.opt.timestep)
        data = mujoco.MjData(model)
        theta, x = (data.joint(name) for name in ("theta", "x"))
        # A platform on a contact sinks into the floor.
        for _ in range(round(SETTLING_SECONDS / model.opt.timestep) if model.nv > 2 else 0):
            theta.qpos[0] = task.START_THETA
            mujoco.mj_step(model, data)
            for joint in (theta, x):
                joint.qpos[0] = joint.qvel[0] = 0.0
        theta.qpos[0], data.time = task.START_THETA, 0.0
        # The state contains time, positions and velocities.
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self._start = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, self._start, kind)
        places = [1 + model.joint(name).qposadr[0] for name in ("theta", "x")]
        self._columns = [place + rate for place in places for rate in (0, model.nq)]
        self._states = np.tile(self._start, (num_envs, 1))
        self._trace = np.empty((num_envs, self._substeps, self._start.size))
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        # Without a pool MuJoCo steps on the calling thread.
        self._rollout = rollout.Rollout(nthread=threads if threads > 1 else 0)
        self.close = self._rollout.close

    def step(self, torques: np.ndarray) -> np.ndarray:
        """Makes one step of 20 ms with constant torques, N m; returns theta, theta_dot, x, x_dot, one row per copy."""
        controls = torques[:, None, None]
        self._rollout.rollout(self.model, self._data, self._states, controls, nstep=self._substeps, state=self._trace)
        self._states[:] = self._trace[:, -1]
        if self.restarts:
            self._states[np.abs(self._states[:, self._columns[0]]) >= math.pi / 2.0] = self._start
        return self._states[:, self._columns]


def simulate(model: Any, torques: np.ndarray) -> np.ndarray:
    """Simulates trajectories from theta = -pi/3 at rest under torques in N m (rows), each held for `task.CONTROL_DT`.

    Returns:
        theta, theta_dot, x, x_dot at the end of each interval: shape (trajectories, intervals, 4).
    """
    batch = Batch(model, len(torques), available_cores(), restarts=False)
    states = [batch.step(column) for column in torques.T]
    batch.close()
    return np.array(states).swapaxes(0, 1)


def measure() -> dict[str, list[float]]:
    """The largest error in any state for each case, of this package and of every friction and integrator of MuJoCo."""
    step, count = DIRECT_PHYSICS_DT, accuracy.TRAJECTORIES
    expected = [accuracy.expected_trajectories([Capsule(mu=mu)] * count, a) for mu, a in tqdm(CASES, desc="reference")]
    results = {"capsule_gym": [float(accuracy.errors(known, [step]).max()) for known in expected]}
    for friction, integrator in tqdm([(f, i) for f in FRICTIONS for i in INTEGRATORS], desc="MuJoCo"):
        numbers = results[f"MuJoCo {friction}, {integrator}"] = []
        for (mu, _), known in zip(CASES, expected, strict=True):
            model = build_model(friction, step, Capsule(mu=mu), integrator)
            states = simulate(model, np.array([trajectory.torques for trajectory in known]))
            ends = [found[each.intervals - 1] for found, each in zip(states, known, strict=True)]
            numbers.append(float(np.abs(np.array(ends) - [each.state for each in known]).max()))
    return results


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Error of the same capsule in MuJoCo. Needs the extra `bench`.

    Examples:
      python -m benchmarks.mujoco --markdown docs/speed_mujoco.md
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    try:
        results = measure()
    except ImportError as error:
        refuse(COMMAND, f'{error}: pip install "capsule-gym[bench]"')
    rows = [["", *(f"error, mu = {mu:g}, ±{amplitude:g} N m" for mu, amplitude in CASES)]]
    rows += [[name, *(f"{number:.1e}" for number in numbers)] for name, numbers in results.items()]
    note = (
        f"Largest error in any state after 10 s of random torque, {accuracy.TRAJECTORIES} trajectories, against DOP853, at "
        f"a step of {1e3 * DIRECT_PHYSICS_DT:g} ms. 'stiff': the hardest contact that MuJoCo accepts. {machine()}."
    )
    args.report(COMMAND, rows, note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
