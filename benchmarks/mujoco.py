"""Error and creep of the same capsule in MuJoCo, compared with this package: `python -m benchmarks.mujoco`.

Without friction and with RK4, MuJoCo agrees with `capsule_gym` to 1e-8 over two seconds: only friction differs. The
constraints of MuJoCo are soft, so that the platform creeps below the friction limit.
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
from capsule_gym.parameters import Capsule, Plant

COMMAND = "python -m benchmarks.mujoco"
XML = Path(__file__).with_name("capsule.xml")
INTEGRATORS = ("implicitfast", "RK4")
# MuJoCo's limits of stiffness: the largest impedance, and the smallest time constant in steps.
STIFF_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
STIFF_STEPS = 2.0
NOSLIP_ITERATIONS = 10
# Time in which a platform on a contact sinks into the floor, s.
SETTLING_SECONDS = 1.0
# Friction coefficients and amplitudes of the random torque (N m) of the compared trajectories.
CASES = ((0.01, 0.5), (0.1, 1.0))
# Loads, relative to the friction limit.
LOADS = (0.2, 0.5, 0.9)
CREEP_SECONDS = 10.0
# The motor swings the pendulum about this angle, rad.
CENTRE, SWING = -0.6, 0.1


@dataclass(frozen=True)
class FrictionModel:
    """A model of the floor's friction in MuJoCo.

    Attributes:
        name: name in tables.
        contact: whether the friction is that of a sphere on a plane, with an elliptic cone and the actual normal force;
            else the joint x has the constant friction mu (M + m) g (`frictionloss`).
        stiff: whether constraints are as stiff as MuJoCo allows at the step; else solver parameters are the defaults.
        noslip: whether MuJoCo's no-slip solver runs after the main solver.
    """

    name: str
    contact: bool
    stiff: bool = False
    noslip: bool = False


FRICTIONS = (
    FrictionModel("frictionloss", contact=False),
    FrictionModel("contact", contact=True),
    FrictionModel("contact, stiff", contact=True, stiff=True),
)
# These two creep less than `frictionloss`, at the same speed and error.
ALL_FRICTIONS = (
    *FRICTIONS,
    FrictionModel("frictionloss, stiff", contact=False, stiff=True),
    FrictionModel("frictionloss, noslip", contact=False, noslip=True),
)


def build_model(friction: FrictionModel, integrator: str, timestep: float, capsule: Capsule | None = None) -> Any:
    """Compiles the model.

    Args:
        friction: model of the floor's friction.
        integrator: one of `INTEGRATORS`.
        timestep: s.
        capsule: the plant; None takes the paper's plant. MuJoCo has a single friction coefficient for both directions,
            at rest and in motion.
    """
    import mujoco

    capsule = capsule or Capsule()
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


def start_data(model: Any, theta: float) -> Any:
    """MuJoCo's data of a capsule at rest at the angle theta, after a platform on a contact has sunk into the floor."""
    import mujoco

    data = mujoco.MjData(model)
    for _ in range(round(SETTLING_SECONDS / model.opt.timestep) if model.nv > 2 else 0):
        data.joint("theta").qpos[0] = theta
        mujoco.mj_step(model, data)
        for joint in ("theta", "x"):
            data.joint(joint).qpos[0] = data.joint(joint).qvel[0] = 0.0
    data.joint("theta").qpos[0], data.time = theta, 0.0
    return data


class Batch:
    """Copies of a model that `mujoco.rollout` steps together from theta = -pi/3 at rest.

    Args:
        model: from `build_model`.
        num_envs: number of copies.
        threads: number of threads that share the copies.
        substeps: integration steps in one step.
        restarts: whether a copy restarts when its ball meets the platform.
    """

    def __init__(self, model: Any, num_envs: int, threads: int, substeps: int, *, restarts: bool = True) -> None:
        import mujoco
        from mujoco import rollout

        self.model, self.substeps, self.restarts = model, substeps, restarts
        # The state contains time, positions and velocities.
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self._start = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, start_data(model, task.START_THETA), self._start, kind)
        theta, x = model.joint("theta").qposadr[0], model.joint("x").qposadr[0]
        self._columns = [1 + theta, 1 + model.nq + theta, 1 + x, 1 + model.nq + x]
        self._states = np.tile(self._start, (num_envs, 1))
        self._trace = np.empty((num_envs, substeps, self._start.size))
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        # Without a pool MuJoCo steps on the calling thread.
        self._rollout = rollout.Rollout(nthread=threads if threads > 1 else 0)

    def step(self, torques: np.ndarray) -> np.ndarray:
        """Makes one step with constant torques, N m; returns theta, theta_dot, x, x_dot, one row per copy."""
        controls = torques[:, None, None]
        self._rollout.rollout(self.model, self._data, self._states, controls, nstep=self.substeps, state=self._trace)
        self._states[:] = self._trace[:, -1]
        if self.restarts:
            self._states[np.abs(self._states[:, self._columns[0]]) >= math.pi / 2.0] = self._start
        return self._states[:, self._columns]

    def close(self) -> None:
        """Ends the threads."""
        self._rollout.close()


