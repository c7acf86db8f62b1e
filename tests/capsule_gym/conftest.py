import pytest

from capsule_gym import _core, native


@pytest.fixture
def no_screen(monkeypatch):
    """SDL's driver without a screen; leaves no window behind."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pytest.importorskip("pygame").display.quit()


@pytest.fixture
def select_level():
    """Selects a level of instructions until the end of the test."""
    yield _core.select_level
    _core.select_level(native.LEVEL)
