"""Installation and imports: packages and data, light imports, import contracts."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_another_package_baselines_is_named(tmp_path: Path) -> None:
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
