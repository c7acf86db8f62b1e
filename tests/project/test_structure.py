import dataclasses
import importlib
import pkgutil
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from types import ModuleType

import pytest

from capsule_gym.control.lookup import find_controller
from capsule_gym.evaluation.episodes import evaluate
from capsule_gym.evaluation.sets import NOMINAL_PLANT, EvaluationSet
from tests.project.test_pages import MODULES, ROOT

PACKAGES = ("capsule_gym", "baselines", "agents", "benchmarks", "web", "examples")
# What imports a module by a name that is computed.
IMPORTING = ("import_module", "resolve_name", "__import__", "entry_points")
# Paths from the project's folder; texts of `capsule_gym` name its core without that.
PATHS = re.compile(
    r"(?<![\w./*+-])(?:agents|baselines|benchmarks|capsule_gym|core|examples|tests|web)(?:/[\w.-]*\w)+"
)
FORMER_PATH = re.compile(r"`[^`]+` of revision")
# Names under which the documentation has shown objects, and where they are.
FORMER_NAMES = {
    "baselines.adaptive": "capsule_gym.control.laws.adaptive:adaptive",
    "baselines.dynamic_programming.archive:optimal_speed": "capsule_gym.evaluation.optimum:optimal_speed",
    "baselines.evaluation.episodes:validation_set": "capsule_gym.evaluation.episodes:validation_set",
    "baselines.evaluation.policies:wrap_policy": "capsule_gym.evaluation.candidates:wrap_policy",
    "baselines.laws:find_law": "capsule_gym.control.laws:find_law",
    "capsule_gym.controller:find_controller": "capsule_gym.control.lookup:find_controller",
    "capsule_gym.elementary:sincos": "capsule_gym.core.elementary:sincos",
    "capsule_gym.evaluation_sets:load_set": "capsule_gym.evaluation.sets:load_set",
    "capsule_gym.network:rollout": "capsule_gym.policies.rollout:rollout",
    "capsule_gym.parameters:REAL": "capsule_gym.parameters.disturbances:REAL",
    "capsule_gym.sb3:AsymmetricPolicy": "capsule_gym.envs.sb3:AsymmetricPolicy",
    "capsule_gym.task:METRICS": "capsule_gym.tasks.task:METRICS",
}


def test_another_package_named_baselines_does_not_hide_the_laws(monkeypatch):
    """OpenAI Baselines has the same name, and both may be installed in one environment."""
    monkeypatch.setitem(sys.modules, "baselines", ModuleType("baselines"))
    assert find_controller("baselines:adaptive").name == "adaptive"
    (episode,) = evaluate("adaptive", EvaluationSet("one", (NOMINAL_PLANT,)), horizon=0.1)
    assert episode["duration"] == pytest.approx(0.1)


@pytest.mark.parametrize(("former", "found"), FORMER_NAMES.items())
def test_names_of_the_documentation_stay(former, found):
    assert pkgutil.resolve_name(former) is pkgutil.resolve_name(found)


def test_no_module_imports_one_that_imports_it():
    """Also in functions and for types; import-linter checks the order of the layers."""
    graph = pytest.importorskip("grimp").build_graph(*PACKAGES, cache_dir=None)
    order = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    TopologicalSorter(order).prepare()  # raises an error that names a circle


def test_no_module_is_imported_by_its_name_unless_the_user_gives_it():
    """Static checks of imports do not see these."""
    found = set()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            found |= {
                (path.relative_to(ROOT).as_posix(), name)
                for name in IMPORTING
                if f"{name}(" in text
            }
    assert found == {
        ("capsule_gym/control/lookup.py", "resolve_name"),  # the argument `controller`
        (
            "capsule_gym/evaluation/candidates.py",
            "resolve_name",
        ),  # `python -m agents.evaluate module:attribute`
        ("agents/training/algorithms.py", "resolve_name"),  # `train.py --wrapper module:attribute`
        (
            "capsule_gym/policies/scripted.py",
            "entry_points",
        ),  # policies of the distributions that the user has installed
    }


def test_settings_and_results_cannot_be_changed():
    """Copies, caches and threads share them."""
    # `backend` needs scikit-build-core, which only the build of a wheel has.
    names = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in MODULES
        if path.name != "backend.py"
    ]
    values = [each for name in names for each in vars(importlib.import_module(name)).values()]
    found = [
        each
        for each in values
        if dataclasses.is_dataclass(each) and getattr(each, "__module__", "") in names
    ]
    changing = {
        (each.__module__, each.__name__) for each in found if not each.__dataclass_params__.frozen
    }
    assert {name for _, name in changing} == {"Archive", "Progress", "ShootingProblem"} and len(
        changing
    ) == 3


def read_texts():
    """The content of every text file, by its path; fails if any file is large."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listing = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [path for name in listing.split("\0") if name and (path := ROOT / name).is_file()]
    assert [path for path in files if path.stat().st_size > 5_000_000] == []
    return {path: text for path in files if b"\0" not in (text := path.read_bytes())}


def test_no_tracked_file_is_large_or_names_a_path_of_a_machine():
    # The strings are joined here, so that this file does not contain them.
    paths = [("/work/" + "main").encode(), ("/ro" + "ot/").encode()]
    assert [
        str(path) for path, text in read_texts().items() if any(each in text for each in paths)
    ] == []


def test_paths_that_texts_name_exist():
    """Comments, docstrings and pages; the changelog names files of earlier versions, and NAME
    stands for several."""
    texts = {
        path: text.decode() for path, text in read_texts().items() if path.name != "CHANGELOG.md"
    }
    named = {
        (path, each)
        for path, text in texts.items()
        for each in PATHS.findall(FORMER_PATH.sub("", text))
    }
    named = {(str(path), each) for path, each in named if "NAME" not in each}
    assert {
        each
        for each in named
        if not any((root / each[1]).exists() for root in (ROOT, ROOT / "capsule_gym"))
    } == set()
