"""The game: its keys, the plant and time that both robots share, and the end of an episode and of the command."""

from __future__ import annotations

import re

import pytest

from capsule_gym import play
from capsule_gym.demo import find_policy
from capsule_gym.evaluation_sets import load_set
from capsule_gym.play import STRENGTH, Game
from capsule_gym.task import HORIZON, Termination

pygame = pytest.importorskip("pygame")
PLANTS = load_set("wide").plants[:3]


@pytest.fixture(autouse=True)
def display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


@pytest.fixture
def game() -> Game:
    return Game(PLANTS, find_policy("zero"))


def press(game: Game, *names: str) -> None:
    for name in names:
        game.on_key(name, True)
        game.on_key(name, False)


def test_the_last_key_wins_and_the_one_before_comes_back(game):
    def after(name: str, pressed: bool) -> float:
        game.on_key(name, pressed)
        return game.action / STRENGTH

    assert [after("a", True), after("d", True), after("d", False), after("a", False)] == [1.0, -1.0, 1.0, 0.0]
    assert [after("left", True), after("right", True)] == [1.0, -1.0]
    game.tick(0.2)
    assert game.episode.state()["theta"] < game.rival.state()["theta"] - 0.01


def test_both_are_on_the_same_plant_at_the_same_time(game):
    for number in (0, 1, 2, 0):
        for episode in (game.episode, game.rival):
            assert (episode.state()["M"], episode.state()["mu"]) == (PLANTS[number].M, PLANTS[number].mu)
        game.tick(0.5)
        assert game.episode.time == pytest.approx(0.5) and game.rival.time == pytest.approx(0.5)
        press(game, "n")
        assert game.episode.time == game.rival.time == 0.0


def test_slow_motion_loses_no_time_between_frames(game):
    game.speed = 0.1
    for _ in range(100):
        game.tick(0.02)
    assert game.episode.time == pytest.approx(0.2)


def test_a_failure_is_named_and_stops_both(game):
    game.action = 1.0
    game.tick(20.0)
    assert game.episode.end in (Termination.pendulum, Termination.contact)
    assert game.rival.time == pytest.approx(game.episode.time)
    assert re.match(r"The (ball|capsule) .* after \d\.\d s: you -?\d+\.\d\d cm/s, zero -?\d", game.note())


def test_a_whole_episode_ends_with_the_time(game):
    keys = game.note()
    game.tick(100.0)
    assert game.episode.end is Termination.none and game.episode.time == pytest.approx(HORIZON)
    press(game, "r")
    assert game.note() == keys and game.episode.time == 0.0


def test_the_command_ends_with_its_window_and_by_an_interrupt(monkeypatch):
    events = iter([[], [pygame.event.Event(pygame.QUIT)]])
    monkeypatch.setattr(pygame.event, "get", lambda: next(events))
    assert play.main(["--rival", "zero", "--set", "nominal"]) == 0
    assert not pygame.display.get_init()

    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pygame.event, "get", interrupt)
    with pytest.raises(SystemExit) as ended:
        play.main(["--rival", "zero"])
    assert ended.value.code == 130 and not pygame.display.get_init()
