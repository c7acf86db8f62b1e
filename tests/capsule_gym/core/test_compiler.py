"""Compilers that round otherwise: the core refuses them, and its flags undo those of the user."""

import os
import platform
import re
import shutil
import subprocess
import sys

import pytest

from tests import ROOT

CORE = ROOT / "capsule_gym" / "core"
COMPILER = shutil.which("g++")
HARMFUL = [
    "-ffast-math",
    "-Ofast",
    "-freciprocal-math",
    "-fno-signed-zeros",
    "-funsafe-math-optimizations",
    "-ffinite-math-only",
]
if platform.machine() == "x86_64":
    HARMFUL.append("-mfpmath=387")
pytestmark = pytest.mark.skipif(COMPILER is None and "CI" not in os.environ, reason="needs g++")


@pytest.fixture(scope="module")
def exact():
    """The flags that CMakeLists.txt adds after the user's."""
    text = (CORE / "CMakeLists.txt").read_text(encoding="utf-8")
    (flags,) = re.findall(r"set\(EXACT ([^)]*)\)", text)
    (optional,) = re.findall(r"foreach\(flag ([^)]*)\)", text)
    return ["-O3", *flags.split(), *(flag for flag in optional.split() if "approx" not in flag)]


def compile_core(*flags):
    """The errors of a file that contains the core's numbers."""
    command = [COMPILER, "-std=c++20", "-ffp-contract=off", "-DCAPSULE_FP_CONTRACT_OFF", *flags]
    command += ["-fsyntax-only", "-x", "c++", str(CORE / "numbers" / "number.hpp")]
    return subprocess.run(command, capture_output=True, text=True, check=False).stderr


@pytest.mark.parametrize("flag", HARMFUL)
def test_a_flag_that_changes_bits_is_refused(flag):
    assert "every operation must be rounded as it is written" in compile_core(flag)


def test_flags_that_change_bits_are_undone(exact):
    assert "error" not in compile_core(*HARMFUL, *exact)


@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast", "-funsafe-math-optimizations"])
def test_a_library_that_is_linked_with_these_flags_keeps_denormal_numbers(flag, exact, tmp_path):
    library = tmp_path / "library.so"
    command = [COMPILER, "-shared", "-fPIC", "-x", "c++", "/dev/null", flag, *exact]
    subprocess.run([*command, "-o", str(library)], check=True)
    code = f"import ctypes; ctypes.CDLL({str(library)!r}); print(2.0 * 5e-324)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "1e-323\n"
