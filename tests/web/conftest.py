from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from web import build

Node = Callable[..., Any]


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that `make web` writes, in another place."""
    folder = tmp_path_factory.mktemp("site") / "live"
    build.main(["--output", str(folder)])
    return folder


@pytest.fixture(scope="session")
def node(site: Path) -> Node:
    """Runs JavaScript in which the module is `live`, and `show` hands a value over; returns the value.

    A user's machine may have no node, CI must.
    """
    if shutil.which("node") is None and "CI" not in os.environ:
        pytest.skip("needs node")

    def run(code: str, *arguments: str, module: Path = site / "capsule.mjs") -> Any:
        script = (
            f"import * as live from {json.dumps(module.as_uri())};\n"
            "let shown = null;\nconst show = (value) => (shown = value);\n"
            "const bytes = (array) => Buffer.from(array.buffer, array.byteOffset, array.byteLength).toString('hex');\n"
            f"{code}\nconsole.log(JSON.stringify(shown));\n"
        )
        command = ["node", "--input-type=module", "--eval", script, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return run
