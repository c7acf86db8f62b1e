import dataclasses
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from types import ModuleType

import pytest

import capsule_gym
from capsule_gym.control.lookup import find_controller
from capsule_gym.evaluation.episodes import evaluate
from capsule_gym.evaluation.sets import NOMINAL_PLANT, EvaluationSet
from tests import ROOT
from tests.project.test_pages import MODULES, find, module_name

PACKAGES = ("capsule_gym", "baselines", "agents", "benchmarks", "web", "examples")
# What imports a module by a name that is computed.
IMPORTING = ("import_module", "resolve_name", "__import__", "entry_points")
# Paths from the project's folder; texts of `capsule_gym` name its core without that.
PATHS = re.compile(
    r"(?<![\w./*+-])(?:agents|baselines|benchmarks|capsule_gym|core|examples|tests|web)(?:/[\w.-]*\w)+"
)
LARGEST_FILE = 5_000_000  # bytes
FORMER_PATH = re.compile(r"`[^`]+` of revision")
# Names under which the documentation has shown objects, and where they are.
FORMER_NAMES = {
    "baselines.adaptive": "capsule_gym.control.laws.adaptive:adaptive",
    "baselines.dynamic_programming.archive:optimal_speed": (
        "capsule_gym.evaluation.optimum:optimal_speed"
    ),
    "baselines.evaluation.episodes:validation_set": (
        "capsule_gym.evaluation.episodes:validation_set"
    ),
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


def test_the_package_shows_only_its_public_names_of_the_evaluation():
    assert capsule_gym.evaluate is evaluate
    with pytest.raises(AttributeError, match="module 'capsule_gym' has no attribute 'failures'"):
        capsule_gym.failures  # noqa: B018


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
    for path in find(*(f"{package}/**/*.py" for package in PACKAGES)):
        text = path.read_text(encoding="utf-8")
        found |= {(module_name(path), name) for name in IMPORTING if f"{name}(" in text}
    assert found == {
        # The argument `controller`.
        ("capsule_gym.control.lookup", "resolve_name"),
        # `python -m agents.evaluate module:attribute`
        ("capsule_gym.evaluation.candidates", "resolve_name"),
        # `train.py --wrapper module:attribute`
        ("agents.training.algorithms", "resolve_name"),
        # Policies of the distributions that the user has installed.
        ("capsule_gym.policies.scripted", "entry_points"),
    }


def test_settings_and_results_cannot_be_changed():
    """Copies, caches and threads share them."""
    # `backend` needs scikit-build-core, which only the build of a wheel has.
    names = [module_name(path) for path in MODULES if path.name != "backend.py"]
    changing = []
    for name in names:
        for kind in vars(importlib.import_module(name)).values():
            own = inspect.isclass(kind) and kind.__module__ == name
            if own and dataclasses.is_dataclass(kind) and not kind.__dataclass_params__.frozen:
                changing.append(kind.__name__)
    assert sorted(changing) == ["Archive", "Progress", "ShootingProblem"]


def read_texts():
    """The content of every text file, by its path; fails if any file is large."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    paths = [ROOT / name for name in done.stdout.split("\0")]
    contents = {path: path.read_bytes() for path in paths if path.is_file()}
    assert [path for path, content in contents.items() if len(content) > LARGEST_FILE] == []
    return {path: content for path, content in contents.items() if b"\0" not in content}


def test_no_tracked_file_is_large_or_names_a_path_of_a_machine():
    # The strings are joined here, so that this file does not contain them.
    folders = [b"/work/" + b"main", b"/ro" + b"ot/"]
    for path, text in read_texts().items():
        assert [folder for folder in folders if folder in text] == [], path


def test_paths_that_texts_name_exist():
    """Comments, docstrings and pages; the changelog names files of earlier versions, and NAME
    stands for several."""
    for file, text in read_texts().items():
        if file.name == "CHANGELOG.md":
            continue
        for path in set(PATHS.findall(FORMER_PATH.sub("", text.decode()))):
            exists = (ROOT / path).exists() or (ROOT / "capsule_gym" / path).exists()
            assert exists or "NAME" in path, (file, path)
