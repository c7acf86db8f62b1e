"""Logs of a rig: recording, reading and their checks."""

import csv
import math
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym import _core
from capsule_gym.checks import check_integer, check_number, nearest, require
from capsule_gym.env import CapsuleEnv
from capsule_gym.files import write_atomically
from capsule_gym.layout import Row
from capsule_gym.parameters import Disturbances
from capsule_gym.task import THETA_LIMIT
from capsule_gym.trajectory import STATE

UNITS = {"t": "s", "torque": "N m", "theta": "rad", "theta_dot": "rad/s", "x": "m", "x_dot": "m/s"}
# Largest plausible sizes, shortest and longest log, s, and its largest number of rows: memory grows with their product.
LARGEST = {"torque": 20.0, "theta": 1.2 * THETA_LIMIT, "theta_dot": 1.5 * _core.THETA_DOT_BOUND, "x_dot": 4.0, "x": 1e3}
SHORTEST, LONGEST, MOST_ROWS = 2.0, 100.0, 100_000


def read_log(log: Any) -> dict[str, np.ndarray]:
    """The columns of a log, float64, with NaN where a reading is missing, after all checks of `identify`."""
    if isinstance(log, (str, os.PathLike)):
        try:
            # Spreadsheets write a mark in front of the first name.
            lines = Path(log).read_text(encoding="utf-8-sig").splitlines()
        except UnicodeDecodeError:
            raise ValueError(f"log must be a CSV file in UTF-8, got {str(log)!r} in another encoding") from None
        reader = csv.DictReader(filter(str.strip, lines), skipinitialspace=True)
        rows, names = list(reader), reader.fieldnames or []
        require(len({*names}) == len(names), "log", "of columns with different names", names)
        for row in rows:
            require(None not in row, "a row of log", f"of one number for each of {[*row][:-1]}", [*row.values()])
        log = {name: [row[name] or "nan" for row in rows] for name in (rows[0] if rows else {})}
    require(isinstance(log, Mapping), "log", "the path of a CSV file or a mapping of columns", log, TypeError)
    columns: dict[str, np.ndarray] = {}
    for name, values in log.items():
        where, exact = f"column {name!r}", name in ("t", "torque")
        if name not in UNITS:
            raise ValueError(f"log must have columns out of {tuple(UNITS)}, got {name!r}{nearest(str(name), UNITS)}")
        try:
            column = columns[name] = np.array(values, np.float64, ndmin=1)
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"{where} must contain numbers ({UNITS[name]}) only: {error}") from None
        expected = (len(next(iter(columns.values()))),)
        require(column.shape == expected, where, "one number for each row", column.shape)
        lost = np.isnan(column)
        broken = np.isinf(column).any() or (lost.any() and exact) or (lost.size and lost.all())
        accepted = "finite numbers" if exact else "finite numbers, or NaN for a lost reading, not all"
        require(not broken, where, accepted, column)
        largest, limit = float(np.nanmax(np.abs(column), initial=0.0)), LARGEST.get(name, math.inf)
        require(largest <= limit, where, f"in {UNITS[name]}, within +-{limit:g}", largest)
    complete = {"t", "torque"} <= set(columns) and bool({"theta", "theta_dot"} & set(columns))
    require(complete, "log", "of the columns 't', 'torque', and 'theta' or 'theta_dot'", tuple(columns))
    t, torque, dt = columns["t"], columns["torque"], np.diff(columns["t"])
    period = float(dt.mean()) if len(dt) else 0.0
    equal = 1e-4 <= period <= 0.05 and bool((np.abs(dt - period) <= 0.05 * period).all())
    accepted = (
        f"in equal steps of 0.0001 to 0.05 s, over at least {SHORTEST:g} s and at most {LONGEST:g} s, in at most "
        f"{MOST_ROWS} rows"
    )
    worst = int(np.abs(dt - period).argmax()) if len(dt) else 0
    found = f"{len(t)} rows over {dt.sum():g} s; the step after row {worst} is {dt[worst : worst + 1]}"
    require(equal and SHORTEST <= dt.sum() <= LONGEST and len(t) <= MOST_ROWS, "column 't'", accepted, found)
    require(np.ptp(torque) > 1e-6 * np.abs(torque).max(), "column 'torque'", "varied (N m)", torque)
    for place, rate in (("theta", "theta_dot"), ("x", "x_dot")):
        if place not in columns or rate not in columns:
            continue
        # The change of a position over 0.1 s against the mean rate: one scale for both, or the units differ.
        width = max(1, round(0.1 / period))
        known = np.isfinite(columns[rate])
        filled = np.interp(t, t[known], columns[rate][known])
        mean = np.convolve(filled, np.ones(width) / width, "valid")[:-1]
        change = (columns[place][width:] - columns[place][:-width]) / (width * period)
        both = np.isfinite(change)
        # Where noise dominates, the scales tell nothing.
        sizes = np.std([change[both], mean[both]], axis=1) if both.any() else np.ones(2)
        ratio = sizes[0] / max(sizes[1], 1e-12)
        if not 0.5 < ratio < 2.0 and sizes.all() and np.corrcoef(change[both], mean[both])[0, 1] > 0.9:
            raise ValueError(
                f"column {rate!r} must be the derivative of column {place!r}, in {UNITS[rate]} and {UNITS[place]}: "
                f"changes of {place} are {ratio:.3g} times the integral of {rate}"
            )
    return columns


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """A policy for `record` that moves a rig so that a log determines its plant: a multisine under a weak PD law.

    `start` returns the policy of an episode. It observes theta and theta_dot first, as the environment's agents do.

    Attributes:
        seed: seed of the frequencies, from 0.3 to 8 Hz, and of the phases.
        amplitude: root mean square of the multisine, N m.
        torque_limit: torque of an action of 1, N m.
        control_dt: period, s.
    """

    seed: int = 0
    amplitude: float = 0.45
    torque_limit: float = 1.5
    control_dt: float = 0.01

    def __post_init__(self) -> None:
        check_integer("Excitation.seed", self.seed, "an integer >= 0", 0, sys.maxsize)
        for name in ("amplitude", "torque_limit", "control_dt"):
            check_number(f"Excitation.{name}", getattr(self, name), "a finite number > 0", 0.0, open_low=True)

    def start(self, seeds: Any = (0,)) -> Callable[[Any], np.ndarray]:
        """The policy of an episode, from observations to actions."""
        generator = np.random.default_rng(self.seed)
        frequencies = np.exp(generator.uniform(math.log(0.3), math.log(8.0), 16))
        phases, steps = generator.uniform(0.0, 2.0 * np.pi, 16), count()

        def act(observation: Any) -> np.ndarray:
            theta, theta_dot = (observation["observation"] if isinstance(observation, dict) else observation)[:2]
            waves = np.sin(2.0 * np.pi * self.control_dt * next(steps) * frequencies + phases)
            torque = self.amplitude * waves.sum() / math.sqrt(8.0) - 0.6 * theta - 0.04 * theta_dot
            return np.clip(np.array([torque / self.torque_limit], np.float32), -1.0, 1.0)

        return act


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
        env: an environment with direct torque, wrapped or not; with disturbances the log contains its readings.
        policy: a function from an observation to an action, or an object whose `start([0])` returns one, such as a
            `Policy`; None for `Excitation`.
        path: a new CSV file for the log, or None.
        seconds: duration, s; the log ends earlier where the episode does.
        seed: seed of the reset.
        options: options of the reset.

    Returns:
        The columns, float64.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if the torque is not constant during an agent step, or the file exists.
    """
    plain: Any = getattr(env, "unwrapped", None)
    direct = isinstance(plain, CapsuleEnv) and plain.simulation.controller is None
    require(direct, "env", "an environment with direct torque, without a controller", env)
    fits = path is None or (os.path.isdir(Path(path).parent) and not os.path.exists(path))
    require(fits, "path", "that of a new file in a folder that exists", path)
    settings, dt = plain.simulation.settings, plain.simulation.options.control_dt
    scale = settings.torque_limit if settings.total_torque else settings.residual_limit
    limit = min(settings.residual_limit, settings.torque_limit)
    steps = round(check_number("seconds", seconds, f"a finite number >= {dt:g} (s)", dt) / dt)
    policy = Excitation(torque_limit=scale, control_dt=dt) if policy is None else policy
    act = policy.start([0]) if hasattr(policy, "start") else policy
    require(callable(act), "policy", "None, a function, or an object with `start`", policy, TypeError)
    observation, info = env.reset(seed=seed, options=options)
    disturbed = Disturbances.named(plain.simulation.options.disturbances)
    missing = () if disturbed is None else (*disturbed.unmeasured, *(("x",) if disturbed.x_noise is None else ()))
    sensors = [name for name in STATE if name not in missing]
    rows = []
    for step in range(steps):
        reading = dict(zip(STATE, (info["state"] if disturbed is None else info["reading"]).tolist(), strict=True))
        observation, _, terminated, truncated, info = env.step(act(observation))
        # That of the innermost environment: wrappers may change it.
        action = plain.simulation.world[0, Row.action, 0]
        torque = float(np.clip(scale * action, -limit, limit))
        rows.append([step * dt, torque, *(reading[name] for name in sensors)])
        if terminated or truncated:
            break
    names = ("t", "torque", *sensors)
    if path is not None:
        lines = [",".join(names), *(",".join(map(repr, row)) for row in rows)]
        write_atomically(Path(path), "\n".join(lines) + "\n")
    return dict(zip(names, np.array(rows).T, strict=True))
