"""Move to a goal and rest there, as soon as possible.

## Description

The capsule of `CapsuleStickSlip-v0` on a floor with more friction. Every episode draws the displacement of a goal. The
goal is reached when the platform has been at rest, with a velocity of exactly 0, within 2 mm of the goal for 1 s.

Actions are those of `CapsuleStickSlip-v0`.

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

As in `CapsuleStickSlip-v0`, with `goal` (position, m), `error` (m) and `held` (s). `episode_metrics` adds `success`
(1 if the goal was reached) and `goal_time` (time at which the goal was reached, s, including the rest of 1 s; the
length of the episode if it was not).

## Arguments

Those of `CapsuleStickSlip-v0`, with the defaults `capsule=Capsule(static_ratio=1.3)`, M uniform in [0.45, 0.55] kg, mu
log-uniform in [0.05, 0.5], `energy_weight=0` and `termination_penalty=3`. `capsule=Capsule(), randomization="paper"`
gives the paper's floor, where a torque of 1.3 % of the limit moves the platform, so that it is difficult to rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from capsule_gym import _core
from capsule_gym.checks import check_number
from capsule_gym.task import LARGEST_STATE, TASKS, Draw, Option, Task
from capsule_gym.tasks import DEFAULTS

# Range of the drawn displacements, m.
NEAREST, FARTHEST = 0.05, 0.5


def parse_goal(name: str, value: Any) -> list[float]:
    """The displacement of the goal from the start, in m."""
    farthest = LARGEST_STATE[2]
    return [check_number(name, value, f"a finite number of m within {farthest:g} of 0", -farthest, farthest)]


def metrics(memory: Any, whole: np.ndarray) -> dict[str, np.ndarray]:
    """See `Task.metrics`."""
    success = memory.reached > 0.0
    return {"success": success.astype(np.float64), "goal_time": np.where(success, memory.reached, whole)}


TASK = Task(
    name="goal",
    episode_steps=TASKS["goal"][1],
    term="reward_goal",
    entries={
        "goal_error": (-_core.ERROR_BOUND, _core.ERROR_BOUND),
        "near_goal_error": (-1.0, 1.0),
        "held": (0.0, _core.HOLD),
    },
    shown=("goal", "error", "held"),
    options={"goal": Option((Draw(NEAREST, FARTHEST, signed=True),), parse_goal)},
    metrics=metrics,
    defaults=DEFAULTS,
)
