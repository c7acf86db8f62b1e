"""The frozen evaluation sets: the plants that every policy is judged on, the same for all, and their hashes.

`python -m agents.evaluation.sets` draws them anew and writes agents/evaluation/frozen/*.json; with --check it fails
where a file differs from its draw.

| set | episodes | platform mass M and friction coefficient mu |
|---|---|---|
| `nominal` | 100 | the paper's plant, from 100 angles |
| `paper` | 100 | drawn as by `randomization="paper"` |
| `wide` | 100 | drawn as by `randomization="wide"` |
| `extrapolation` | 100 | outside `wide` in M, in mu or in both |
| `drift` | 100 | drawn three times as in `wide` |

`nominal` starts at rest as all do, but within 0.1 rad of the angle that the others start from (uniform, to a
microradian); its first episode is the paper's own. From a single start a chaotic policy would show a single draw.

`extrapolation`: a third of the plants leaves `wide` in M alone, a third in mu alone, a third in both. Outside means
lighter or heavier (down to 0.25 kg, up to 1.2 kg; uniform), smoother or rougher (down to 0.002, up to 0.6;
log-uniform), either side with equal chance; what stays inside is drawn as in `wide`. The lightest platform with the
roughest floor is far from Painleve's paradox ((M + m) / m = 2.81, the bound is 1.08).

`drift`: M and mu jump together at two times, the first drawn uniformly from the middle third of the episode's first
half (5.5 to 11 s), the second from that of its second half (22 to 27.5 s), so that no plant rules for less than 5.5 s.
Times are multiples of the agent's step.

Numbers are rounded (M to 0.1 g, mu to five digits). Every set has a random seed of its own; the plants' own seeds are
0, 1, ..

A set's hash (`EvaluationSet.hash`) is the sha256 of its name and plants as JSON with sorted keys and no white space:
the file's layout does not matter, every number does. It stands in every result and in leaderboard.json; results
compare only where it is the same. So a set does not change: another one gets another name. `nominal` alone has, once:
in 0.1.0 it was a single episode.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from capsule_gym.command_line import parse
from capsule_gym.evaluation_sets import NOMINAL_PLANT, SET_NAMES, Change, EvaluationSet, PlantSpec
from capsule_gym.files import write_atomically
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS, Randomization
from capsule_gym.task import CONTROL_DT, HORIZON, START_THETA

PROG = "python -m agents.evaluation.sets"
SETS_FOLDER = Path(__file__).with_name("frozen")
EPISODES = 100
# Half the width of the angles that `nominal` starts from, rad.
STARTS = 0.1

_WIDE = RANDOMIZATIONS["wide"]
assert _WIDE.M is not None and _WIDE.mu is not None
LIGHTER, HEAVIER = (0.25, _WIDE.M[0]), (_WIDE.M[1], 1.2)
SMOOTHER, ROUGHER = (0.002, _WIDE.mu[0]), (_WIDE.mu[1], 0.6)
CHANGE_WINDOWS = ((HORIZON / 6.0, HORIZON / 3.0), (HORIZON * 2.0 / 3.0, HORIZON * 5.0 / 6.0))


def _rounded_mass(M: float) -> float:
    return round(M, 4)


def _rounded_friction(mu: float) -> float:
    return float(f"{mu:.5g}")


def _uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return low + (high - low) * float(rng.random())


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    # Here, as in `validation_set`, since numba comes with it, which takes most of a second to import.
    from capsule_gym.elementary import exp, log

    return float(low * exp(float(rng.random()) * log(high / low)))


def _drawn(rng: np.random.Generator, randomization: str) -> tuple[float, float]:
    """M and mu from one of the environment's own ranges."""
    # Like the other local imports here: numba comes with it.
    from capsule_gym.resets import draw_plant

    M, mu = draw_plant(RANDOMIZATIONS[randomization], NOMINAL, rng)
    return _rounded_mass(M), _rounded_friction(mu)


def _nominal(rng: np.random.Generator) -> list[PlantSpec]:
    starts = [round(START_THETA + _uniform(rng, -STARTS, STARTS), 6) for _ in range(EPISODES - 1)]
    rest = [replace(NOMINAL_PLANT, seed=seed, theta=theta) for seed, theta in enumerate(starts, start=1)]
    return [NOMINAL_PLANT, *rest]


