"""What the cases draw their arguments, options, states and actions from."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from capsule_gym import Capsule, Controller, Randomization
from capsule_gym.simulation import CHANGE

Rng = np.random.Generator
Draw = Callable[[Rng], Any]

# Of the wrong type, not finite, beyond all bounds, or of a type that is almost a number's.
HOSTILE: tuple[Any, ...] = (
    *(
        None,
        True,
        False,
        "",
        "x",
        "1.0",
        b"1",
        [],
        (),
        {},
        [1.0],
        (1, 2),
        [[]],
        [[1.0], [2.0, 3.0]],
        {"M": 1},
        object(),
    ),
    *(print, type, Capsule, 1j, Fraction(1, 3), float("nan"), float("inf"), float("-inf"), 0, 0.0, -0.0, -1, -1.0),
    *(-1e-300, 5e-324, 1e-300, 1e-25, 1e-9, 1.5, 1e9, 1e25, 1e300, 10**400, -(10**400), 10**5000, 2**63, 2**64),
    *(-(2**63), np.nan, np.float16(0.1), np.float32("inf"), np.longdouble(1.0), np.longdouble("1e4000"), np.int64(-3)),
    *(np.uint8(1), np.bool_(True), np.array(1.0), np.array([1.0, 2.0]), np.array(["a"]), np.array(None)),
    *(np.datetime64("2020-01-01"), np.ma.masked, np.zeros((0, 1))),
)
# Numbers of environments that no machine holds; those that some machine might hold are not tried.
HOSTILE_COUNTS = (0, -1, 1.5, None, True, "3", 2**40, 2**63, 10**400, np.nan, [], np.array([2]))
HOSTILE_CONTROLLERS = (
    *("", ":", "x", "baselines", "baselines:", ":adaptive", "baselines:nothing", "nowhere:law", ".:x", "..a:b"),
    *("a..b:c", "os:getcwd", "math:sin", "numpy:array", "\0:x", "baselines:__name__", 3, print, [], Capsule),
)


def one(rng: Rng, values: Sequence[Any]) -> Any:
    """One of the values."""
    return values[int(rng.integers(len(values)))]


def among(*values: Any) -> Draw:
    """Draws one of them."""
    return partial(one, values=values)


def magnitude(low: float, high: float) -> Draw:
    """Draws a number whose logarithm is uniform, between two powers of ten."""
    return lambda rng: float(10.0 ** rng.uniform(low, high))


def capsule(rng: Rng) -> Any:
    """A capsule that may be one, of any proportions; None is the paper's."""
    ranges = {"M": (-2, 2), "m": (-3, 1), "l": (-2, 1), "g": (-2, 2), "k": (-4, 3), "c": (-4, 2), "mu": (-6, 0.5)}
    if rng.random() < 0.1:
        ranges = dict.fromkeys(ranges, (-13, 13))
    fields = {name: magnitude(*ends)(rng) for name, ends in ranges.items() if rng.random() < 0.3}
    fields |= {name: 0.0 for name in ("k", "c", "mu") if rng.random() < 0.1}
    ratios = {name: float(rng.uniform(1.0, 3.0)) for name in ("static_ratio", "backward_ratio") if rng.random() < 0.2}
    # Few: another normal force is another kernel.
    contact = {"normal_force": "paper"} if rng.random() < 0.05 else {}
    return one(rng, (None, partial(Capsule, **fields, **ratios, **contact)))


def randomization(rng: Rng) -> Any:
    """Ranges of M and mu, or their name."""
    M, mu = sorted(rng.uniform(0.2, 1.9, 2)), sorted(rng.uniform(0.001, 1.0, 2))
    own = partial(Randomization, M=one(rng, (None, M)), mu=one(rng, (None, mu)), log_mu=bool(rng.integers(2)))
    return one(rng, ("none", "paper", "wide", own, partial(Randomization, mu=(0.0, 0.0))))


def tracking_law(
    theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
) -> tuple[float, tuple[float, ...]]:
    """A law that tracks badly, and breaks at high speed."""
    if theta_dot > 15.0:
        return math.nan, memory
    return 10.0 * (reference[0] - theta) + memory[0], (0.9 * memory[0] + reference[1],)


def controller(rng: Rng) -> Any:
    """None, the name of a law, or one of the user's own."""
    table = rng.uniform(-1.0, 1.0, (int(rng.integers(1, 50)), 2)) * 10.0 ** float(rng.choice([0, 0, 0, 3, 300]))
    own = partial(
        Controller, name="tracking", law=tracking_law, reference=table, dt=one(rng, (1e-3, 2e-3, 5e-3, 0.01, 0.007))
    )
    return one(rng, (None, None, None, "baselines:adaptive", "baselines:compliant", "baselines:epc", own))


