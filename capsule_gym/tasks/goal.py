"""Move to a goal and rest there, as soon as possible.

## Description

The capsule of `CapsuleStickSlip-v0` on a floor with more friction. Every episode draws the displacement of a goal. The
goal is reached when the platform has been at rest, with a velocity of exactly 0, within 2 mm of the goal for 1 s.

## Action Space

As in `CapsuleStickSlip-v0`.

## Observation Space

The observation of `CapsuleStickSlip-v0`, followed by:

| Observation | Min | Max |
|---|---|---|
| error e: position of the goal minus x (m) | -1 | 1 |
| tanh(e / 2 cm) | -1 | 1 |
| time for which the platform has been at rest within 2 mm of the goal (s) | 0 | 1 |

## Rewards

The sum of three terms, which `info` contains:

- `reward_goal`, per second: -|e| / 0.5 m + exp(-|e| / 10 cm) / 2 + exp(-|e| / 2 cm) / 2 + exp(-|e| / 4 mm). At rest the
  last exponential counts twice; at rest within 2 mm, 2 are added;
- `reward_energy` and `reward_termination`, as in `CapsuleStickSlip-v0`.

## Starting State

At rest at theta = -pi/3 and x = 0. The displacement of the goal is uniform in 5 to 50 cm, in either direction;
`reset(options={"goal": 0.3})` sets it, in m.

## Episode End

The terminations of `CapsuleStickSlip-v0`, and truncation after 750 steps, 15 s. Reaching the goal does not end the
episode.

## Info

As in `CapsuleStickSlip-v0`, with `goal` (position, m), `error` (m) and `held` (s). `episode_metrics()` adds `success`
(1 if the goal was reached) and `goal_time` (time at which the goal was reached, s, including the rest of 1 s; the
length of the episode if it was not).

## Arguments

Those of `CapsuleStickSlip-v0`, with the defaults `capsule=Capsule(static_ratio=1.3)`, M uniform in [0.45, 0.55] kg, mu
log-uniform in [0.05, 0.5], `energy_weight=0` and `termination_penalty=3`. `capsule=Capsule(), randomization="paper"`
gives the paper's floor, where a torque of 1.3 % of the limit moves the platform, so that it is difficult to rest.

## Version History

* v0: initial version
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from capsule_gym.checks import check_number
from capsule_gym.compilation import inlined
from capsule_gym.elementary import clip, decay, tanh
from capsule_gym.task import LARGEST_STATE, TASKS, Draw, Option, Task
from capsule_gym.tasks import DEFAULTS, ROUNDING

# Range of the drawn displacements, and bound of the observed error, m.
NEAREST, FARTHEST = 0.05, 0.5
ERROR_BOUND = 1.0
# Largest distance from the goal at which the platform must rest, m, and duration of the rest, s.
TOLERANCE, HOLD = 0.002, 1.0


class Memory(NamedTuple):
    """The memory of the task; SI units."""

    # Position of the goal.
    goal: float
    # Position of the goal minus that of the platform.
    error: float
    # Times, s: since the start, at rest within the tolerance, and at which the goal was reached (0 before).
    time: float
    held: float
    reached: float
    displacement: float


@inlined
def begin(x: float, memory: Memory) -> Memory:
    """Places the goal at the drawn displacement from the platform."""
    displacement = memory.displacement
    return Memory(x + displacement, displacement, 0.0, 0.0, 0.0, displacement)


@inlined
def reward(x: float, x_dot: float, moved: float, dt: float, memory: Memory) -> tuple[float, Memory]:
    """The reward for the distance to the goal and for rest there, and the updated memory."""
    goal, _, time, held, reached, displacement = memory
    time += dt
    error = goal - x
    size = abs(error)
    still = 1.0 if x_dot == 0.0 else 0.0
    inside = 1.0 if size <= TOLERANCE else 0.0
    rate = 0.5 * decay(size / 0.1) + 0.5 * decay(size / 0.02)
    rate += decay(size / 0.004) * (1.0 + still) + 2.0 * inside * still - size / 0.5
    # In stick for the whole step.
    held = held + dt if inside * still > 0.0 and moved == 0.0 else 0.0
    reached = time if reached == 0.0 and held >= HOLD - ROUNDING else reached
    return dt * rate, Memory(goal, error, time, held, reached, displacement)


@inlined
def observe(out: np.ndarray, x: float, memory: Memory) -> None:
    """Writes the entries in the order of `TASK.entries`."""
    out[0] = clip(memory.error, ERROR_BOUND)
    out[1] = tanh(memory.error / 0.02)
    out[2] = min(memory.held, HOLD)


def parse_goal(name: str, value: Any) -> list[float]:
    """The displacement of the goal from the start, in m.

    Raises:
        TypeError: if it is not a number.
        ValueError: if it is not finite or too large.
    """
    farthest = LARGEST_STATE[2]
    return [check_number(name, value, f"a finite number of m within {farthest:g} of 0", -farthest, farthest)]


def metrics(memory: Any, whole: np.ndarray) -> dict[str, np.ndarray]:
    """The metrics of `Task.metrics`."""
    success = memory.reached > 0.0
    return {"success": success.astype(np.float64), "goal_time": np.where(success, memory.reached, whole)}


TASK = Task(
    name="goal",
    episode_steps=TASKS["goal"][1],
    term="reward_goal",
    reward=reward,
    memory=Memory,
    begin=begin,
    entries={
        "goal_error": (-ERROR_BOUND, ERROR_BOUND),
        "near_goal_error": (-1.0, 1.0),
        "held": (0.0, HOLD),
    },
    observe=observe,
    shown=("goal", "error", "held"),
    options={"goal": Option((Draw(NEAREST, FARTHEST, signed=True),), parse_goal)},
    metrics=metrics,
    defaults=DEFAULTS,
)
