"""The goal task, `CapsuleGoal-v0`: come to rest at a goal as soon as possible.

An episode of 15 s draws the goal's displacement from the start, 5 to 50 cm in either direction;
`reset(options={"goal": 0.3})`, in m, sets it. The goal is reached once the platform has been at rest, with a velocity
of exactly 0, within 2 mm of it for 1 s. The episode goes on then.

| entry behind the observation | min | max |
|---|---|---|
| error e (m), the goal's position less the platform's | -1 | 1 |
| tanh(e / 2 cm) | -1 | 1 |
| how long the platform has been at rest within 2 mm (s) | 0 | 1 |

Reward: `reward_goal`, per second -|e| / 0.5 m + exp(-|e| / 10 cm) / 2 + exp(-|e| / 2 cm) / 2 + exp(-|e| / 4 mm), the
last twice at rest, and 2 more at rest within 2 mm; `reward_energy` and `reward_termination` as in the speed task, with
an energy weight of 0 and a termination penalty of 3.

`info` adds `goal`, its position (m), `error` (m) and `held` (s). Metrics: `success`, 1 where the goal was reached, and
`goal_time`, when that was (s), the rest of 1 s included, or the length of the episode where it was not.

With `randomization="paper", capsule=Capsule()` the floor is the paper's, on which the platform moves under a torque of
1.3 % of the limit: there it is harder to rest than to move.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from capsule_gym.compilation import inlined
from capsule_gym.elementary import clip, decay, tanh
from capsule_gym.parameters import check_number
from capsule_gym.task import LARGEST_STATE, TASKS, Draw, Option, Task
from capsule_gym.tasks import DEFAULTS, ROUNDING

# The displacements that are drawn, and the error that is observed, m.
NEAREST, FARTHEST = 0.05, 0.5
ERROR_BOUND = 1.0
# How near the goal the platform has to rest, m, and for how long, s.
TOLERANCE, HOLD = 0.002, 1.0


class Memory(NamedTuple):
    """What the task remembers; SI units."""

    # Its position.
    goal: float
    # That less the platform's.
    error: float
    # Since the start, at rest within the tolerance, and when it first was there for HOLD, 0 before.
    time: float
    held: float
    reached: float
    displacement: float


@inlined
def begin(x: float, memory: Memory) -> Memory:
    """The goal is as far from the platform as drawn."""
    displacement = memory.displacement
    return Memory(x + displacement, displacement, 0.0, 0.0, 0.0, displacement)


@inlined
def reward(x: float, x_dot: float, moved: float, dt: float, memory: Memory) -> tuple[float, Memory]:
    """How near the platform is to the goal, and whether it rests there."""
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
        TypeError: if it is no number.
        ValueError: if it is not finite or too large.
    """
    farthest = LARGEST_STATE[2]
    return [check_number(name, value, f"a finite number of m within {farthest:g} of 0", -farthest, farthest)]


def metrics(memory: Any, whole: np.ndarray) -> dict[str, np.ndarray]:
    """What `Task.metrics` returns."""
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
