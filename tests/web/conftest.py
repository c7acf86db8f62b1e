"""The built site, which the tests of the module and of the page share, and JavaScript that uses the
module."""

import json
import os
import shutil
import subprocess

import pytest

from web import build


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """The folder that `make web` writes, built in a temporary place."""
    folder = tmp_path_factory.mktemp("site") / "live"
    build.main(["--output", str(folder)])
    return folder


@pytest.fixture(scope="session")
def node(site):
    """Runs JavaScript with the module as `live`, and returns the value passed to `show`."""
    # Optional on a user's machine, and required in CI.
    if shutil.which("node") is None and "CI" not in os.environ:
        pytest.skip("needs node")

    def run(code, *arguments, module=site / "capsule.mjs"):
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
