import pytest

from capsule_gym import _core, native


@pytest.fixture
def select_level():
    """Selects a level of instructions until the end of the test."""
    yield _core.select_level
    _core.select_level(native.LEVEL)