def simulate(model: Any, torques: np.ndarray) -> np.ndarray:
    """Simulates trajectories from theta = -pi/3 at rest under torques in N m (rows), each held for `task.CONTROL_DT`.

    Returns:
        theta, theta_dot, x, x_dot at the end of each interval: shape (trajectories, intervals, 4).
    """
    batch = Batch(model, len(torques), available_cores(), round(task.CONTROL_DT / model.opt.timestep), restarts=False)
    states = [batch.step(column) for column in torques.T]
    batch.close()
    return np.array(states).swapaxes(0, 1)


def load_torque(load: float, theta: float, theta_dot: float, plant: Plant) -> float:
    """The motor torque that loads a platform at rest with a fraction of its friction limit and swings the pendulum."""
    s, c = math.sin(theta), math.cos(theta)
    # With x'' = 0, the second row of Eq. (1) gives theta'' and the first row then the torque.
    rough = (-load if theta > CENTRE else load) * plant.mu
    ml = plant.m * plant.l
    wanted = rough * ((plant.M + plant.m) * plant.g / ml - theta_dot**2 * c) + theta_dot**2 * s
    return ml * plant.l * wanted / (c + rough * s) - ml * plant.g * s + plant.k * theta + plant.c * theta_dot


def largest_creep(load: float, timestep: float) -> float:
    """The largest |x'| in `capsule_gym` in `CREEP_SECONDS` under `load_torque`, m/s."""
    from capsule_gym import dynamics

    plant = Capsule().plant()
    largest = 0.0
    state: tuple[Any, Any, Any, Any] = (CENTRE - SWING, 0.0, 0.0, 0.0)
    for _ in range(round(CREEP_SECONDS / timestep)):
        state = dynamics.step(*state, load_torque(load, state[0], state[1], plant), plant, timestep)[:4]
        largest = max(largest, abs(float(state[3])))
    return largest


def median_creep(model: Any, load: float) -> float:
    """The median |x'| in MuJoCo in `CREEP_SECONDS` under `load_torque`, m/s."""
    import mujoco

    data, plant = start_data(model, CENTRE - SWING), Capsule().plant()
    theta, x, speeds = data.joint("theta"), data.joint("x"), []
    for _ in range(round(CREEP_SECONDS / model.opt.timestep)):
        data.ctrl[0] = load_torque(load, theta.qpos[0], theta.qvel[0], plant)
        mujoco.mj_step(model, data)
        speeds.append(abs(float(x.qvel[0])))
    return float(np.median(speeds))


def measure() -> dict[str, list[float]]:
    """Measures this package and every friction model and integrator of MuJoCo, at the default step.

    Returns:
        By name, the largest error in any state for each case, and the creep in m/s for each load.
    """
    step = DIRECT_PHYSICS_DT
    count = accuracy.TRAJECTORIES
    expected = [accuracy.expected_trajectories([Capsule(mu=mu)] * count, a) for mu, a in tqdm(CASES, desc="reference")]
    own = [float(accuracy.errors(known, [step]).max()) for known in expected]
    results = {"capsule_gym": [*own, *(largest_creep(load, step) for load in LOADS)]}
    variants = [(friction, integrator) for friction in ALL_FRICTIONS for integrator in INTEGRATORS]
    for friction, integrator in tqdm(variants, desc="MuJoCo"):
        numbers = results[f"MuJoCo {friction.name}, {integrator}"] = []
        for (mu, _), known in zip(CASES, expected, strict=True):
            model = build_model(friction, integrator, step, Capsule(mu=mu))
            states = simulate(model, np.array([trajectory.torques for trajectory in known]))
            ends = [found[each.intervals - 1] for found, each in zip(states, known, strict=True)]
            numbers.append(float(np.abs(np.array(ends) - [each.state for each in known]).max()))
        model = build_model(friction, integrator, step)
        numbers += [median_creep(model, load) for load in LOADS]
    return results


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Error and creep below the friction limit of the same capsule in MuJoCo. Needs the extra `bench`.

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
    errors = (f"error, mu = {mu:g}, ±{amplitude:g} N m" for mu, amplitude in CASES)
    rows = [["", *errors, *(f"creep, {load:.0%}" for load in LOADS)]]
    rows += [[name, *(f"{number:.1e}" for number in numbers)] for name, numbers in results.items()]
    note = (
        f"Error: the largest in any state after 10 s of random torque, {accuracy.TRAJECTORIES} trajectories, against "
        f"DOP853. Creep: median |x'| in m/s over {CREEP_SECONDS:g} s while the pendulum pushes the platform with that "
        "share of its friction limit mu N, forwards and backwards in turn. 'stiff': the hardest constraints that "
        f"MuJoCo allows at the step of {1e3 * DIRECT_PHYSICS_DT:g} ms. {machine('mujoco')}."
    )
    args.report(COMMAND, rows, note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
