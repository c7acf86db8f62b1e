"""Loads trained policies by name or path, without torch and without unpickling."""

import json
import os
from functools import lru_cache
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from capsule_gym.checks import nearest, require, short_repr, shortened
from capsule_gym.control.lookup import is_own
from capsule_gym.policies.network import Cell
from capsule_gym.policies.policy import (
    FORMAT,
    FORMAT_VERSION,
    MOST_LAYERS,
    POLICY,
    RECURRENT_VERSION,
    TEXTS,
    VALUES,
    Policy,
)

# The policies that come with the package.
FOLDER = Path(__file__).parents[1] / "data" / "policies"
# The first bytes of an archive.
ZIP = b"PK\3\4"
# Largest file that is read, bytes: larger than any policy within the limits, many times larger than
# usual.
LARGEST_FILE = 32 * 2**20


def policy_names(*, seeds: bool = False) -> list[str]:
    """The names of the policies that come with the package.

    Args:
        seeds: give the names of all their training runs instead, such as "residual-ppo/seed-2".
    """
    return [name for name in pretrained() if ("/" in name) is seeds]


@lru_cache(maxsize=1)
def pretrained() -> dict[str, Path]:
    """The files of the policies that come with the package, by name.

    Every run has a name; the plain name means the first run.
    """

    def row_and_seed(file: Path) -> tuple[str, int]:
        row, run = file.parts[-3:-1]
        return row, int(run.removeprefix("seed-"))

    found: dict[str, Path] = {}
    for file in sorted(FOLDER.glob(f"*/seed-*/{POLICY}"), key=row_and_seed):
        row, run = file.parts[-3:-1]
        found.setdefault(row, file)
        found[f"{row}/{run}"] = file
    return found


def _law_named(name: str) -> str:
    """The end of the message for the name of a control law, or an empty string."""
    from capsule_gym.control.laws import LAWS

    law = name.replace("-", "_")
    if law not in LAWS:
        return ""
    return f", which is a control law: gym.make(.., controller='baselines:{law}')"


def load_policy(name_or_path: str | os.PathLike[str], *, trust_controller: bool = False) -> Policy:
    """Loads a trained policy.

    A policy file contains no pickled objects and no code.

    Args:
        name_or_path: a name of `policy_names()`, which is the training run with the lowest seed;
            one run, such as "residual-ppo/seed-2"; the path of a policy file; or the folder of a
            training run, whose best policy is loaded.
        trust_controller: accept a policy with a control law outside this package. The environment
            imports the law, which runs its code.

    Raises:
        TypeError: if `name_or_path` is neither a string nor a path.
        ValueError: if there is no such policy, the file is corrupt, or it names a law that is not
            trusted.
    """
    named = isinstance(name_or_path, (str, os.PathLike))
    require(named, "name_or_path", "a policy's name or a path", name_or_path, TypeError)
    name = str(name_or_path)
    path = pretrained().get(name) if isinstance(name_or_path, str) else None
    if path is None:
        path = _find_file(name_or_path)
        folder = path.absolute().parent
        if folder.name == "best":
            folder = folder.parent
        # As `policy_names` names a row's run.
        name = "/".join(folder.parts[-2:]) if folder.name.startswith("seed-") else folder.name
        if path.name != POLICY:
            name = path.stem
    size = path.stat().st_size
    if size > LARGEST_FILE:
        limit = f"it must have at most {LARGEST_FILE} bytes, got {size}"
        raise ValueError(f"{path} is not a policy file: {limit}")
    refuse_archive(path)
    try:
        policy = _read(name, path)
    except (SafetensorError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise ValueError(f"{path} is not a policy file: {shortened(str(error))}") from error
    controller = policy.env_kwargs.get("controller")
    if not (trust_controller or is_own(controller)):
        raise ValueError(
            f"{path} names the control law {short_repr(controller)}, which does not come with this "
            "package; an environment made with it runs that code: "
            "load_policy(.., trust_controller=True) if you trust it"
        )
    return policy


def refuse_archive(path: str | os.PathLike[str]) -> None:
    """Raises a ValueError that says how to convert a file which is an archive."""
    with open(path, "rb") as file:
        if file.read(len(ZIP)) == ZIP:
            raise ValueError(
                f"{path} is no policy file, but an archive such as Stable-Baselines3's: "
                "Policy.from_sb3(PPO.load(..), env).save(..), with the agent's class and its "
                "environment, makes a policy file of it"
            )


def _find_file(given: str | os.PathLike[str]) -> Path:
    """The policy file with this path, or the best one in the run's folder with this path."""
    path = Path(given)
    # Unlike the methods of Path, these functions accept names that no file can have.
    if os.path.isdir(path):
        files = (path / "best" / POLICY, path / POLICY)
        path = next(filter(Path.is_file, files), path)
    if not os.path.isfile(path):
        name = str(given)
        hint = _law_named(name) or nearest(name, pretrained())
        raise ValueError(
            f"name_or_path must be one of {', '.join(policy_names())}, one run of it as "
            "NAME/seed-0, or the path of a policy file or of a run's folder, which holds "
            f"best/{POLICY} or {POLICY}, got {short_repr(name)}{hint}"
        )
    return path


def _layer_names(part: str, names: set[str]) -> list[tuple[str, str]]:
    """The names of the weights and biases of a part's layers, as many as there are weights."""
    count = sum(name.startswith(f"{part}.") and name.endswith(".weight") for name in names)
    count = min(count, MOST_LAYERS + 1)
    return [(f"{part}.{n}.weight", f"{part}.{n}.bias") for n in range(count)]


def _read(name: str, path: Path) -> Policy:
    """The policy in a file that is not too large."""
    with safe_open(path, framework="numpy") as file:
        metadata: dict[str, str] = file.metadata() or {}
        known = [(FORMAT, FORMAT_VERSION), (FORMAT, RECURRENT_VERSION)]
        found = (metadata.get("format"), metadata.get("format_version"))
        require(found in known, "its format and format_version", f"one of {known}", found)
        # Inputs and outputs that no policy has any more.
        former = {"output": "action", "told_energy_weight": "false", "identifies": "false"}
        for key, only in former.items():
            given = metadata.get(key, only)
            require(given == only, key, f"{only!r} in its metadata", given)
        names = set(file.keys())
        layers = _layer_names("layers", names)
        head = _layer_names("head", names)
        cell = [f"cell.{each}" for each in Cell._fields] if found == known[1] else []
        expected = {"inputs.mean", "inputs.variance"}.union(*layers, *head, cell)
        if names != expected:
            wanted = f"it must contain the tensors {sorted(expected)}"
            raise ValueError(f"{wanted}, got {short_repr(sorted(names))}")
        arrays = {tensor: file.get_tensor(tensor) for tensor in names}
    values: dict[str, Any] = {}
    for key in (*TEXTS, *VALUES):
        try:
            values[key] = metadata[key] if key in TEXTS else json.loads(metadata[key])
        except (KeyError, ValueError):
            accepted = f"{'text' if key in TEXTS else 'JSON'} in its metadata"
            got = f"{metadata.get(key)!r:.50}"
            raise ValueError(f"{key} must be {accepted}, got {got}") from None
    return Policy(
        name=name,
        layers=tuple((arrays[weights], arrays[bias]) for weights, bias in layers),
        cell=Cell(*(arrays[tensor] for tensor in cell)) if cell else None,
        head=tuple((arrays[weights], arrays[bias]) for weights, bias in head),
        mean=arrays["inputs.mean"],
        variance=arrays["inputs.variance"],
        **values,
    )
