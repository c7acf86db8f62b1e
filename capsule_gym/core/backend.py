"""The build backend: scikit-build-core, with PyPI's `ziglang` where there is no C++ compiler.

The environment variable CXX names another compiler. The environment variable REPOSITORY_URL sets
the repository's address: the metadata gets its URLs, and the README gets absolute links.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from scikit_build_core import build
from scikit_build_core.build import *  # noqa: F403 (the hooks of PEP 517)

ZIG = "ziglang>=0.15,<0.18"
# What the sources need of a compiler. On Windows, clang needs more than its folder in PATH.
PROGRAM = b"#if __GNUC__ < 12 && !defined(__clang__)\n#error\n#endif\n"
COMPILERS = () if os.name == "nt" else ("c++", "g++", "clang++")

if sys.implementation.name != "cpython" or sysconfig.get_config_var("Py_GIL_DISABLED"):
    raise SystemExit(
        "capsule-gym needs CPython with its global lock: "
        "its module has the stable ABI, others have none"
    )
# The modes of files in a wheel do not depend on who builds it.
os.umask(0o022)


def find_compiler() -> str | None:
    """Returns the compiler of the environment or the first one that compiles C++20, or None."""
    if "CXX" in os.environ:
        return os.environ["CXX"]
    for name in COMPILERS:
        path = shutil.which(name)
        if path and compiles(path):
            return path
    return None


def compiles(path: str) -> bool:
    """Whether a compiler accepts what the sources need."""
    command = [path, "-std=c++20", "-fsyntax-only", "-x", "c++", "-"]
    return not subprocess.run(command, input=PROGRAM, capture_output=True, check=False).returncode


def with_compiler_required(hook: Callable[..., list[str]]) -> Callable[..., list[str]]:
    """Makes a hook add a compiler to what a build needs, where there is none."""

    def requires(*args: Any, **named: Any) -> list[str]:
        return hook(*args, **named) + ([] if find_compiler() else [ZIG])

    return requires


def with_compiler(hook: Callable[..., str]) -> Callable[..., str]:
    """Makes a hook build with the compiler that was found, or with zig."""

    def build_with(*args: Any, **named: Any) -> str:
        compiler = find_compiler()
        if compiler:
            os.environ["CXX"] = compiler
            return hook(*args, **named)
        import ziglang

        zig = Path(ziglang.__file__).with_name("zig.exe" if os.name == "nt" else "zig")
        # As a C compiler it links no C++ library, of which nothing is used, and which it would
        # compile first.
        option = shlex.quote(f"-DCMAKE_CXX_COMPILER={zig.as_posix()};cc")
        os.environ["CMAKE_ARGS"] = f"{os.environ.get('CMAKE_ARGS', '')} {option}"
        os.environ.setdefault("CMAKE_GENERATOR", "Ninja")
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            os.environ["ZIG_GLOBAL_CACHE_DIR"] = folder
            os.environ["ZIG_LOCAL_CACHE_DIR"] = folder
            return hook(*args, **named)

    return build_with


get_requires_for_build_wheel = with_compiler_required(build.get_requires_for_build_wheel)
get_requires_for_build_editable = with_compiler_required(build.get_requires_for_build_editable)
build_wheel = with_compiler(build.build_wheel)
build_editable = with_compiler(build.build_editable)


def link_absolutely(text: str, files: str) -> str:
    """Makes relative links of Markdown text absolute below a URL, or keeps only their words."""

    def link(match: re.Match[str]) -> str:
        image, words, target = match.groups()
        if not files:
            return "" if image else words
        query = "?raw=true" if image else ""
        return f"{image}[{words}]({files}/{target}{query})"

    return re.sub(r"(!?)\[([^\[\]]*)\]\((?!https?:|#)([^()\s]+)\)", link, text)


def dynamic_metadata(settings: Mapping[str, Any], project: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the README and the URLs, for scikit-build-core."""
    repository = os.environ.get("REPOSITORY_URL", "").rstrip("/")
    files = f"{repository}/blob/v{project['version']}" if repository else ""
    text = link_absolutely(Path("README.md").read_text(encoding="utf-8"), files)
    urls = {
        "Repository": repository,
        "Issues": f"{repository}/issues",
        "Changelog": f"{files}/CHANGELOG.md",
    }
    return {
        "readme": {"text": text, "content-type": "text/markdown"},
        "urls": urls if repository else {},
    }
