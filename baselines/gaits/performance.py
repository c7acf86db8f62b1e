"""Gaits being performed: the scripted policies `gait-nominal` and `gait-oracle`."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from baselines.gaits import FOLDER
from baselines.gaits.archive import Gait, known_gaits
from baselines.gaits.families import GAIT_DT, actions, pack
from capsule_gym.parameters import Capsule

Act = Callable[[np.ndarray], np.ndarray]


class Performance:
    """Gaits being performed: one per environment, changeable on the way, all on one clock.

    Args:
        gaits: one per environment.
    """

    def __init__(self, gaits: Sequence[Gait]) -> None:
        self.step = 0
        self.change(gaits)

    def change(self, gaits: Sequence[Gait]) -> None:
        """Goes on with other gaits, at the same time of the clock."""
        self._gaits = pack([gait.family for gait in gaits], [gait.parameters for gait in gaits])

    def act(self, observations: np.ndarray) -> np.ndarray:
        """The actions of this step, shape (n, 1), float32; counts the step."""
        out = actions(self._gaits, self.step * GAIT_DT, observations)
        self.step += 1
        return out


def tolerant_nominal() -> Gait:
    """The tolerant gait of the nominal plant; the fastest one fails where M is 5 % off."""
    nominal = Capsule()
    tolerant = [gait for gait in known_gaits().tolerant if (gait.M, gait.mu) == (nominal.M, nominal.mu)]
    return max(tolerant, key=lambda gait: gait.tolerance)


def start_nominal(seeds: Sequence[int]) -> Act:
    """The tolerant gait of the nominal plant, on every plant."""
    return Performance([tolerant_nominal()] * len(seeds)).act


@dataclass(frozen=True)
class Choice:
    """Which known gait to perform on which plant.

    Gaits of neighbouring plants can be different motions, and a mean of their parameters none at all; so the oracle
    does not interpolate but looks up the gait that proved fastest around the plant.

    Attributes:
        M: masses of the map's cells, kg, ascending.
        mu: friction coefficients of the map's cells, ascending.
        gaits: the gait of each cell, shape (len(M), len(mu)).
    """

    M: tuple[float, ...]
    mu: tuple[float, ...]
    gaits: tuple[tuple[Gait, ...], ...]

    def find(self, M: np.ndarray, mu: np.ndarray) -> list[Gait]:
        """The gaits of some plants: that of the nearest cell in M and log(mu), outside the map of its edge."""
        centres = np.array(self.M)
        rows = np.abs(M[:, None] - centres).argmin(axis=1)
        columns = np.searchsorted(self.edges(), mu * mu)
        return [self.gaits[i][j] for i, j in zip(rows, columns, strict=True)]

    def edges(self) -> np.ndarray:
        """The squares of mu between the cells: half-way in log(mu) is the square root of a product."""
        return np.multiply(self.mu[:-1], self.mu[1:])

    def used(self) -> tuple[list[Gait], list[list[int]]]:
        """The gaits, each once, and the place among them of every cell's."""
        used = list(dict.fromkeys(gait for row in self.gaits for gait in row))
        return used, [[used.index(gait) for gait in row] for row in self.gaits]

    def to_json(self) -> str:
        """The text of the file: gaits are named by family, plant and whether they are tolerant."""
        used, places = self.used()
        gaits = [[gait.family, gait.M, gait.mu, gait.worst_speed is not None] for gait in used]
        return json.dumps({"M": self.M, "mu": self.mu, "gaits": gaits, "choice": places}) + "\n"


@lru_cache(maxsize=1)
def known_choice() -> Choice:
    """The committed map of the oracle, read once.

    Raises:
        ValueError: if the map is malformed or names a gait that does not exist.
    """
    path = FOLDER / "oracle.json"
    gaits = {(gait.family, gait.M, gait.mu, gait.worst_speed is not None): gait for gait in known_gaits().library()}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        used = [gaits[family, M, mu, tolerant] for family, M, mu, tolerant in content["gaits"]]
        rows = tuple(tuple(used[index] for index in row) for row in content["choice"])
        return Choice(tuple(content["M"]), tuple(content["mu"]), rows)
    except (KeyError, TypeError, ValueError, IndexError, FileNotFoundError) as error:
        raise ValueError(
            f"{path} must be what `python -m baselines.gaits --oracle` writes, got {type(error).__name__}: {error}"
        ) from error


def start_oracle(seeds: Sequence[int]) -> Act:
    """For every plant the gait that proved fastest around it; M and mu are the last two observations."""
    choice = known_choice()
    seen = np.zeros((len(seeds), 2), np.float32)
    performance = Performance([choice.gaits[0][0]] * len(seeds))

    def act(observations: np.ndarray) -> np.ndarray:
        plants = observations[:, -2:]
        # On most steps no plant has changed, and the search for its gait is spared.
        if not np.array_equal(plants, seen):
            seen[:] = plants
            performance.change(choice.find(plants[:, 0].astype(np.float64), plants[:, 1].astype(np.float64)))
        return performance.act(observations)

    return act
