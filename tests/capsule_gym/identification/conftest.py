import pytest

from tests.capsule_gym.identification.rig import WHITE, make_log


@pytest.fixture(scope="session")
def log():
    """A log of 20 s with white noise."""
    return make_log(WHITE)
