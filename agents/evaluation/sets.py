"""The frozen evaluation sets: the plants that every policy is judged on, the same for all, and their hashes.

`python -m agents.evaluation.sets` draws them anew and writes agents/evaluation/frozen/*.json.

| set | episodes | platform mass M and friction coefficient mu |
|---|---|---|
| `nominal` | 100 | the paper's plant, from 100 angles |
| `paper` | 100 | drawn as by `randomization="paper"` |
| `wide` | 100 | drawn as by `randomization="wide"` |
| `extrapolation` | 100 | outside `wide` in M, in mu or in both |
| `drift` | 100 | drawn three times as in `wide` |
| `sticky` | 1000 | M and mu as in `randomization="sticky"`, spread evenly; static friction 1.3 times the kinetic |
| `real` | 1000 | M and mu as in `paper`, m, l, k and c within 10 %, all spread evenly; `disturbances="real"` |
| `real-wide` | 1000 | the same with M and mu as in `wide` |
| `goal` | 1000 | of the task `goal`: M and mu as the task draws them, and the goal |
| `goal-paper` | 1000 | of the task `goal` on the paper's floor: M and mu as in `paper`, static friction as kinetic |
| `velocity` | 1000 | of the task `velocity`: M and mu as the task draws them; commands from the plant's seed |

`nominal` starts at rest as all do, but within 0.1 rad of the angle that the others start from (uniform, to a
microradian); its first episode is the paper's own. From a single start a chaotic policy would show a single draw.

`extrapolation`: a third of the plants leaves `wide` in M alone, a third in mu alone, a third in both. Outside means
lighter or heavier (down to 0.25 kg, up to 1.2 kg; uniform), smoother or rougher (down to 0.002, up to 0.6;
log-uniform), either side with equal chance; what stays inside is drawn as in `wide`. The lightest platform with the
roughest floor is far from Painleve's paradox ((M + m) / m = 2.81, the bound is 1.08).

`drift`: M and mu jump together at two times, the first drawn uniformly from the middle third of the episode's first
half (5.5 to 11 s), the second from that of its second half (22 to 27.5 s), so that no plant rules for less than 5.5 s.
Times are multiples of the agent's step.

`sticky` has floors on which the platform sticks for much of the time. Its plants, and those of `real` and `real-wide`,
follow a low-discrepancy sequence (Roberts's: multiples modulo 1 of the powers of 1 / phi, where phi^(d + 1) = phi + 1
for d numbers): the first few cover the ranges as all do. The disturbances are drawn from the plants' seeds.

Numbers are rounded (M to 0.1 g, mu to five digits). Every set has a random seed of its own; the plants' own seeds are
0, 1, ..

A set's hash (`EvaluationSet.hash`) is the sha256 of its name and plants as JSON with sorted keys and no white space:
the file's layout does not matter, every number does. It stands in every result and in leaderboard.json; results
compare only where it is the same. So a set does not change: another one gets another name. `nominal` alone has, once:
in 0.1.0 it was a single episode.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from baselines.archive import STICKY_GRID
from capsule_gym.command_line import parse
from capsule_gym.evaluation_sets import FURTHER_SET_NAMES, SET_NAMES, TASK_SET_NAMES, EvaluationSet, PlantSpec
from capsule_gym.files import write_atomically
from capsule_gym.parameters import CONSTANTS, NOMINAL, RANDOMIZATIONS, Capsule, Disturbances, Randomization, find_task
from capsule_gym.task import CONTROL_DT, HORIZON, START_THETA

PROG = "python -m agents.evaluation.sets"
SETS_FOLDER = Path(__file__).with_name("frozen")
EPISODES = 100
# Of the other tasks and on sticky floors, where failures are rare.
MANY_EPISODES = 1000
# Half the width of the angles that `nominal` starts from, rad.
STARTS = 0.1

_WIDE = RANDOMIZATIONS["wide"]
assert _WIDE.M is not None and _WIDE.mu is not None
LIGHTER, HEAVIER = (0.25, _WIDE.M[0]), (_WIDE.M[1], 1.2)
SMOOTHER, ROUGHER = (0.002, _WIDE.mu[0]), (_WIDE.mu[1], 0.6)
# Of the sets' own random streams. Frozen: a different set needs a different name.
SEEDS = {"nominal": 20180, "paper": 20181, "wide": 20182, "extrapolation": 20183, "drift": 20184}
TASK_SEEDS = {"goal": 20190, "velocity": 20191, "goal-paper": 20192}
CHANGE_WINDOWS = ((HORIZON / 6.0, HORIZON / 3.0), (HORIZON * 2.0 / 3.0, HORIZON * 5.0 / 6.0))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    # Imported here, as in other functions: it imports numba, which takes most of a second.
    from capsule_gym.elementary import exp, log

    return float(low * exp(float(rng.random()) * log(high / low)))


def _sample(rng: np.random.Generator, randomization: str | Randomization) -> tuple[float, float]:
    """M and mu from one of the environment's own distributions, rounded."""
    from capsule_gym.resets import draw_plant

    M, mu = draw_plant(Randomization.named(randomization), NOMINAL, rng)
    return round(M, 4), float(f"{mu:.5g}")


