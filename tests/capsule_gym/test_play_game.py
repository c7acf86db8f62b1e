"""The game without a window: what its keys do, that both robots share plant and time, and how an episode ends."""

from __future__ import annotations

import numpy as np
import pytest

from capsule_gym.demo import find_driver
from capsule_gym.evaluation_sets import load_set
from capsule_gym.parameters import Capsule
from capsule_gym.play import STRENGTHS, Game, play
from capsule_gym.rendering import HEIGHT, WIDTH, Renderer
from capsule_gym.task import HORIZON, Termination

PLANTS = load_set("wide").plants[:3]


@pytest.fixture
def game() -> Game:
    return Game(PLANTS, find_driver("adaptive"))


def press(game: Game, *names: str) -> None:
    for name in names:
        game.on_key(name, True)
        game.on_key(name, False)


@pytest.mark.parametrize("keys", [("left", "right"), ("a", "d")])
def test_the_keys_swing_the_ball_to_their_side(keys):
    thetas = []
    for key in keys:
        game = Game(PLANTS, find_driver("zero"))
        game.on_key(key, True)
        game.tick(0.2)
        thetas.append(game.drive.shown()["theta"])
    still = Game(PLANTS, find_driver("zero"))
    still.tick(0.2)
    assert thetas[0] > still.drive.shown()["theta"] > thetas[1]


def test_the_last_key_wins_and_the_one_before_comes_back(game):
    def after(name: str, pressed: bool) -> float:
        game.on_key(name, pressed)
        return float(np.sign(game.player.action))

    assert [after("a", True), after("d", True), after("d", False), after("a", False)] == [1.0, -1.0, 1.0, 0.0]


def test_strength_scales_the_torque_and_ends_at_the_limit(game):
    game.on_key("a", True)
    press(game, *["up"] * 9)
    assert game.player.action == STRENGTHS[-1] == 1.0
    press(game, *["down"] * 9)
    assert game.player.action == STRENGTHS[0] > 0.0


def test_both_are_on_the_same_plant_at_the_same_time(game):
    for number in (0, 1, 2, 0):
        for drive in (game.drive, game.ghost):
            shown = drive.shown()
            assert (shown["M"], shown["mu"]) == (PLANTS[number].M, PLANTS[number].mu)
        game.tick(0.5)
        assert game.drive.time == pytest.approx(0.5) and game.ghost.time == pytest.approx(0.5)
        press(game, "n")
        assert game.drive.time == game.ghost.time == 0.0


def test_again_is_the_same_episode_bit_for_bit(game):
    game.tick(1.0)
    before = game.drive.shown(), game.ghost.shown()
    press(game, "r")
    game.tick(1.0)
    assert (game.drive.shown(), game.ghost.shown()) == before


def test_speed_pause_and_single_steps(game):
    press(game, "+")
    game.tick(0.1)
    assert game.speed == 2.0 and game.drive.time == pytest.approx(0.2)
    press(game, "space")
    game.tick(1.0)
    assert game.drive.time == pytest.approx(0.2)
    press(game, ".", ".")
    assert game.drive.time == pytest.approx(0.24)
    press(game, *["-"] * 20)
    assert game.speed == 0.1
    press(game, *["+"] * 20)
    assert game.speed == 20.0


def test_no_time_is_lost_between_frames_that_are_shorter_than_a_step(game):
    press(game, *["-"] * 20)
    for _ in range(100):
        game.tick(0.02)
    assert game.drive.time == pytest.approx(0.2)


def test_a_failure_is_named_and_stops_both(game):
    game.on_key("a", True)
    press(game, *["up"] * 9)
    game.tick(20.0)
    assert game.drive.end in (Termination.pendulum, Termination.contact)
    assert game.ghost.time == pytest.approx(game.drive.time) and game.best is None
    assert "after" in game.banner() and "adaptive" in game.banner()


def test_a_whole_episode_ends_with_the_time_and_is_remembered_as_the_best(game):
    game.tick(100.0)
    assert game.drive.end is Termination.none and game.drive.time == pytest.approx(HORIZON)
    assert game.best == game.drive.mean_speed
    assert "your best" in game.banner()
    press(game, "r")
    assert game.banner() == ""


# --- the window ------------------------------------------------------------------------------------------------------


@pytest.fixture
def pygame(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    module = pytest.importorskip("pygame")
    yield module
    module.display.quit()


def window(game: Game) -> Renderer:
    return Renderer(Capsule(), "human", 100_000, 1.5, "you and adaptive", game.on_key)


def test_keys_of_the_window_reach_the_game_until_it_ends(pygame, game):
    renderer = window(game)
    for key in (pygame.K_g, pygame.K_SPACE, pygame.K_q):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    play(game, renderer, 0.02)
    assert game.over and game.paused and not game.shows_ghost
    renderer.close()


def test_a_closed_window_ends_the_game(pygame, game):
    renderer = window(game)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    play(game, renderer, 0.02)
    assert renderer.closed and not game.over


def test_ghost_note_and_banner_show(pygame, game):
    renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)

    def drawn() -> np.ndarray:
        picture = renderer.draw(**game.drive.shown(), overlay=game.overlay())
        assert picture is not None and picture.shape == (HEIGHT, WIDTH, 3)
        return picture

    game.tick(2.0)
    with_ghost = drawn()
    press(game, "g")
    without = drawn()
    assert (with_ghost != without).any(axis=2).sum() > 500
    press(game, "+")
    assert (without != drawn()).any()
    game.tick(100.0)
    ended = drawn()
    dark = (ended == (30, 41, 59)).all(axis=2)
    assert dark[382:410].sum() > 10_000
