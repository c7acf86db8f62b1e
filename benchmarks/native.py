"""The hand-written C kernel: built with the machine's gcc and called on the memory of a `Simulation`.

simulation = Simulation(1024)
kernel = Native(simulation, ("-O3", "-march=native"))
kernel()  # what simulation's own kernel does in a step
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

from capsule_gym import task
from capsule_gym.kernels import AT, LANES
from capsule_gym.simulation import Simulation

SOURCE = Path(__file__).with_name("native.c")
STRICT = ("-O3", "-march=native")
FAST = (*STRICT, "-ffast-math")


class _Robot(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in ("m", "l", "g", "k", "c", "static_ratio", "backward_ratio")]


class _Settings(ctypes.Structure):
    _fields_ = [
        *(
            (name, ctypes.c_double)
            for name in (
                "torque_limit",
                "residual_limit",
                "physics_dt",
                "energy_weight",
                "termination_penalty",
                "theta_limit",
                "theta_dot_bound",
                "x_dot_bound",
            )
        ),
        ("physics_steps", ctypes.c_int64),
    ]


def available() -> bool:
    """Whether there is a gcc."""
    return shutil.which("gcc") is not None


class Native:
    """The C kernel for one simulation without a control law.

    Args:
        simulation: whose memory it works on.
        flags: gcc's.

    Raises:
        ValueError: if the simulation has a control law, observes M and mu or subtracts the pivot's torque.
        RuntimeError: if gcc fails.
    """

    def __init__(self, simulation: Simulation, flags: tuple[str, ...]) -> None:
        plant, settings = simulation.capsule.plant(), simulation.settings
        if settings.with_reference or settings.with_parameters or plant.pivot_torque_on_contact:
            raise ValueError("the C kernel knows the direct-torque task with Newton's normal force only")
        self.simulation = simulation
        rows = [f"-DROW_{name}={start}" for name, start in AT._asdict().items()]
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder) / "native.so"
            command = ["gcc", *flags, *rows, f"-DLANES={LANES}", "-shared", "-fPIC", str(SOURCE), "-o", str(library)]
            done = subprocess.run([*command, "-lm"], capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(f"gcc cannot build {SOURCE.name}:\n{done.stderr}")
            self._function = ctypes.CDLL(str(library)).advance
        self._function.restype = None
        integer, pointer = ctypes.c_int64, ctypes.c_void_p
        self._function.argtypes = [pointer, integer, integer, integer, _Robot, _Settings, pointer]
        self._robot = _Robot(*(getattr(plant, field[0]) for field in _Robot._fields_))
        bounds = {
            "theta_limit": task.THETA_LIMIT,
            "theta_dot_bound": task.THETA_DOT_BOUND,
            "x_dot_bound": task.X_DOT_BOUND,
        }
        names = [field[0] for field in _Settings._fields_]
        self._settings = _Settings(*(bounds[name] if name in bounds else getattr(settings, name) for name in names))

    def __call__(self) -> None:
        """One agent step; actions and who takes part are in the simulation's memory."""
        world = self.simulation.world
        self._function(
            world.ctypes.data,
            world[0].size,
            0,
            self.simulation.num_envs,
            self._robot,
            self._settings,
            self.simulation.observations.ctypes.data,
        )
