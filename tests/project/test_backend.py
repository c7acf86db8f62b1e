import os
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from capsule_gym.core import _core
from tests.project.test_pages import ROOT

SET = ("CMAKE_ARGS", "CMAKE_GENERATOR", "ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")


@pytest.fixture
def backend(monkeypatch):
    """The module, with hooks of scikit-build-core that return what a build needs or sees."""
    monkeypatch.setattr(os, "umask", lambda mode: None)
    monkeypatch.setattr(
        os,
        "environ",
        {name: each for name, each in os.environ.items() if name not in ("CXX", *SET)},
    )
    build = ModuleType("scikit_build_core.build")
    for kind in ("wheel", "editable"):
        setattr(build, f"get_requires_for_build_{kind}", lambda settings: [settings])
        setattr(build, f"build_{kind}", lambda folder, **given: (folder, given, {**os.environ}))
    monkeypatch.setitem(sys.modules, "scikit_build_core", SimpleNamespace(build=build))
    monkeypatch.setitem(sys.modules, "scikit_build_core.build", build)
    return SimpleNamespace(**runpy.run_path(str(ROOT / "capsule_gym" / "core" / "backend.py")))


@pytest.mark.skipif(os.name == "nt", reason="on Windows only CXX names a compiler")
@pytest.mark.parametrize("found", ["", "g++", "named"])
@pytest.mark.parametrize("kind", ["wheel", "editable"])
def test_a_build_asks_for_zig_where_it_finds_no_compiler(
    kind, found, backend, monkeypatch, tmp_path
):
    for name, status in {"c++": 1, **({"g++": 0, "clang++": 0} if found == "g++" else {})}.items():
        (tmp_path / name).write_text(f"#!/bin/sh\nexit {status}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    if found == "named":
        monkeypatch.setenv("CXX", "named")
    needed = getattr(backend, f"get_requires_for_build_{kind}")("ninja")
    folder, given, seen = getattr(backend, f"build_{kind}")("here", settings=1)
    assert (folder, given, needed) == (
        "here",
        {"settings": 1},
        ["ninja", *([] if found else [backend.ZIG])],
    )
    if found:
        assert seen["CXX"].endswith(found) and not {*SET} & set(seen)
    else:
        assert (
            "zig;cc" in seen["CMAKE_ARGS"]
            and seen["CMAKE_GENERATOR"] == "Ninja"
            and "CXX" not in seen
        )
        assert seen[SET[2]] == seen[SET[3]] and not os.path.exists(seen[SET[2]])


@pytest.mark.parametrize("url", ["", "https://x/"])
def test_the_published_readme_has_absolute_links(url, backend, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("REPOSITORY_URL", url)
    (tmp_path / "README.md").write_text("![a](b.png) [c](d.md) [e](https://f) [g](#h)")
    made, files = backend.dynamic_metadata({}, {"version": "1"}), "https://x/blob/v1"
    links = f"![a]({files}/b.png?raw=true) [c]({files}/d.md)" if url else " c"
    assert made["readme"] == {
        "text": f"{links} [e](https://f) [g](#h)",
        "content-type": "text/markdown",
    }
    urls = {
        "Repository": "https://x",
        "Issues": "https://x/issues",
        "Changelog": f"{files}/CHANGELOG.md",
    }
    assert made["urls"] == (urls if url else {})


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="needs Linux")
def test_the_levels_are_those_that_the_processor_runs():
    flags = set(Path("/proc/cpuinfo").read_text(encoding="utf-8").split())
    v3 = {"avx2", "bmi1", "bmi2", "fma"} <= flags
    v4 = v3 and {f"avx512{part}" for part in ("f", "bw", "cd", "dq", "vl")} <= flags
    assert _core.LEVELS == [*["v4"] * v4, *["v3"] * v3, "portable"]
