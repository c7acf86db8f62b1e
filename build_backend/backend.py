"""The package's build backend: setuptools', but that a wheel also holds machine code.

The environment's first step then compiles nothing and imports no numba (`capsule_gym.compilation`). An editable
installation is built without it, and needs nothing but setuptools.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 (the hooks of PEP 517)
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.config.pyprojecttoml import read_configuration


def get_requires_for_build_wheel(config_settings=None):
    """What the package itself needs, since it is run to see what it compiles."""
    dependencies = read_configuration("pyproject.toml")["project"]["dependencies"]
    return [*build_meta.get_requires_for_build_wheel(config_settings), *dependencies]


class BuildPy(build_py):
    """Copies the package and compiles its functions."""

    def run(self):
        super().run()
        if self.editable_mode:
            return
        program = Path(__file__).with_name("compile_package.py")
        with tempfile.TemporaryDirectory() as cache:
            environment = {**os.environ, "PYTHONPATH": str(Path(self.build_lib).resolve()), "NUMBA_CACHE_DIR": cache}
            # Started elsewhere, it imports the copy.
            subprocess.run([sys.executable, str(program)], env=environment, cwd=cache, check=True)


class BdistWheel(bdist_wheel):
    """Names the wheel after the version of Python and the platform that its machine code is for."""

    def finalize_options(self):
        self.distribution.has_ext_modules = lambda: True
        super().finalize_options()