ARGUMENTS: dict[str, Draw] = {
    "controller": controller,
    "residual_limit": among(None, 0.5, 1.5, 3, 30.0, 1e-6),
    "torque_limit": among(0.1, 1.5, 1, 3.0, 50.0),
    "randomization": randomization,
    "capsule": capsule,
    "observe_parameters": lambda rng: bool(rng.integers(2)),
    "energy_weight": among(0.0, 0.1, 5, 100.0),
    "termination_penalty": among(0.0, 10.0, 30, 1e6),
    "initial_noise": among(0.0, 0.1, 0.5),
    "control_dt": among(0.02, 0.01, 0.05, 0.1),
    "physics_dt": among(None, 1e-3, 5e-4),
    "render_mode": among(None, None, None, "rgb_array"),
}
BATCH_ARGUMENTS: dict[str, Draw] = {
    **ARGUMENTS,
    "num_envs": among(1, 1, 2, 2, 3, 3, 5, 8, 63, 64, 65, 130),
    "threads": among(1, 2, 3, np.int64(2)),
    "max_episode_steps": among(1, 2, 7, 50, 1650),
    "autoreset_mode": among("NEXT_STEP", "SAME_STEP", "DISABLED", "Disabled", *AutoresetMode),
}
HOSTILE_ARGUMENTS: dict[str, Sequence[Any]] = {
    "controller": HOSTILE_CONTROLLERS,
    "num_envs": HOSTILE_COUNTS,
    "threads": HOSTILE_COUNTS[:6],
}


def state(rng: Rng) -> list[float]:
    """theta, theta_dot, x, x_dot: any angle, any speed."""
    scale = magnitude(-3, 3)(rng)
    speeds = (scale * rng.uniform(-1.0, 1.0, 3) * rng.integers(0, 2, 3)).tolist()
    return [float(rng.uniform(-1.5707, 1.5707)), *speeds]


def changes(rng: Rng) -> list[dict[str, float]]:
    """Jumps of M and mu."""
    times = np.cumsum(rng.uniform(0.001, 0.3, int(rng.integers(4))))
    return [dict(zip(CHANGE, (float(t), rng.uniform(0.2, 2.0), rng.uniform()), strict=True)) for t in times]


OPTIONS: dict[str, Draw] = {
    "M": lambda rng: float(rng.uniform(0.2, 2.0)),
    "mu": lambda rng: float(rng.uniform()),
    "state": state,
    "changes": changes,
}
# Inside a list of jumps.
HOSTILE_CHANGES = (
    *({}, {"t": 0.1}, {"t": 0.1, "M": 0.5, "mu": 0.1, "x": 1}, {"t": "a", "M": 0.5, "mu": 0.1}, None, 3, "tMm"),
    *({"t": -1.0, "M": 0.5, "mu": 0.1}, {"t": 0.0, "M": 10**400, "mu": 0.1}, {"t": 0.0, "M": 0.5, "mu": [1]}),
)

SEEDS = (None, None, 0, 3, 2**31, 2**64 - 1, 2**70, np.int64(7))
HOSTILE_SEEDS = (-1, "x", 1.5, True, [], {}, [None], [1], [-1], ["a"], 10**400, object(), np.array([1]), np.array(1))

# How an episode is driven: each draws the actions of one step.
DRIVES: tuple[Callable[[Rng, int, int], np.ndarray], ...] = (
    lambda rng, step, n: rng.uniform(-1.5, 1.5, (n, 1)),
    lambda rng, step, n: np.full((n, 1), 1.0 if step % 20 < 10 else -1.0),
    lambda rng, step, n: np.full((n, 1), rng.choice([-1.0, 1.0])),
    lambda rng, step, n: np.zeros((n, 1)),
    lambda rng, step, n: np.full((n, 1), rng.choice([-0.0, 1e-45, 3e38, -3e38])),
)


def hostile_actions(rng: Rng, actions: np.ndarray) -> Any:
    """What is no array of actions, or hardly one."""
    n = len(actions)
    poisoned = actions.copy()
    poisoned.flat[int(rng.integers(poisoned.size))] = one(rng, (np.nan, np.inf, -np.inf))
    shapes = (actions[:0], actions[..., None], actions.T, actions.ravel()[: n - 1], np.zeros((n + 1, 1)))
    types = [actions.astype(name) for name in ("f8", ">f4", "?", "U", "O", "m8[s]")]
    lists = ([[10**400]] * n, [[None]] * n, ["a"] * n, [[1e300]] * n, [10**400], [None], (0.2,), [[0.1], [0.1, 0.2]])
    strided = np.asfortranarray(np.zeros((n, 2), np.float32))[:, :1]
    return one(rng, (*HOSTILE, *shapes, *types, *lists, actions.tolist(), strided, poisoned))