def _paper(rng: np.random.Generator) -> list[PlantSpec]:
    return [PlantSpec(*_drawn(rng, "paper"), seed) for seed in range(EPISODES)]


def _wide(rng: np.random.Generator) -> list[PlantSpec]:
    return [PlantSpec(*_drawn(rng, "wide"), seed) for seed in range(EPISODES)]


def _extrapolation(rng: np.random.Generator) -> list[PlantSpec]:
    plants = []
    for seed in range(EPISODES):
        M, mu = _drawn(rng, "wide")
        if seed % 3 != 1:
            M = _rounded_mass(_uniform(rng, *(LIGHTER if rng.random() < 0.5 else HEAVIER)))
        if seed % 3 != 0:
            mu = _rounded_friction(_log_uniform(rng, *(SMOOTHER if rng.random() < 0.5 else ROUGHER)))
        plants.append(PlantSpec(M, mu, seed))
    return plants


def _drift(rng: np.random.Generator) -> list[PlantSpec]:
    plants = []
    for seed in range(EPISODES):
        M, mu = _drawn(rng, "wide")
        changes = []
        for window in CHANGE_WINDOWS:
            t = round(round(_uniform(rng, *window) / CONTROL_DT) * CONTROL_DT, 6)
            changes.append(Change(t, *_drawn(rng, "wide")))
        plants.append(PlantSpec(M, mu, seed, tuple(changes)))
    return plants


# Name -> (the seed of the set's own stream, how it is drawn). Frozen: a different set needs a different name.
_DRAWS: dict[str, tuple[int, Callable[[np.random.Generator], list[PlantSpec]]]] = {
    "nominal": (20180, _nominal),
    "paper": (20181, _paper),
    "wide": (20182, _wide),
    "extrapolation": (20183, _extrapolation),
    "drift": (20184, _drift),
}
assert tuple(_DRAWS) == SET_NAMES


def draw_set(name: str) -> EvaluationSet:
    """Draws a frozen set anew, from its fixed seed.

    Args:
        name: one of `SET_NAMES`.
    """
    seed, draw = _DRAWS[name]
    return EvaluationSet(name, tuple(draw(np.random.default_rng(seed))))


def validation_set(randomization: str, name: str, first_seed: int, count: int) -> EvaluationSet:
    """A set of plants that are drawn as the environment draws those of its episodes, for choices and studies.

    Args:
        randomization: of the environment.
        name: of the set.
        first_seed: the episodes' seeds are this and those that follow; far from 0, 1, .., which the frozen sets use.
        count: how many.
    """
    from capsule_gym.resets import Stream, draw_plant, random_stream

    drawn = Randomization.named(randomization)
    seeds = range(first_seed, first_seed + count)
    plants = [PlantSpec(*draw_plant(drawn, NOMINAL, random_stream(seed, 0, Stream.parameters)), seed) for seed in seeds]
    return EvaluationSet(name, tuple(plants))


def stale_sets(folder: Path = SETS_FOLDER) -> list[str]:
    """What in the folder differs from a new draw, one line each."""
    stale = []
    for name in SET_NAMES:
        path = folder / f"{name}.json"
        if not path.is_file():
            stale.append(f"{path} is missing")
        elif path.read_text(encoding="utf-8") != draw_set(name).to_json():
            stale.append(f"{path} differs from its draw")
    return stale


@dataclass(frozen=True)
class Options:
    """Draws the frozen evaluation sets from their fixed seeds and writes agents/evaluation/frozen/*.json.

    Examples:
      python -m agents.evaluation.sets
      python -m agents.evaluation.sets --check
    """

    check: bool = False
    """Write nothing; fail where a file differs from its draw."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    if parse(Options, PROG, arguments).check:
        stale = stale_sets()
        print("\n".join(stale) or "The evaluation sets are what their seeds give.")
        return 1 if stale else 0
    SETS_FOLDER.mkdir(exist_ok=True)
    for name in SET_NAMES:
        write_atomically(SETS_FOLDER / f"{name}.json", draw_set(name).to_json())
        print(f"{name}: {len(draw_set(name).plants)} episodes, {draw_set(name).hash[:12]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
