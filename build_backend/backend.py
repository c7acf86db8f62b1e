"""The package's build backend: setuptools, with machine code added to the wheel.

With the machine code, the environment's first step compiles nothing and does not import numba
(`capsule_gym.compilation`). An editable installation has no machine code and needs only setuptools to build.

The environment variable REPOSITORY_URL sets the repository's address: the metadata gets its URLs, and the README gets
absolute links. Two builds of the same files give the same bytes.
"""

from __future__ import annotations

import gzip
import os
import re
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 (the hooks of PEP 517)
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.command.egg_info import egg_info
from setuptools.config.pyprojecttoml import read_configuration

# Times in the archives: 1980-01-01, the earliest that a wheel can hold.
os.environ.setdefault("SOURCE_DATE_EPOCH", "315532800")
os.umask(0o022)
# Otherwise setuptools warns that it compiles no bytecode. A wheel contains none.
sys.dont_write_bytecode = False


def get_requires_for_build_wheel(config_settings=None):
    """The requirements of the package itself, which the build runs to compile its kernels."""
    dependencies = read_configuration("pyproject.toml")["project"]["dependencies"]
    return [*build_meta.get_requires_for_build_wheel(config_settings), *dependencies]


def build_sdist(sdist_directory, config_settings=None):
    """Builds the sdist without the times, owners and modes of the original files."""
    name = build_meta.build_sdist(sdist_directory, config_settings)
    path = Path(sdist_directory, name)
    epoch = int(os.environ["SOURCE_DATE_EPOCH"])
    repacked = path.with_suffix(".tmp")
    with (
        tarfile.open(path) as old,
        open(repacked, "wb") as file,
        gzip.GzipFile("", "wb", fileobj=file, mtime=epoch) as zipped,
        tarfile.open(fileobj=zipped, mode="w", format=tarfile.PAX_FORMAT) as new,
    ):
        for member in sorted(old.getmembers(), key=lambda each: each.name):
            member.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            member.mtime, member.uid, member.gid, member.uname, member.gname = epoch, 0, 0, "", ""
            member.pax_headers = {}
            new.addfile(member, old.extractfile(member))
    repacked.replace(path)
    return name


def link_absolutely(text, files):
    """Makes relative links of Markdown text absolute below the URL `files`; without a URL, keeps only their words."""

    def link(match):
        image, words, target = match.groups()
        if files:
            return f"{image}[{words}]({files}/{target}{'?raw=true' if image else ''})"
        return "" if image else words

    return re.sub(r"(!?)\[([^\[\]]*)\]\((?!https?:|#)([^()\s]+)\)", link, text)


class EggInfo(egg_info):
    """Writes the metadata with URLs."""

    def finalize_options(self):
        super().finalize_options()
        metadata, repository = self.distribution.metadata, os.environ.get("REPOSITORY_URL", "").rstrip("/")
        files = f"{repository}/blob/v{metadata.version}" if repository else ""
        metadata.long_description = link_absolutely(metadata.long_description, files)
        if repository:
            metadata.project_urls = {
                "Repository": repository,
                "Issues": f"{repository}/issues",
                "Changelog": f"{files}/CHANGELOG.md",
            }


class BuildPy(build_py):
    """Copies the package and compiles its functions."""

    def run(self):
        super().run()
        if self.editable_mode:
            return
        program = Path(__file__).with_name("compile_package.py")
        with tempfile.TemporaryDirectory() as cache:
            environment = {**os.environ, "PYTHONPATH": str(Path(self.build_lib).resolve()), "NUMBA_CACHE_DIR": cache}
            # The working folder is another one, so that Python imports the copy.
            subprocess.run([sys.executable, str(program)], env=environment, cwd=cache, check=True)
        for path in Path(self.build_lib).rglob("*"):
            path.chmod(0o755 if path.is_dir() else 0o644)


class BdistWheel(bdist_wheel):
    """Names the wheel after the Python version and the platform of its machine code."""

    def finalize_options(self):
        self.distribution.has_ext_modules = lambda: True
        super().finalize_options()