def _sample_plant(name: str, rng: np.random.Generator, seed: int) -> PlantSpec:
    """The next episode of a frozen set."""
    if name == "nominal":
        theta = round(START_THETA + rng.uniform(-STARTS, STARTS), 6) if seed else START_THETA
        return PlantSpec(NOMINAL.M, NOMINAL.mu, seed, theta=theta)
    M, mu = _sample(rng, "paper" if name == "paper" else "wide")
    changes = []
    if name == "extrapolation":
        if seed % 3 != 1:
            M = round(rng.uniform(*(LIGHTER if rng.random() < 0.5 else HEAVIER)), 4)
        if seed % 3 != 0:
            mu = float(f"{_log_uniform(rng, *(SMOOTHER if rng.random() < 0.5 else ROUGHER)):.5g}")
    if name == "drift":
        for window in CHANGE_WINDOWS:
            t = round(round(rng.uniform(*window) / CONTROL_DT) * CONTROL_DT, 6)
            changes.append(dict(zip(("t", "M", "mu"), (t, *_sample(rng, "wide")), strict=True)))
    return PlantSpec(M, mu, seed, tuple(changes))


def draw_set(name: str) -> EvaluationSet:
    """Draws a frozen set anew, from its fixed seed.

    Args:
        name: that of the set.
    """
    if name in TASK_SET_NAMES:
        return _draw_task_set(name)
    if name in FURTHER_SET_NAMES:
        return _spread_set(name)
    rng = np.random.default_rng(SEEDS[name])
    return EvaluationSet(name, tuple(_sample_plant(name, rng, seed) for seed in range(EPISODES)))


def _draw_task_set(name: str) -> EvaluationSet:
    """The frozen set of another task than speed."""
    task_name, _, floor = name.partition("-")
    task, rng = find_task(task_name), np.random.default_rng(TASK_SEEDS[name])
    plants = []
    for seed in range(MANY_EPISODES):
        M, mu = _sample(rng, floor or task.defaults["randomization"])
        goal = None
        if task_name == "goal":
            (draw,) = task.draws
            distance = round(rng.uniform(draw.low, draw.high), 4)
            goal = distance if rng.random() < 0.5 else -distance
        plants.append(PlantSpec(M, mu, seed, goal=goal))
    return EvaluationSet(name, tuple(plants), task_name, NOMINAL if floor else None)


def _constants_at(randomization: Randomization, shares: Sequence[float]) -> dict[str, float]:
    """What a plant has of the constants that are drawn, at these shares of their ranges."""
    ranges = {constant: getattr(randomization, constant) for constant in randomization.drawn}
    return {n: low + (high - low) * share for (n, (low, high)), share in zip(ranges.items(), shares, strict=True)}


def _spread_set(name: str) -> EvaluationSet:
    """A set whose plants are spread evenly over the randomisation of its name."""
    from capsule_gym.resets import plant_at, plant_ranges

    capsule, disturbances = (STICKY_GRID.capsule, "none") if name == "sticky" else (None, "real")
    randomization = Randomization.named(name)
    ranges, plants = plant_ranges(randomization, capsule or NOMINAL), []
    count = 2 + len(randomization.drawn)
    phi = 2.0
    for _ in range(100):
        phi = (1.0 + phi) ** (1.0 / (count + 1))
    for seed in range(MANY_EPISODES):
        shares = [(0.5 + seed / phi ** (n + 1)) % 1.0 for n in range(count)]
        M, mu = plant_at(ranges, *shares[:2])
        own = _constants_at(randomization, shares[2:])
        own = {constant: float(f"{value:.5g}") for constant, value in own.items()}
        plants.append(PlantSpec(round(M, 4), float(f"{mu:.5g}"), seed, capsule=own or None))
    return EvaluationSet(name, tuple(plants), capsule=capsule, disturbances=disturbances)


def validation_set(
    randomization: str | Randomization,
    name: str,
    first_seed: int,
    count: int,
    capsule: Capsule | None = None,
    task: str = "speed",
    disturbances: str | Disturbances = "none",
) -> EvaluationSet:
    """A set of plants that are drawn as the environment draws those of its episodes, for choices and studies.

    Args:
        randomization: of the environment.
        name: of the set.
        first_seed: the episodes' seeds are this and those that follow; far from 0, 1, .., which the frozen sets use.
        count: how many.
        capsule: of the environment.
        task: of the environment; what its episodes draw besides follows from their seeds.
        disturbances: of the environment.
    """
    from capsule_gym.resets import Stream, draw_plant, random_stream

    drawn, plants = Randomization.named(randomization), []
    for seed in range(first_seed, first_seed + count):
        M, mu = draw_plant(drawn, NOMINAL, random_stream(seed, 0, Stream.parameters))
        shares = random_stream(seed, 0, Stream.variation).random(len(CONSTANTS)).tolist()
        own = _constants_at(drawn, [shares[CONSTANTS.index(constant)] for constant in drawn.drawn])
        plants.append(PlantSpec(M, mu, seed, capsule=own or None))
    return EvaluationSet(name, tuple(plants), task, capsule, disturbances)


@dataclass(frozen=True)
class Args:
    """Draws the frozen evaluation sets from their fixed seeds and writes agents/evaluation/frozen/*.json.

    Examples:
      python -m agents.evaluation.sets
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parse(Args, PROG, arguments)
    for name in (*SET_NAMES, *FURTHER_SET_NAMES, *TASK_SET_NAMES):
        found = draw_set(name)
        write_atomically(SETS_FOLDER / f"{name}.json", found.to_json())
        print(f"{name}: {len(found.plants)} episodes, {found.hash[:12]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
