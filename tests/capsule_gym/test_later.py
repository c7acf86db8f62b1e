"""Names that a package imports when they are first asked for."""

from __future__ import annotations

import importlib
import sys

import pytest

import baselines
import baselines.optimum
import capsule_gym

INIT = """
from capsule_gym.later import later
early = 1
__getattr__, __dir__ = later(__name__, {"late": ".inner"})
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    folder = tmp_path / "lazily"
    folder.mkdir()
    (folder / "__init__.py").write_text(INIT)
    (folder / "inner.py").write_text("late = object()\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("lazily")
    for name in ("lazily", "lazily.inner"):
        sys.modules.pop(name, None)


def test_a_name_is_imported_when_it_is_asked_for_and_then_there(package):
    assert "lazily.inner" not in sys.modules and "late" not in vars(package)
    assert package.late is package.late is sys.modules["lazily.inner"].late
    assert vars(package)["late"] is package.late


def test_names_are_listed_before_they_are_imported(package):
    assert {"early", "late"} <= set(dir(package))
    assert "lazily.inner" not in sys.modules


def test_what_is_not_there_is_named(package):
    with pytest.raises(AttributeError, match="module 'lazily' has no attribute 'never'"):
        _ = package.never


@pytest.mark.parametrize("package", [capsule_gym, baselines, baselines.optimum], ids=lambda package: package.__name__)
def test_every_name_that_a_package_offers_is_there(package):
    assert set(package.__all__) <= set(dir(package))
    for name in package.__all__:
        getattr(package, name)
