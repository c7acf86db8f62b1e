"""The canvas, the frames, the window and the GIF: what they show, and that frames need no display."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from capsule_gym.parameters import Capsule
from capsule_gym.rendering import (
    BALL_COLOUR,
    COLUMN,
    FLOOR,
    GHOST,
    HEADER,
    HEIGHT,
    PIVOT,
    ROD,
    SLIP,
    STICK,
    TORQUE,
    WIDTH,
    Colour,
    Renderer,
    _number,
    write_gif,
)

pygame = pytest.importorskip("pygame")
Image = pytest.importorskip("PIL.Image")

NAMES = ("theta", "x", "x_dot", "torque", "time", "M", "mu")
STATE: dict[str, Any] = dict(zip(NAMES, (0.3, 0.2, 0.0, 0.0, 1.0, 0.5, 0.01), strict=True))
STAGE = slice(HEADER + 1, FLOOR)


def frame(capsule: Capsule | None = None, **changes: Any) -> NDArray[np.uint8]:
    """One frame by a renderer of its own, so that nothing carries over."""
    renderer = Renderer(capsule or Capsule(), "rgb_array", 50, 1.5)
    pixels = renderer.draw(**{**STATE, **changes})
    renderer.close()
    assert pixels is not None
    return pixels


def test_a_frame_is_an_array_of_its_own() -> None:
    first, second = frame(), frame()
    assert first.shape == (HEIGHT, WIDTH, 3) and first.dtype == np.uint8
    assert first.flags.c_contiguous and first.flags.writeable
    np.testing.assert_array_equal(first, second)


def middle(pixels: NDArray[np.uint8], colour: Colour) -> tuple[float, float]:
    """Column and row of the middle of the pixels of that colour."""
    rows, columns = np.nonzero((pixels == colour).all(axis=2))
    return float(columns.mean()), float(rows.mean())


@pytest.mark.parametrize("theta", [-1.2, 0.0, 0.7])
def test_the_ball_is_at_the_angle_of_the_pendulum(theta: float) -> None:
    column, row = middle(frame(theta=theta), BALL_COLOUR)
    assert column == pytest.approx(WIDTH / 2 - ROD * np.sin(theta), abs=1.0)
    # The rod covers the lower part of the ball.
    assert row == pytest.approx(FLOOR - PIVOT - ROD * np.cos(theta), abs=3.0)


def test_the_contact_has_the_colour_of_stick_or_of_slip() -> None:
    for x_dot, contact, other in ((0.0, STICK, SLIP), (-1e-9, SLIP, STICK)):
        pixels = frame(x_dot=x_dot)
        assert (pixels[FLOOR + 2, WIDTH // 2] == contact).all()
        assert not (pixels == other).all(axis=2).any()


def test_the_torque_is_an_arc_towards_the_side_that_the_motor_turns_to() -> None:
    arc = {torque: (frame(torque=torque)[STAGE] == TORQUE).all(axis=2) for torque in (0.0, 0.7, 1.5, -1.5, 9.0)}
    assert not arc[0.0].any() and 0 < arc[0.7].sum() < arc[1.5].sum()
    assert np.nonzero(arc[1.5])[1].max() <= WIDTH / 2 <= np.nonzero(arc[-1.5])[1].min()
    np.testing.assert_array_equal(arc[9.0], arc[1.5])


@pytest.mark.parametrize(("length", "mark"), [(0.3, 56), (0.03, 56), (0.5, 336)])
def test_the_ruler_moves_beneath_the_robot_in_the_scale_of_its_rod(length: float, mark: int) -> None:
    def ruler(x: float) -> NDArray[np.uint8]:
        return frame(Capsule(l=length), x=x)[FLOOR + 10 : FLOOR + 12]

    pixels = mark / (10.0 ** np.ceil(np.log10(length / 4.0)))
    np.testing.assert_array_equal(ruler(5.0 / pixels)[:, :-5], ruler(0.0)[:, 5:])
    dark = (ruler(0.0)[0, :WIDTH].astype(int).sum(axis=1) < 600).nonzero()[0]
    assert set(np.diff(dark)) == {mark} and WIDTH // 2 in dark


def test_another_robot_is_drawn_at_its_distance_while_it_is_in_the_picture() -> None:
    for lead, shown in ((0.3, True), (-0.2, True), (1e6, False), (-1e6, False)):
        pixels = frame(x=1.0, theta=1.2, ghost=("rival", 0.0, 1.0 + lead))
        here = (pixels[STAGE] == GHOST).all(axis=2)
        assert here.any() == shown
        if shown:
            column = middle(pixels, GHOST)[0] - WIDTH / 2
            assert column == pytest.approx(lead * ROD / 0.3, abs=20.0)
        corner = slice(HEADER, HEADER + 40), slice(WIDTH - 200, WIDTH)
        assert (pixels[corner] != frame(x=1.0)[corner]).any()


@pytest.mark.parametrize(
    ("change", "columns"),
    [
        ({"time": 1.01, "x": 0.202}, (0, 1)),
        ({"x": 0.21}, (1, 3)),
        ({"x_dot": 0.1}, (2, 5)),
        ({"torque": 0.01}, (4,)),
    ],
)
def test_the_figures_show_the_state(change: dict[str, float], columns: tuple[int, ...]) -> None:
    differs = (frame(**change) != frame())[:HEADER].any(axis=(0, 2)).reshape(6, COLUMN).any(axis=1)
    assert tuple(np.flatnonzero(differs)) == columns


def test_names_plant_and_note_are_written() -> None:
    top, bottom = slice(HEADER + 10, HEADER + 50), slice(HEIGHT - 30, HEIGHT)
    for change, rows in (({"M": 0.6}, top), ({"mu": 0.02}, top), ({"note": "a note"}, bottom)):
        assert (frame(**change) != frame())[rows].any()


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [(-0.04, 1, "0.0"), (-1.25, 2, "\N{MINUS SIGN}1.25"), (9999999.4, 0, "9999999"), (123456789.0, 1, "1.2e+08")],
)
def test_numbers_have_a_true_minus_sign_and_fit_their_place(value: float, decimals: int, text: str) -> None:
    assert _number(value, decimals) == text


def test_frames_survive_a_pygame_quit_by_others() -> None:
    renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
    renderer.draw(**STATE)
    pygame.quit()
    pixels = renderer.draw(**{**STATE, "time": 1.02, "x": 0.2123})
    assert pixels is not None
    np.testing.assert_array_equal(pixels[STAGE], frame(x=0.2123)[STAGE])


def test_frames_need_no_display_and_importing_needs_no_pygame() -> None:
    code = """
