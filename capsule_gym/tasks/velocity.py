"""Follow a commanded mean velocity, which changes during the episode.

## Description

The capsule of `CapsuleStickSlip-v0` on a floor with more friction. A target moves with the commanded velocity. It
starts at the platform at every change of the command and stays within 0.3 m of the platform.

Actions are those of `CapsuleStickSlip-v0`.

## Observation Space

The observation of `CapsuleStickSlip-v0`, followed by:

| Observation | Min | Max |
|---|---|---|
| command (m/s) | -0.2 | 0.2 |
| tanh(e / 5 cm) of the error e: position of the target minus x | -1 | 1 |
| tanh(e / 20 cm) | -1 | 1 |
| velocity of the platform (m/s), filtered with a time constant of 0.25 s | -2 | 2 |

With disturbances, the target of the observation, its error and the velocity follow from the measured x. Reward, `info`
and metrics are true.

## Rewards

The sum of three terms, which `info` contains:

- `reward_tracking`, per second: exp(-|e| / 2 cm) + exp(-|e| / 10 cm) / 2 - |e| / 2 m;
- `reward_energy` and `reward_termination`, as in `CapsuleStickSlip-v0`.

## Starting State

At rest at theta = -pi/3 and x = 0. Commands are uniform in [-10, 10] cm/s, and each lasts 4 to 8 s.
`reset(options={"commands": [{"t": 0.0, "v": 0.05}, {"t": 6.0, "v": -0.1}]})` sets up to eight, with t in s and v in
m/s, in order of time, the first at 0 s. The last one stays. The argument `task=with_commands(low, high)`, from
`capsule_gym.tasks.velocity`, draws them from another range.

## Episode End

The terminations of `CapsuleStickSlip-v0`, and truncation after 1000 steps, 20 s.

## Info

As in `CapsuleStickSlip-v0`, with `command` (m/s), `target` (m) and `error` (m). `episode_metrics` adds

- `velocity_error`: the absolute differences between the mean velocity and the command, each measured from 1.5 s after
  the change of the command and weighted with the measured time, in percent of the commands;
- `unsettled`: the share of commands during whose measurement the platform was never within 2 cm of the target.

A command counts if it was measured for 1 s. If none was, `velocity_error` is 100 and `unsettled` is 1.

## Arguments

Those of `CapsuleStickSlip-v0`, with the defaults `capsule=Capsule(static_ratio=1.3)`, M uniform in [0.45, 0.55] kg, mu
log-uniform in [0.05, 0.5], `energy_weight=0` and `termination_penalty=3`.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from capsule_gym.checks import check_number, check_timed, require
from capsule_gym.core import _core
from capsule_gym.tasks.task import GRIP_DEFAULTS, Draw, Option, Task

# Largest drawn and largest accepted command, m/s, and the range of its duration, s.
DRAWN, LARGEST = 0.1, 0.2
LASTS = (4.0, 8.0)


def parse_commands(name: str, value: Any) -> list[float]:
    """The velocities of the commands and how long each lasts, from `[{"t": s, "v": m/s}]`."""
    accepted = (
        f"a list of 1 to {_core.COMMANDS} dicts {{'t': s, 'v': m/s}}, the first at 0 s, each later than the one before"
    )
    if isinstance(value, (list, tuple)) and not 1 <= len(value) <= _core.COMMANDS:
        raise ValueError(f"{name} must be {accepted}, got {len(value)}")
    times: list[float] = []
    commands: list[float] = []
    for where, t, command in check_timed(name, value, accepted, ("t", "v")):
        require(times != [] or t == 0.0, f"{where}['t']", "0 s for the first command", t)
        times.append(t)
        limit = f"a number of m/s within {LARGEST:g} of 0"
        commands.append(check_number(f"{where}['v']", command["v"], limit, -LARGEST, LARGEST))
    more = _core.COMMANDS - len(times)
    lasts = [later - t for t, later in zip(times, [*times[1:], math.inf], strict=True)]
    return [*commands, *[commands[-1]] * more, *lasts, *[math.inf] * more]


def metrics(memory: Any, whole: np.ndarray) -> dict[str, np.ndarray]:
    """The metrics of `Task.metrics`: the sums with the present command, where it has been measured for long enough."""
    duration = np.where(memory.measured_from > 0.0, memory.since - memory.measured_from, 0.0)
    counts = duration >= _core.MEASURED - _core.TIME_TOLERANCE
    moved = memory.target - memory.error - memory.measured_x
    missed = memory.missed + np.where(counts, abs(moved - memory.command * duration), 0.0)
    commanded = memory.commanded + np.where(counts, abs(memory.command) * duration, 0.0)
    measured = memory.measured + counts
    unsettled = memory.unsettled + counts * (1.0 - memory.settled)
    everything = np.ones(len(measured))
    return {
        "velocity_error": 100.0 * np.divide(missed, commanded, out=everything.copy(), where=commanded > 0.0),
        "unsettled": np.divide(unsettled, measured, out=everything, where=measured > 0.0),
    }


TASK = Task(
    name="velocity",
    env_id="CapsuleVelocity-v0",
    episode_steps=1000,
    term="reward_tracking",
    entries={
        "command": (-LARGEST, LARGEST),
        "near_error": (-1.0, 1.0),
        "far_error": (-1.0, 1.0),
        "mean_x_dot": (-_core.SPEED_BOUND, _core.SPEED_BOUND),
    },
    shown=("command", "target", "error"),
    options={
        "commands": Option((Draw(-DRAWN, DRAWN),) * _core.COMMANDS + (Draw(*LASTS),) * _core.COMMANDS, parse_commands)
    },
    metrics=metrics,
    defaults=GRIP_DEFAULTS,
)


def with_commands(low: float, high: float) -> Task:
    """The task with commands uniform in [low, high], in m/s: a value of the environment's argument `task`.

    Raises:
        TypeError: if a limit is not a number.
        ValueError: if a limit is further than 0.2 m/s from 0, or low is above high.
    """
    accepted = f"a number of m/s within {LARGEST:g} of 0"
    low = check_number("low", low, accepted, -LARGEST, LARGEST)
    high = check_number("high", high, f"{accepted} and not below low", low, LARGEST)
    commands = TASK.options["commands"]
    draws = (Draw(low, high),) * _core.COMMANDS + commands.draws[_core.COMMANDS :]
    return replace(TASK, options={"commands": commands._replace(draws=draws)})
