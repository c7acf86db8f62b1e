"""The built site, which the tests of the module and of the page share."""

import pytest

from web import build


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """The folder that `make web` writes, built in a temporary place."""
    folder = tmp_path_factory.mktemp("site") / "live"
    build.main(["--output", str(folder)])
    return folder
