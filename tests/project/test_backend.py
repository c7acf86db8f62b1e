import os
import runpy
import sys
import sysconfig
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from capsule_gym.core import _core
from tests.project.test_pages import ROOT

SET = ("CMAKE_ARGS", "CMAKE_GENERATOR", "ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")
KINDS = pytest.mark.parametrize("kind", ["wheel", "editable"])
NOT_ON_WINDOWS = pytest.mark.skipif(os.name == "nt", reason="on Windows only CXX names a compiler")


@pytest.fixture
def backend(monkeypatch):
    """The module, with hooks of scikit-build-core that return what a build needs or sees."""
    environment = {**os.environ}
    for name in ("CXX", *SET):
        environment.pop(name, None)
    monkeypatch.setattr(os, "umask", lambda mode: None)
    monkeypatch.setattr(os, "environ", environment)
    build = ModuleType("scikit_build_core.build")
    for kind in ("wheel", "editable"):
        setattr(build, f"get_requires_for_build_{kind}", lambda settings: [settings])
        setattr(build, f"build_{kind}", lambda folder, **given: (folder, given, {**os.environ}))
    monkeypatch.setitem(sys.modules, "scikit_build_core", SimpleNamespace(build=build))
    monkeypatch.setitem(sys.modules, "scikit_build_core.build", build)
    return SimpleNamespace(**runpy.run_path(str(ROOT / "capsule_gym" / "core" / "backend.py")))


@pytest.fixture
def programs(monkeypatch, tmp_path):
    """Writes programs into the only folder of PATH.

    Each ends with its status if it is given a source, else with an error.
    """
    monkeypatch.setenv("PATH", str(tmp_path))

    def write(statuses):
        for name, status in statuses.items():
            program = tmp_path / name
            program.write_text(f"#!/bin/sh\nread -r source && exit {status}\nexit 1\n")
            program.chmod(0o755)

    return write


def run_build(backend, kind):
    """The requirements of a build, and the environment that it sees."""
    needed = getattr(backend, f"get_requires_for_build_{kind}")("ninja")
    folder, given, seen = getattr(backend, f"build_{kind}")("here", settings=1)
    assert folder == "here"
    assert given == {"settings": 1}
    return needed, seen


@NOT_ON_WINDOWS
@KINDS
@pytest.mark.parametrize("named", [False, True])
def test_a_build_takes_the_compiler_that_it_finds(kind, named, backend, programs, monkeypatch):
    programs({"c++": 1})
    if named:
        monkeypatch.setenv("CXX", "named")
    else:
        programs({"g++": 0, "clang++": 0})
    needed, seen = run_build(backend, kind)
    assert needed == ["ninja"]
    assert seen["CXX"].endswith("named" if named else "g++")
    assert set(SET).isdisjoint(seen)


@NOT_ON_WINDOWS
@KINDS
def test_a_build_asks_for_zig_where_it_finds_no_compiler(kind, backend, programs):
    programs({"c++": 1})
    needed, seen = run_build(backend, kind)
    assert needed == ["ninja", backend.ZIG]
    assert "zig;cc" in seen["CMAKE_ARGS"]
    assert seen["CMAKE_GENERATOR"] == "Ninja"
    assert "CXX" not in seen
    cache = seen["ZIG_GLOBAL_CACHE_DIR"]
    assert seen["ZIG_LOCAL_CACHE_DIR"] == cache
    assert not os.path.exists(cache)


@pytest.mark.usefixtures("backend")
@pytest.mark.parametrize(
    ("module", "error"), [("backend.py", SystemExit), ("__init__.py", ImportError)]
)
def test_a_free_threaded_python_is_refused(module, error, monkeypatch):
    monkeypatch.setattr(sysconfig, "get_config_var", {"Py_GIL_DISABLED": 1}.get)
    with pytest.raises(error, match="needs CPython with its global lock"):
        runpy.run_path(str(ROOT / "capsule_gym" / "core" / module))


@pytest.mark.parametrize(
    ("url", "links", "urls"),
    [
        ("", " c", {}),
        (
            "https://x/",
            "![a](https://x/blob/v1/b.png?raw=true) [c](https://x/blob/v1/d.md)",
            {
                "Repository": "https://x",
                "Issues": "https://x/issues",
                "Changelog": "https://x/blob/v1/CHANGELOG.md",
            },
        ),
    ],
)
def test_the_published_readme_has_absolute_links(url, links, urls, backend, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("REPOSITORY_URL", url)
    (tmp_path / "README.md").write_text("![a](b.png) [c](d.md) [e](https://f) [g](#h)")
    made = backend.dynamic_metadata({}, {"version": "1"})
    assert made["readme"]["text"] == f"{links} [e](https://f) [g](#h)"
    assert made["readme"]["content-type"] == "text/markdown"
    assert len(made["readme"]) == 2
    assert made["urls"] == urls


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="needs Linux")
def test_the_levels_are_those_that_the_processor_runs():
    flags = set(Path("/proc/cpuinfo").read_text(encoding="utf-8").split())
    v3 = {"avx2", "bmi1", "bmi2", "fma"} <= flags
    v4 = v3 and {f"avx512{part}" for part in ("f", "bw", "cd", "dq", "vl")} <= flags
    assert _core.LEVELS == [*["v4"] * v4, *["v3"] * v3, "portable"]
