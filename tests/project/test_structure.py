import dataclasses
import importlib
import subprocess
import sys

import pytest

from tests.project.test_pages import MODULES, ROOT


def test_another_package_baselines_is_named(tmp_path):
    (tmp_path / "baselines").mkdir()
    (tmp_path / "baselines" / "__init__.py").touch()
    # Loaded by its path, and without the finders of an editable installation, which know where `baselines.laws` is.
    code = (
        "import sys; from importlib import machinery, util; from capsule_gym import CapsuleEnv;"
        "spec = util.spec_from_file_location('baselines', sys.argv[1]);"
        "sys.modules['baselines'] = util.module_from_spec(spec); sys.meta_path[:] = [machinery.PathFinder];"
        "CapsuleEnv(controller='baselines:adaptive')"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "baselines" / "__init__.py")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert str(tmp_path) in done.stderr and "uninstall that one" in done.stderr


def test_settings_and_results_cannot_be_changed():
    """Copies, caches and threads share them."""
    # `backend` needs scikit-build-core, which only the build of a wheel has.
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in MODULES if path.name != "backend.py"]
    values = [each for name in names for each in vars(importlib.import_module(name)).values()]
    found = [each for each in values if dataclasses.is_dataclass(each) and getattr(each, "__module__", "") in names]
    changing = {(each.__module__, each.__name__) for each in found if not each.__dataclass_params__.frozen}
    assert {name for _, name in changing} == {"Archive", "Problem", "Progress"} and len(changing) == 3


def test_no_tracked_file_is_large_or_names_a_path_of_a_machine():
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listing = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [path for name in listing.split("\0") if name and (path := ROOT / name).is_file()]
    assert [path for path in files if path.stat().st_size > 5_000_000] == []
    # The strings are joined here, so that this file does not contain them.
    paths = [("/work/" + "main").encode(), ("/ro" + "ot/").encode()]
    texts = {path: text for path in files if b"\0" not in (text := path.read_bytes())}
    assert [str(path) for path, text in texts.items() if any(each in text for each in paths)] == []
