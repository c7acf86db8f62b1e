"""The frozen evaluation sets, which docs/evaluation.md lists: the same plants for the evaluation of every policy.

`python -m agents.evaluation.sets` draws them anew and writes agents/evaluation/frozen/*.json.

Episodes start at rest. The angles of `nominal` are uniform within 0.1 rad of the default start, the first episode has
the paper's start: a single start would show a single sample of a policy that is sensitive to perturbations.

`extrapolation`: a third of the plants leaves `wide` in M alone, a third in mu alone, a third in both. Outside means
lighter or heavier (down to 0.25 kg, up to 1.2 kg; uniform), smoother or rougher (down to 0.002, up to 0.6;
log-uniform), each side for half of the plants. The lightest platform with the roughest floor is far from Painleve's
paradox ((M + m) / m = 2.81, the bound is 1.08).

`drift`: M and mu jump together at two times, the first in the middle third of the episode's first half (5.5 to 11 s),
the second in the middle third of its second half (22 to 27.5 s), at multiples of the agent's step.

The plants of the speed task follow a low-discrepancy sequence (Roberts's: multiples modulo 1 of the powers of 1 / phi,
where phi^(d + 1) = phi + 1 for d numbers). A mean over such a set is closer to the mean over the distribution than a
mean over random plants, and the first few plants already cover the ranges.

A set's hash (`EvaluationSet.hash`) is the sha256 of its name and plants as JSON with sorted keys and no white space.
Every result and leaderboard.json contain it; results are comparable only if the hashes agree. A released set therefore
never changes: a different set gets a different name.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from baselines.dynamic_programming.problem import STICKY_GRID
from capsule_gym.command_line import command
from capsule_gym.config import find_task
from capsule_gym.evaluation_sets import FURTHER_SET_NAMES, SET_NAMES, TASK_SET_NAMES, EvaluationSet, PlantSpec
from capsule_gym.files import write_atomically
from capsule_gym.parameters import CONSTANTS, NOMINAL, RANDOMIZATIONS, Capsule, Disturbances, Randomization
from capsule_gym.resets import Stream, draw_plant, plant_at, plant_ranges, random_stream
from capsule_gym.task import CONTROL_DT, HORIZON, START_THETA

SETS_FOLDER = Path(__file__).with_name("frozen")
# Episodes per set; more on sticky floors, under disturbances and in the other tasks, where failures are rare.
EPISODES = (
    {name: 1000 for name in (*FURTHER_SET_NAMES, *TASK_SET_NAMES)} | dict.fromkeys(SET_NAMES, 400) | {"nominal": 100}
)
# Half width of the range of start angles in `nominal`, rad.
STARTS = 0.1

_WIDE = RANDOMIZATIONS["wide"]
assert _WIDE.M is not None and _WIDE.mu is not None
LIGHTER, HEAVIER = (0.25, _WIDE.M[0]), (_WIDE.M[1], 1.2)
SMOOTHER, ROUGHER = (0.002, _WIDE.mu[0]), (_WIDE.mu[1], 0.6)
# Seeds of the sets' random streams. Frozen: a different set needs a different name.
FURTHER_DRAWS = {"sticky-2": 32_000_000, "sticky-3": 33_000_000}
SEEDS = {"nominal": 20180, "goal": 20190, "velocity": 20191, "goal-paper": 20192}
CHANGE_WINDOWS = ((HORIZON / 6.0, HORIZON / 3.0), (HORIZON * 2.0 / 3.0, HORIZON * 5.0 / 6.0))


def _rounded(M: float, mu: float) -> tuple[float, float]:
    return round(M, 4), float(f"{mu:.5g}")


def draw_set(name: str) -> EvaluationSet:
    """Draws a frozen set anew."""
    if name in TASK_SET_NAMES:
        return _draw_task_set(name)
    if name in FURTHER_DRAWS:
        return validation_set("sticky", name, FURTHER_DRAWS[name], EPISODES["sticky"], STICKY_GRID.capsule)
    if name != "nominal":
        return _spread_set(name)
    rng = np.random.default_rng(SEEDS[name])
    thetas = [START_THETA, *(round(START_THETA + rng.uniform(-STARTS, STARTS), 6) for _ in range(1, EPISODES[name]))]
    return EvaluationSet(
        name, tuple(PlantSpec(NOMINAL.M, NOMINAL.mu, n, theta=theta) for n, theta in enumerate(thetas))
    )


def _draw_task_set(name: str) -> EvaluationSet:
    """Draws the frozen set of another task than speed."""
    task_name, _, floor = name.partition("-")
    task, rng = find_task(task_name), np.random.default_rng(SEEDS[name])
    plants = []
    for seed in range(EPISODES[name]):
        plant = _rounded(*draw_plant(Randomization.named(floor or task.defaults["randomization"]), NOMINAL, rng))
        goal = None
        if task_name == "goal":
            (draw,) = task.draws
            distance = round(rng.uniform(draw.low, draw.high), 4)
            goal = distance if rng.random() < 0.5 else -distance
        plants.append(PlantSpec(*plant, seed, goal=goal))
    return EvaluationSet(name, tuple(plants), task_name, NOMINAL if floor else None)


def _constants_at(randomization: Randomization, shares: Sequence[float]) -> dict[str, float]:
    """The values of a plant's drawn constants at the given fractions of their ranges."""
    ranges = {constant: getattr(randomization, constant) for constant in randomization.drawn}
    return {n: low + (high - low) * share for (n, (low, high)), share in zip(ranges.items(), shares, strict=True)}


