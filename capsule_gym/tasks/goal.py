"""Move to a goal and rest there, as soon as possible.

## Description

The capsule of `CapsuleStickSlip-v0` on a floor with more friction. Every episode draws the
displacement of a goal. The goal is reached when the platform has been at rest, with a velocity of
exactly 0, within 2 mm of the goal for 1 s.

Actions are those of `CapsuleStickSlip-v0`.

## Observation Space

The observation of `CapsuleStickSlip-v0`, followed by:

| Observation | Min | Max |
|---|---|---|
| error e: position of the goal minus x (m) | -1 | 1 |
| tanh(e / 2 cm) | -1 | 1 |
| time for which the platform has been at rest within 2 mm of the goal (s) | 0 | 1 |

With disturbances, e is the position of the goal minus the measured x, and the platform is at rest
where the measured |x_dot| is at most `stick_threshold`. Reward, `info` and metrics are true.

With `goal_env=True` an observation is a dict for hindsight experience replay: `observation`, that
of `CapsuleStickSlip-v0`; `achieved_goal`, x and x_dot of the platform (m, m/s; float64, measured
with disturbances); and `desired_goal`, the position of the goal and 0.
`compute_reward(achieved_goal, desired_goal, info)` returns the rewards of one or many steps for
other goals ([reference](api/environments.md)); its `info` adds the terms for energy and
termination. A step whose x_dot is the desired one counts as rest.

## Rewards

The sum of three terms, which `info` contains:

- `reward_goal`, per second: -|e| / 0.5 m + exp(-|e| / 10 cm) / 2 + exp(-|e| / 2 cm) / 2
  + exp(-|e| / 4 mm). At rest the last exponential counts twice; at rest within 2 mm, 2 are added;
- `reward_energy` and `reward_termination`, as in `CapsuleStickSlip-v0`.

## Starting State

At rest at theta = -pi/3 and x = 0. The displacement of the goal is uniform in 5 to 50 cm, in either
direction; `reset(options={"goal": 0.3})` sets it, in m.

## Episode End

The terminations of `CapsuleStickSlip-v0`, and truncation after 750 steps, 15 s. Reaching the goal
does not end the episode.

## Info

As in `CapsuleStickSlip-v0`, with `goal` (position, m), `error` (m) and `held` (s).
`episode_metrics` adds `success` (1 if the goal was reached) and `goal_time` (time at which the goal
was reached, s, including the rest of 1 s; the length of the episode if it was not).

## Arguments

Those of `CapsuleStickSlip-v0`, with the defaults `capsule=Capsule(static_ratio=1.3)`, M uniform in
[0.45, 0.55] kg, mu log-uniform in [0.05, 0.5], `energy_weight=0` and `termination_penalty=3`.
`capsule=Capsule(), randomization="paper"` gives the paper's floor, where a torque of 1.3 % of the
limit moves the platform, so that it is difficult to rest.
"""

from typing import Any

import numpy as np

from capsule_gym.checks import check_number, require
from capsule_gym.core import native
from capsule_gym.core.layout import Settings
from capsule_gym.tasks.task import GRIP_DEFAULTS, LARGEST_STATE, Task


def compute_reward(settings: Settings, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
    """The rewards of steps that end with these goals, for environments with `goal_env=True`.

    With the info of a step, the result is its reward, bit for bit, unless the achieved goal is a
    measured one. Terms that an info lacks count as 0: an empty one gives `reward_goal` alone.

    Args:
        settings: those of the environments.
        achieved_goal: x (m) and x_dot (m/s) of the platform, shape (.., 2).
        desired_goal: those that are desired. The platform rests where both x_dot are equal; a
            measured one may differ by `Disturbances.stick_threshold`.
        info: dict of `reward_energy` and `reward_termination`, numbers or arrays, or a sequence of
            such dicts.

    Returns:
        The reward, a float; or float64 of shape (..) for several goals.

    Raises:
        ValueError: if a goal has another shape.
    """
    accepted = "of shape (.., 2), x in m and x_dot in m/s"
    for name, goal in (("achieved_goal", achieved_goal), ("desired_goal", desired_goal)):
        require(np.shape(goal)[-1:] == (2,), name, accepted, goal)
    difference = np.subtract(desired_goal, achieved_goal, dtype=np.float64)
    error, x_dot = np.moveaxis(difference, -1, 0)
    rest = settings.stick_threshold if settings.agent_reads else 0.0
    (rate,) = native.evaluate("goal_rate", error, np.abs(x_dot) <= rest)
    rewards = settings.law_steps * settings.physics_steps * settings.physics_dt * rate
    for term in ("reward_energy", "reward_termination"):
        if isinstance(info, dict):
            given = info.get(term, 0.0)
        else:
            given = [each.get(term, 0.0) for each in info]
        rewards = rewards + np.asarray(given)
    return rewards if rewards.ndim else float(rewards)


def parse_goal(name: str, value: Any) -> list[float]:
    """The displacement of the goal from the start, in m."""
    farthest = LARGEST_STATE[2]
    accepted = f"a finite number of m within {farthest:g} of 0"
    return [check_number(name, value, accepted, -farthest, farthest)]


TASK = Task(
    name="goal", env_id="CapsuleGoal-v0", parsers={"goal": parse_goal}, defaults=GRIP_DEFAULTS
)
