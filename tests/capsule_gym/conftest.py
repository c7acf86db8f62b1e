import pytest

from capsule_gym.core import _core, native


@pytest.fixture
def no_screen(monkeypatch):
    """SDL's driver without a screen; leaves no window behind."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pytest.importorskip("pygame").display.quit()


@pytest.fixture
def select_level():
    """Selects a level of instructions until the end of the test."""
    yield lambda name: _core.select_level(_core.LEVELS.index(name))
    _core.select_level(_core.LEVELS.index(native.LEVEL))