import os, sys
for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
    os.environ.pop(name, None)
before = dict(os.environ)
from capsule_gym.parameters import Capsule
from capsule_gym.rendering import Renderer
assert "pygame" not in sys.modules
renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
renderer.draw(theta=0.1, x=0.0, x_dot=0.0, torque=0.0, time=0.0, M=0.5, mu=0.01)
import pygame
assert not pygame.display.get_init()
changed = {name for name in os.environ if os.environ[name] != before.get(name)}
assert changed <= {"PYGAME_HIDE_SUPPORT_PROMPT"}, changed
renderer.close()
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "" and done.stderr == ""


@pytest.fixture
def dummy(monkeypatch: pytest.MonkeyPatch) -> Any:
    """SDL's driver without a screen; leaves no window behind."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


def test_a_window_shows_the_frames(dummy) -> None:
    renderer = Renderer(Capsule(), "human", 200, 1.5, title="a title")
    for k in range(3):
        assert renderer.draw(**{**STATE, "time": 0.02 * k}) is None
    window = pygame.display.get_surface()
    assert window.get_size() == (WIDTH, HEIGHT) and pygame.display.get_caption()[0] == "a title"
    shown = pygame.surfarray.array3d(window).swapaxes(0, 1)
    np.testing.assert_array_equal(shown[STAGE, 250:700], frame(time=0.04)[STAGE, 250:700])
    renderer.close()
    renderer.close()
    assert not pygame.display.get_init()
    assert renderer.closed and renderer.draw(**STATE) is None


def test_a_window_closed_by_its_user_stays_closed(dummy) -> None:
    renderer = Renderer(Capsule(), "human", 200, 1.5)
    renderer.draw(**STATE)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(2):
        assert renderer.draw(**STATE) is None and renderer.closed
        assert not pygame.display.get_init()


RED = (255, 0, 0)


def shaded(place: int) -> np.ndarray:
    """A picture of many greys, with a few red pixels at that place."""
    frame = np.empty((100, 200, 3), np.uint8)
    frame[:] = np.add.outer(np.arange(100), np.arange(200))[..., None] * 255 // 298
    frame[10:14, place : place + 4] = RED
    return frame


def test_every_frame_is_there_for_its_time_with_its_colours(tmp_path):
    frames = [shaded(20 * n) for n in range(6)]
    write_gif(iter(frames), tmp_path / "moving.gif", frame_seconds=0.1, width=200)
    with Image.open(tmp_path / "moving.gif") as moving:
        assert (moving.n_frames, moving.info["loop"]) == (6, 0)
        for n, frame in enumerate(frames):
            moving.seek(n)
            assert moving.info["duration"] == 100
            assert np.abs(np.asarray(moving.convert("RGB"), int) - frame).max() < 16


def test_what_stood_there_stays_where_no_picture_can_be_written(tmp_path):
    def breaking():
        yield shaded(0)
        raise RuntimeError

    path = tmp_path / "kept.gif"
    path.write_bytes(b"mine")
    with pytest.raises(ValueError, match="frames must hold at least one picture, got none"):
        write_gif((), path)
    with pytest.raises(RuntimeError):
        write_gif(breaking(), path)
    assert path.read_bytes() == b"mine" and list(tmp_path.iterdir()) == [path]
