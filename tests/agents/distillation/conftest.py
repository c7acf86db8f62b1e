"""A student that is distilled in seconds, and its plants, which are solved once."""

import dataclasses
from functools import partial

import joblib
import pytest

from agents.distillation import plants
from agents.distillation.config import STUDENTS
from agents.distillation.plants import draw_groups, solve_groups

# Settings of both students.
TINY = {
    "groups": 4,
    "plants": {"wide": 1},
    "num_envs": 4,
    "steps": 40,
    "rounds": 3,
    "updates": 3,
    "final_updates": 4,
    "final_parts": 2,
    "learning_rate": 1e-3,
    "validation": ("paper",),
    "evaluation_episodes": 2,
}
RECURRENT = dataclasses.replace(
    STUDENTS["dp-distilled"], **TINY, units=8, batch_size=6, sequence=20, burn_in=5
)
FEEDFORWARD = dataclasses.replace(
    STUDENTS["dp-distilled-wide"], **TINY | {"plants": {"wide": 2}}, batch_size=16
)


@pytest.fixture(scope="package", autouse=True)
def _coarse_grids():
    """Plants are solved in this process on a coarse grid, which takes a hundredth of the time."""
    coarse = partial(plants.solve_near, shape=(13, 18, 7))
    with pytest.MonkeyPatch.context() as patch, joblib.parallel_config(backend="sequential"):
        patch.setattr(plants, "solve_near", coarse)
        yield


@pytest.fixture(scope="package")
def plants_folder(tmp_path_factory):
    """The folder with the solved plants of `RECURRENT`, which solving them has made."""
    folder = tmp_path_factory.mktemp("runs") / "student" / "plants"
    solve_groups(draw_groups(RECURRENT), folder, jobs=1)
    return folder


@pytest.fixture(scope="package")
def solved(plants_folder):
    """The groups of `RECURRENT` and the solutions of their plants."""
    groups = draw_groups(RECURRENT)
    return groups, solve_groups(groups, plants_folder, jobs=1)


@pytest.fixture(scope="package")
def solved_nominal(tmp_path_factory):
    """The groups of `FEEDFORWARD` and the solutions of their plants."""
    groups = draw_groups(FEEDFORWARD)
    return groups, solve_groups(groups, tmp_path_factory.mktemp("nominal"), jobs=1)
