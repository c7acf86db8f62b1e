"""Logs of environments, which stand for a rig."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.checks import check_number, require
from capsule_gym.core.layout import STATE, Row
from capsule_gym.envs.env import CapsuleEnv
from capsule_gym.envs.simulation import Simulation
from capsule_gym.files import write_atomically
from capsule_gym.identification.excitation import Excitation
from capsule_gym.parameters import Disturbances


def record(
    env: Any,
    policy: Any = None,
    path: str | os.PathLike[str] | None = None,
    *,
    seconds: float = 20.0,
    seed: int | None = None,
    options: dict[str, Any] | None = None,
) -> dict[str, np.ndarray]:
    """Records an episode as a log for `identify`.

    Args:
        env: an environment with direct torque, wrapped or not; with disturbances the log contains
            its readings.
        policy: a function from an observation to an action, or an object whose `start([0])` returns
            one, such as a `Policy`; None for `Excitation`.
        path: a new CSV file for the log, or None.
        seconds: duration, s; the log ends earlier where the episode does.
        seed: seed of the reset.
        options: options of the reset.

    Returns:
        The columns, float64. `t` is when the sensors were read; with `jitter` the torque acts from
        the next multiple of the period on. Lost readings are NaN, and empty cells of the file.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if the torque is not constant during an agent step, or the file exists.
    """
    plain: Any = getattr(env, "unwrapped", None)
    direct = isinstance(plain, CapsuleEnv) and plain.simulation.controller is None
    require(direct, "env", "an environment with direct torque, without a controller", env)
    if path is not None:
        new = Path(path).parent.is_dir() and not Path(path).exists()
        require(new, "path", "that of a new file in a folder that exists", path)
    settings, config = plain.simulation.settings, plain.simulation.options
    dt = config.control_dt
    scale = settings.torque_limit if settings.total_torque else settings.residual_limit
    limit = min(settings.residual_limit, settings.torque_limit)
    seconds = check_number("seconds", seconds, f"a finite number >= {dt:g} (s)", dt)
    if policy is None:
        policy = Excitation(torque_limit=scale, control_dt=dt)
    act = policy.start([0]) if hasattr(policy, "start") else policy
    accepted = "None, a function, or an object with `start`"
    require(callable(act), "policy", accepted, policy, TypeError)
    observation, info = env.reset(seed=seed, options=options)
    disturbed = Disturbances.named(config.disturbances)
    sensors = sensors_of(disturbed)
    source = "state" if disturbed is None else "reading"
    rows = []
    for step in range(round(seconds / dt)):
        t, lost = read_sampling(plain.simulation, step * dt)
        measured = np.where(lost, np.nan, info[source])
        reading = dict(zip(STATE, measured.tolist(), strict=True))
        observation, _, terminated, truncated, info = env.step(act(observation))
        # That of the innermost environment: wrappers may change it.
        action = plain.simulation.world[0, Row.action, 0]
        torque = float(np.clip(scale * action, -limit, limit))
        readings = [reading[name] for name in sensors]
        rows.append([t, torque, *readings])
        if terminated or truncated:
            break
    names = ("t", "torque", *sensors)
    if path is not None:
        lines = [",".join(map(str, row)).replace("nan", "") for row in (names, *rows)]
        write_atomically(Path(path), "\n".join(lines) + "\n")
    return dict(zip(names, np.transpose(rows), strict=True))


def read_sampling(simulation: Simulation, t: float) -> tuple[float, np.ndarray]:
    """When the reading of time t, s, was taken, and which components of the state it lost."""
    if not simulation.settings.varied:
        return t, np.zeros(len(STATE), bool)
    (lost,) = simulation.rows(Row.lost_theta, Row.lost_x_dot + 1).T
    return t - float(simulation.row(Row.early)[0]), lost != 0.0


def sensors_of(disturbed: Disturbances | None) -> list[str]:
    """The components of the state that are measured; without disturbances all are."""
    if disturbed is None:
        return list(STATE)
    missing = [*disturbed.unmeasured]
    if disturbed.x_noise is None:
        missing.append("x")
    return [name for name in STATE if name not in missing]
