"""The same capsule in MuJoCo: model, batch and open-loop simulation. Needs the extra `bench`.

Frictionless and with MuJoCo's RK4 it follows `capsule_gym` to 1e-8 over two seconds
(tests/benchmarks/test_benchmarks.py): the plant is the same, and only friction differs. MuJoCo's constraints are
soft, so its friction creeps below the limit.
"""

from __future__ import annotations

import math
from pathlib import Path
from string import Template
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.frictions import Friction
from capsule_gym.parameters import Capsule

XML = Path(__file__).with_name("capsule.xml")
# MuJoCo's own limits of stiffness: the largest impedance, and the time constant in steps below which it clips.
STIFF_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
STIFF_STEPS = 2.0
NOSLIP_ITERATIONS = 10
SETTLING = 1.0


def build_model(capsule: Capsule, friction: Friction, integrator: str, timestep: float) -> Any:
    """Compiles the model.

    Args:
        capsule: the plant; static and kinetic friction are the same in MuJoCo, forwards and backwards.
        friction: how the floor is modelled.
        integrator: one of `frictions.INTEGRATORS`.
        timestep: s.
    """
    constants = {name: getattr(capsule, name) for name in ("M", "m", "l", "g", "k", "c", "mu")}
    coulomb = 0.0 if friction.contact else capsule.mu * (capsule.M + capsule.m) * capsule.g
    text = Template(XML.read_text(encoding="utf-8")).substitute(constants, coulomb=coulomb)
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = timestep
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    if friction.noslip:
        spec.option.noslip_iterations = NOSLIP_ITERATIONS
    if not friction.contact:
        spec.delete(spec.joint("z"))
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    if friction.stiff:
        reference = (STIFF_STEPS * timestep, 1.0)
        for geom in spec.geoms:
            geom.solref, geom.solimp = reference, STIFF_IMPEDANCE
        spec.joint("x").solref_friction, spec.joint("x").solimp_friction = reference, STIFF_IMPEDANCE
    return spec.compile()


def start_data(model: Any, state: tuple[float, float, float, float]) -> Any:
    """MuJoCo's data in the state theta, theta_dot, x, x_dot; a platform on a contact has sunk into the floor before."""
    theta, theta_dot, x, x_dot = state
    data = mujoco.MjData(model)

    def put(rate: float, velocity: float) -> None:
        data.joint("theta").qpos[0], data.joint("theta").qvel[0] = theta, rate
        data.joint("x").qpos[0], data.joint("x").qvel[0] = x, velocity

    put(0.0, 0.0)
    if model.nv > 2:
        for _ in range(round(SETTLING / model.opt.timestep)):
            advance(model, data)
            put(0.0, 0.0)
    put(theta_dot, x_dot)
    data.time = 0.0
    return data


def advance(model: Any, data: Any) -> None:
    """One step of the integrator."""
    mujoco.mj_step(model, data)


def _packed(model: Any, data: Any) -> np.ndarray:
    """The state as `mujoco.rollout` reads it."""
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state


def _columns(model: Any) -> list[int]:
    """Where theta, theta_dot, x and x_dot stand in that state: after the time come positions, then velocities."""
    theta, x = model.joint("theta").qposadr[0], model.joint("x").qposadr[0]
    return [1 + theta, 1 + model.nq + theta, 1 + x, 1 + model.nq + x]


class Batch:
    """Copies of one model that `mujoco.rollout` steps together; where the ball meets the platform it begins again.

    Args:
        model: as `build_model` makes it.
        num_envs: number of copies.
        threads: threads that share them.
        start: theta, theta_dot, x, x_dot at the beginning.
        substeps: steps of the integrator in one step.
    """

    def __init__(
        self, model: Any, num_envs: int, threads: int, start: tuple[float, float, float, float], substeps: int
    ) -> None:
        self.model, self.substeps = model, substeps
        self._start = _packed(model, start_data(model, start))
        self._theta = _columns(model)[0]
        self._states = np.tile(self._start, (num_envs, 1))
        self._trace = np.empty((num_envs, substeps, self._start.size))
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        # Without a pool MuJoCo steps on the calling thread.
        self._rollout = rollout.Rollout(nthread=threads if threads > 1 else 0)

    def step(self, torques: np.ndarray) -> None:
        """One step with the torques held, N m, of shape (num_envs, 1)."""
        controls = torques[:, :, None]
        self._rollout.rollout(self.model, self._data, self._states, controls, nstep=self.substeps, state=self._trace)
        self._states[:] = self._trace[:, -1]
        failed = np.abs(self._states[:, self._theta]) >= math.pi / 2.0
        if failed.any():
            self._states[failed] = self._start

    def close(self) -> None:
        """Ends the threads."""
        self._rollout.close()


def simulate(
    model: Any, torques: np.ndarray, start: tuple[float, float, float, float], hold: float, threads: int = 1
) -> np.ndarray:
    """Trajectories under torques that are held.

    Args:
        model: as `build_model` makes it.
        torques: one trajectory per row, N m.
        start: theta, theta_dot, x, x_dot at the beginning.
        hold: length of a hold, s.
        threads: threads that share the trajectories.

    Returns:
        theta, theta_dot, x, x_dot at the end of each hold: shape (trajectories, holds, 4).
    """
    steps = round(hold / model.opt.timestep)
    first = np.tile(_packed(model, start_data(model, start)), (len(torques), 1))
    data = [mujoco.MjData(model) for _ in range(threads)]
    with rollout.Rollout(nthread=threads if threads > 1 else 0) as run:
        states, _ = run.rollout(model, data, first, np.repeat(torques, steps, axis=1)[:, :, None])
    return states[:, steps - 1 :: steps][:, :, _columns(model)]
