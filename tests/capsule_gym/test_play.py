"""The command line of the game; what happens in it is in test_game.py."""

from __future__ import annotations

import re

import pytest

from capsule_gym import play

pygame = pytest.importorskip("pygame")


@pytest.fixture(autouse=True)
def dummy(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def test_play_opens_a_window_and_ends_by_a_key(monkeypatch):
    events = iter([[], [pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE)]])
    monkeypatch.setattr(pygame.event, "get", lambda: next(events))
    assert play.main(["--rival", "zero", "--set", "nominal"]) == 0


def test_an_interrupt_closes_the_window_and_is_the_exit_status(monkeypatch):
    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pygame.event, "get", interrupt)
    assert play.main(["--rival", "zero"]) == 130
    assert not pygame.display.get_init()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--rival", "adaptve"], "--rival must be one of .* got 'adaptve'; did you mean 'adaptive'"),
        (["--set", "wid"], "set must be one of .* got 'wid'; did you mean 'wide'"),
        (["--speed", "21"], "--speed must be a number from 0.1 to 20, got 21"),
    ],
)
def test_what_cannot_be_played_is_refused_in_a_line(words, said, capsys):
    with pytest.raises(SystemExit) as ended:
        play.main(words)
    error = capsys.readouterr().err
    assert ended.value.code == 2 and error.count("\n") == 1
    assert re.search(said, error)
