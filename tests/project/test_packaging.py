"""What is installed: every package by name, and the committed policies as data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from capsule_gym.evaluation_sets import SET_NAMES

tomllib = pytest.importorskip("tomllib", reason="from Python 3.11 on", exc_type=ImportError)

ROOT = Path(__file__).resolve().parents[2]
# Packages of data alone, which lie in other folders.
POLICIES, SETS = "capsule_gym.checkpoints", "capsule_gym.frozen"


@pytest.fixture(scope="module")
def setuptools() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]


def test_every_package_is_installed(setuptools):
    folders = [path.parent for top in ("capsule_gym", "baselines") for path in (ROOT / top).rglob("__init__.py")]
    names = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    assert {"capsule_gym", "baselines", "baselines.laws"} <= names
    assert sorted(setuptools["packages"]) == sorted({*names, POLICIES, SETS})


def test_the_committed_policies_are_installed(setuptools):
    folder = ROOT / setuptools["package-dir"][POLICIES]
    (pattern,) = setuptools["package-data"][POLICIES]
    installed = set(folder.glob(pattern))
    assert installed == set((ROOT / "agents" / "checkpoints").glob("*/seed-*/policy.safetensors"))
    assert len(installed) > 10


def test_the_frozen_sets_are_installed(setuptools):
    folder = ROOT / setuptools["package-dir"][SETS]
    (pattern,) = setuptools["package-data"][SETS]
    assert {path.stem for path in folder.glob(pattern)} == set(SET_NAMES)
