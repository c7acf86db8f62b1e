"""Follow a commanded mean velocity, which changes during the episode.

## Description

The capsule of `CapsuleStickSlip-v0` on a floor with more friction. A target moves with the
commanded velocity. It starts at the platform at every change of the command and stays within 0.3 m
of the platform.

Actions are those of `CapsuleStickSlip-v0`.

## Observation Space

The observation of `CapsuleStickSlip-v0`, followed by:

| Observation | Min | Max |
|---|---|---|
| command (m/s) | -0.2 | 0.2 |
| tanh(e / 5 cm) of the error e: position of the target minus x | -1 | 1 |
| tanh(e / 20 cm) | -1 | 1 |
| velocity of the platform (m/s), filtered with a time constant of 0.25 s | -2 | 2 |

With disturbances, the target of the observation, its error and the velocity follow from the
measured x. Reward, `info` and metrics are true.

## Rewards

The sum of three terms, which `info` contains:

- `reward_tracking`, per second: exp(-|e| / 2 cm) + exp(-|e| / 10 cm) / 2 - |e| / 2 m;
- `reward_energy` and `reward_termination`, as in `CapsuleStickSlip-v0`.

## Starting State

At rest at theta = -pi/3 and x = 0. Commands are uniform in [-10, 10] cm/s, and each lasts 4 to 8 s.
`reset(options={"commands": [{"t": 0.0, "v": 0.05}, {"t": 6.0, "v": -0.1}]})` sets up to eight, with
t in s and v in m/s, in order of time, the first at 0 s. The last one stays. The argument
`task=with_commands(low, high)`, from `capsule_gym.tasks.velocity`, draws them from another range.

## Episode End

The terminations of `CapsuleStickSlip-v0`, and truncation after 1000 steps, 20 s.

## Info

As in `CapsuleStickSlip-v0`, with `command` (m/s), `target` (m) and `error` (m). `episode_metrics`
adds

- `velocity_error`: the absolute differences between the mean velocity and the command, each
  measured from 1.5 s after the change of the command and weighted with the measured time, in
  percent of the commands;
- `unsettled`: the share of commands during whose measurement the platform was never within 2 cm of
  the target.

A command counts if it was measured for 1 s. If none was, `velocity_error` is 100 and `unsettled` is
1.

## Arguments

Those of `CapsuleStickSlip-v0`, with the defaults `capsule=Capsule(static_ratio=1.3)`, M uniform in
[0.45, 0.55] kg, mu log-uniform in [0.05, 0.5], `energy_weight=0` and `termination_penalty=3`.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from capsule_gym.checks import check_number, check_timed, require
from capsule_gym.core import _core
from capsule_gym.tasks.task import GRIP_DEFAULTS, Task

# Largest accepted command, m/s.
LARGEST = _core.LARGEST_COMMAND
WITHIN_LARGEST = f"a number of m/s within {LARGEST:g} of 0"


def parse_commands(name: str, value: Any) -> list[float]:
    """The velocities of the commands and how long each lasts, from `[{"t": s, "v": m/s}]`."""
    accepted = (
        f"a list of 1 to {_core.COMMANDS} dicts {{'t': s, 'v': m/s}}, the first at 0 s, each later "
        "than the one before"
    )
    if isinstance(value, (list, tuple)) and not 1 <= len(value) <= _core.COMMANDS:
        raise ValueError(f"{name} must be {accepted}, got {len(value)}")
    times: list[float] = []
    velocities: list[float] = []
    for where, t, command in check_timed(name, value, accepted, ("t", "v")):
        require(times != [] or t == 0.0, f"{where}['t']", "0 s for the first command", t)
        v = check_number(f"{where}['v']", command["v"], WITHIN_LARGEST, -LARGEST, LARGEST)
        times.append(t)
        velocities.append(v)
    # The last command stays.
    durations = [*np.diff(times).tolist(), math.inf]
    more = _core.COMMANDS - len(times)
    return [*velocities, *velocities[-1:] * more, *durations, *[math.inf] * more]


TASK = Task(
    name="velocity",
    env_id="CapsuleVelocity-v0",
    parsers={"commands": parse_commands},
    defaults=GRIP_DEFAULTS,
)


def with_commands(low: float, high: float) -> Task:
    """The task with commands uniform in [low, high], in m/s, for the argument `task`.

    Raises:
        TypeError: if a limit is not a number.
        ValueError: if a limit is further than 0.2 m/s from 0, or low is above high.
    """
    low = check_number("low", low, WITHIN_LARGEST, -LARGEST, LARGEST)
    high = check_number("high", high, f"{WITHIN_LARGEST} and not below low", low, LARGEST)
    return replace(TASK, draw_range=(low, high))
