"""The built site, and JavaScript that uses the module."""

import json
import os
import re
import shutil
import subprocess

import pytest

from web import build

# Functions of JavaScript for the tests.
PRELUDE = """
let shown = null;
const show = (value) => (shown = value);
const bytes = ({ buffer, byteOffset, byteLength }) =>
  Buffer.from(buffer, byteOffset, byteLength).toString("hex");
const swing = (capsule, steps) => {
  for (let n = 0; n < steps; n++) capsule.step(Math.fround(0.02 * (n % 7 - 3)));
};
const errorsOf = async (calls) => {
  const errors = [];
  for (const call of calls) {
    try {
      await call();
      errors.push("no error");
    } catch (error) {
      errors.push(`${error.name}: ${error.message}`);
    }
  }
  return errors;
};
"""


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """The folder that `make web` writes, built in a temporary place."""
    folder = tmp_path_factory.mktemp("site") / "live"
    build.main(["--output", str(folder)])
    return folder


@pytest.fixture(scope="session")
def run_node():
    """Runs JavaScript in node, and returns what it prints last, as JSON."""
    # Optional on a user's machine, and required in CI.
    if shutil.which("node") is None and "CI" not in os.environ:
        pytest.skip("needs node")

    def run(code, *files):
        command = ["node", "--input-type=module", "--eval", code, *map(str, files)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return run


@pytest.fixture(scope="session")
def node(site, run_node):
    """Runs JavaScript with the module as `live`, and returns the value passed to `show`."""

    def run(code, *files, module=site / "capsule.mjs"):
        imported = f"import * as live from {json.dumps(module.as_uri())};"
        shown = "console.log(JSON.stringify(shown));"
        return run_node("\n".join([imported, PRELUDE, code, shown]), *files)

    return run


def check_errors(expected, found):
    """Compares the error of each call with the pattern that is expected."""
    for (call, pattern), error in zip(expected.items(), found, strict=True):
        assert re.match(pattern, error), (call, error)
