"""Installation and imports: packages and data, light imports, import contracts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Without the optional packages, an environment with and without a law is created and stepped.
MINIMAL = """
import sys
for name in ("agents", "torch", "stable_baselines3", "pygame", "PIL", "matplotlib", "tyro", "tqdm"):
    sys.modules[name] = None
import gymnasium as gym
import capsule_gym
# It is light: numba and the baselines come when they are asked for.
assert not {"numba", "baselines"} & set(sys.modules)
for controller in (None, "baselines:adaptive"):
    env = gym.make(capsule_gym.ENV_ID, controller=controller)
    env.reset(seed=0)
    env.step(env.action_space.sample())
capsule_gym.load_policy("direct-ppo")
try:
    import capsule_gym.demo
except ImportError as error:
    assert 'pip install "capsule-gym[render]"' in str(error)
"""


def test_the_environment_needs_no_optional_package() -> None:
    done = subprocess.run([sys.executable, "-c", MINIMAL], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_another_package_baselines_is_named(tmp_path: Path) -> None:
    (tmp_path / "baselines").mkdir()
    (tmp_path / "baselines" / "__init__.py").touch()
    code = "from capsule_gym import CapsuleEnv; CapsuleEnv(controller='baselines:adaptive')"
    # Python searches the folder in which it starts first.
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert str(tmp_path) in done.stderr and "uninstall that one" in done.stderr


def test_packages_policies_and_sets_are_installed() -> None:
    tomllib = pytest.importorskip("tomllib", reason="from Python 3.11 on", exc_type=ImportError)
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    folders = {path.parent for top in ("capsule_gym", "baselines") for path in (ROOT / top).rglob("__init__.py")}
    names = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    data = {"capsule_gym.checkpoints": "*/seed-*/policy.safetensors", "capsule_gym.frozen": "*.json"}
    assert sorted(setuptools["packages"]) == sorted({*names, *data})
    for package, files in data.items():
        folder = ROOT / setuptools["package-dir"][package]
        (pattern,) = setuptools["package-data"][package]
        assert set(folder.glob(pattern)) == set(folder.glob(files)) != set()


def test_no_tracked_file_is_large_or_names_a_path_of_a_machine() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listing = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [path for name in listing.split("\0") if name and (path := ROOT / name).is_file()]
    assert [path for path in files if path.stat().st_size > 5_000_000] == []
    # The strings are joined here, so that this file does not contain them.
    paths = [("/work/" + "main").encode(), ("/ro" + "ot/").encode()]
    contents = {path: path.read_bytes() for path in files}
    assert [
        str(path) for path, text in contents.items() if b"\0" not in text and any(each in text for each in paths)
    ] == []
