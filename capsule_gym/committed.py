"""What comes with the package and can drive, by name: without what it takes to load it."""

from __future__ import annotations

import re
from functools import lru_cache
from importlib import import_module
from pathlib import Path

POLICY = "policy.safetensors"
# Drives with no torque.
NOBODY = "zero"
SEED_FOLDER = re.compile(r"seed-([0-9]{1,18})")
# A wheel carries the committed policies in the package; in a checkout they lie with the training commands.
FOLDERS = (Path(__file__).with_name("checkpoints"), Path(__file__).parents[1] / "agents" / "checkpoints")


def policy_names(*, seeds: bool = False) -> list[str]:
    """The names of the policies that come with the package.

    Args:
        seeds: name every training run, as "residual-ppo/seed-2", in place of the policies that they are runs of.
    """
    return [name for name in committed() if ("/" in name) is seeds]


@lru_cache(maxsize=1)
def committed() -> dict[str, Path]:
    """The files of the policies that come with the package: every run's, and under the plain name the first run's."""
    folder = next((folder for folder in FOLDERS if folder.is_dir()), FOLDERS[0])
    runs = [
        (file.parents[1].name, SEED_FOLDER.fullmatch(file.parent.name), file) for file in folder.glob(f"*/*/{POLICY}")
    ]
    found: dict[str, Path] = {}
    for name, seed, file in sorted((name, int(match[1]), file) for name, match, file in runs if match):
        found.setdefault(name, file)
        found[f"{name}/seed-{seed}"] = file
    return found


def law_names() -> list[str]:
    """The names of the control laws: the leaderboard's, and of a law that is not on it its own."""
    named: dict[str, str] = import_module("baselines.policies").LAWS
    return [*named, *(name for name in _own_names() if f"baselines:{name}" not in named.values())]


def find_law(name: str) -> str | None:
    """A control law as `controller` takes it, as "baselines:gait"; None where there is none of that name.

    Args:
        name: the leaderboard's, as "gait-guarded"; or its own, with or without its package, as "baselines:gait".
    """
    named: dict[str, str] = import_module("baselines.policies").LAWS
    own = name.removeprefix("baselines:").replace("-", "_")
    return named.get(name) or (f"baselines:{own}" if own in _own_names() else None)


def _own_names() -> list[str]:
    """The names of the control laws in Python."""
    return list(import_module("baselines").__all__)


def driver_names() -> list[str]:
    """Everything that drives by its name: no torque, the control laws, the trained policies."""
    return [NOBODY, *law_names(), *policy_names()]
