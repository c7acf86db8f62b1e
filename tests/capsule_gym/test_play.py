"""The game: what its keys do, that both robots share plant and time, and how an episode and the command end."""

from __future__ import annotations

import re

import numpy as np
import pytest

from capsule_gym import play
from capsule_gym.demo import find_agent
from capsule_gym.evaluation_sets import load_set
from capsule_gym.play import STRENGTHS, Game
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
    return Game(PLANTS, find_agent("--rival", "zero"))


def press(game: Game, *names: str) -> None:
    for name in names:
        game.on_key(name, True)
        game.on_key(name, False)


def test_the_last_key_wins_and_the_one_before_comes_back(game):
    def after(name: str, pressed: bool) -> float:
        game.on_key(name, pressed)
        return float(np.sign(game.action))

    assert [after("a", True), after("d", True), after("d", False), after("a", False)] == [1.0, -1.0, 1.0, 0.0]
    assert [after("left", True), after("right", True)] == [1.0, -1.0]
    game.tick(0.2)
    assert game.episode.state()["theta"] < game.rival.state()["theta"] - 0.01


def test_strength_scales_the_torque_step_by_step_and_ends_at_the_limit(game):
    game.on_key("d", True)
    assert game.action == -STRENGTHS[1]
    for key, strengths in (("up", [*STRENGTHS[2:], 1.0]), ("down", [*STRENGTHS[-2::-1], STRENGTHS[0]])):
        for strength in strengths:
            press(game, key)
            assert game.action == -strength


def test_both_are_on_the_same_plant_at_the_same_time(game):
    for number in (0, 1, 2, 0):
        for episode in (game.episode, game.rival):
            assert (episode.state()["M"], episode.state()["mu"]) == (PLANTS[number].M, PLANTS[number].mu)
        game.tick(0.5)
        assert game.episode.time == pytest.approx(0.5) and game.rival.time == pytest.approx(0.5)
        press(game, "n")
        assert game.episode.time == game.rival.time == 0.0


def test_pause_and_speed_without_losing_time_between_frames(game):
    press(game, "space")
    game.tick(1.0)
    assert game.episode.time == 0.0
    press(game, "space")
    game.speed = 0.1
    for _ in range(100):
        game.tick(0.02)
    assert game.episode.time == pytest.approx(0.2)


def test_a_failure_is_named_and_stops_both(game):
    game.on_key("a", True)
    press(game, *["up"] * 9)
    game.tick(20.0)
    assert game.episode.end in (Termination.pendulum, Termination.contact)
    assert game.rival.time == pytest.approx(game.episode.time)
    assert re.match(r"The (ball|capsule) .* after \d\.\d s: -?\d+\.\d\d cm/s, zero -?\d", game.banner())


def test_a_whole_episode_ends_with_the_time(game):
    assert game.banner() == "" and "speed 1" in game.note()
    game.tick(100.0)
    assert game.episode.end is Termination.none and game.episode.time == pytest.approx(HORIZON)
    press(game, "r")
    assert game.banner() == "" and game.episode.time == 0.0


def test_the_command_ends_by_a_key_and_by_an_interrupt(monkeypatch):
    events = iter([[], [pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE)]])
    monkeypatch.setattr(pygame.event, "get", lambda: next(events))
    assert play.main(["--rival", "zero", "--set", "nominal"]) == 0
    assert not pygame.display.get_init()

    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pygame.event, "get", interrupt)
    with pytest.raises(SystemExit) as ended:
        play.main(["--rival", "zero"])
    assert ended.value.code == 130 and not pygame.display.get_init()