def _spread_set(name: str) -> EvaluationSet:
    """Draws a set whose plants cover the randomisation of its name evenly, or the plants around and within `wide`."""
    capsule = STICKY_GRID.capsule if name == "sticky" else None
    disturbances = "real" if name in ("real", "real-wide") else "none"
    randomization = Randomization.named(name if name in RANDOMIZATIONS else "wide")
    ranges = plant_ranges(randomization, capsule or NOMINAL)
    count = {"extrapolation": 4, "drift": 8}.get(name, 2 + len(randomization.drawn))
    phi, plants = 2.0, []
    for _ in range(100):
        phi = (1.0 + phi) ** (1.0 / (count + 1))
    for seed in range(EPISODES[name]):
        shares = [(0.5 + seed / phi ** (n + 1)) % 1.0 for n in range(count)]
        if name == "extrapolation":
            plants.append(_plant_outside(ranges, shares, seed))
            continue
        M, mu = _rounded(*plant_at(ranges, *shares[:2]))
        own = _constants_at(randomization, [] if name == "drift" else shares[2:])
        own = {constant: float(f"{value:.5g}") for constant, value in own.items()}
        plants.append(
            PlantSpec(M, mu, seed, _changes_at(ranges, shares) if name == "drift" else (), capsule=own or None)
        )
    return EvaluationSet(name, tuple(plants), capsule=capsule, disturbances=disturbances)


def _plant_outside(ranges: np.ndarray, shares: Sequence[float], seed: int) -> PlantSpec:
    """A plant of `extrapolation`; the last two shares choose the sides."""
    M, mu = plant_at(ranges, *shares[:2])
    if seed % 3 != 1:
        low, high = LIGHTER if shares[2] < 0.5 else HEAVIER
        M = low + (high - low) * shares[0]
    if seed % 3 != 0:
        low, high = SMOOTHER if shares[3] < 0.5 else ROUGHER
        mu = low * (high / low) ** shares[1]
    return PlantSpec(*_rounded(M, mu), seed)


def _changes_at(ranges: np.ndarray, shares: Sequence[float]) -> tuple[dict[str, float], ...]:
    """The changes of a plant of `drift`; each uses three shares, after the two shares for M and mu at the start."""
    changes = []
    for n, (first, last) in enumerate(CHANGE_WINDOWS):
        t = round(round((first + (last - first) * shares[3 * n + 2]) / CONTROL_DT) * CONTROL_DT, 6)
        M, mu = _rounded(*plant_at(ranges, *shares[3 * n + 3 : 3 * n + 5]))
        changes.append({"t": t, "M": M, "mu": mu})
    return tuple(changes)


def validation_set(
    randomization: str | Randomization,
    name: str,
    first_seed: int,
    count: int,
    capsule: Capsule | None = None,
    task: str = "speed",
    disturbances: str | Disturbances = "none",
) -> EvaluationSet:
    """Draws a set of plants as the environment draws the plants of its episodes, for model selection and studies.

    Args:
        randomization: distribution of the environment's plants.
        name: name of the set.
        first_seed: seed of the first episode; the others follow. Far from 0, 1, .., the seeds of the frozen sets.
        count: number of plants.
        capsule: constants of the environment's plant.
        task: task of the environment; its further draws follow from the episodes' seeds.
        disturbances: disturbances of the environment.
    """
    drawn, plants = Randomization.named(randomization), []
    for seed in range(first_seed, first_seed + count):
        M, mu = draw_plant(drawn, NOMINAL, random_stream(seed, 0, Stream.parameters))
        shares = random_stream(seed, 0, Stream.variation).random(len(CONSTANTS)).tolist()
        own = _constants_at(drawn, [shares[CONSTANTS.index(constant)] for constant in drawn.drawn])
        plants.append(PlantSpec(M, mu, seed, capsule=own or None))
    return EvaluationSet(name, tuple(plants), task, capsule, disturbances)


@command("python -m agents.evaluation.sets")
def main() -> None:
    """Draws the frozen evaluation sets from their fixed seeds and writes agents/evaluation/frozen/*.json.

    Examples:
      python -m agents.evaluation.sets
    """
    for name in (*SET_NAMES, *FURTHER_SET_NAMES, *TASK_SET_NAMES, *FURTHER_DRAWS):
        found = draw_set(name)
        write_atomically(SETS_FOLDER / f"{name}.json", found.to_json())
        print(f"{name}: {len(found.plants)} episodes, {found.hash[:12]}")


if __name__ == "__main__":
    sys.exit(main())
