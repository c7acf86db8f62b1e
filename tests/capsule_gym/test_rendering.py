"""The canvas, the frames, the window and the GIF: what they show, and that frames need no display."""

from __future__ import annotations

import math
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

from capsule_gym.parameters import Capsule
from capsule_gym.rendering import (
    CHART_BOTTOM,
    CHART_LEFT,
    CHART_TOP,
    FLOOR,
    FRAME_SECONDS,
    HEADER,
    HEIGHT,
    RULER,
    WIDTH,
    Canvas,
    ChartAxes,
    Renderer,
    write_gif,
)

pygame = pytest.importorskip("pygame")
Image = pytest.importorskip("PIL.Image")

STATE: dict[str, Any] = {
    "theta": 0.3,
    "theta_dot": 0.0,
    "x": 0.2,
    "x_dot": 0.0,
    "torque": 0.0,
    "time": 1.0,
    "M": 0.5,
    "mu": 0.01,
}
STAGE = slice(HEADER + 1, FLOOR)
FLOOR_REGION = slice(FLOOR + 8, FLOOR + RULER)
CHART = slice(CHART_TOP - 8, HEIGHT)


def frame(**changes: Any) -> NDArray[np.uint8]:
    """One frame by a renderer of its own, so that no chart carries over."""
    renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
    pixels = renderer.draw(**{**STATE, **changes})
    renderer.close()
    assert pixels is not None
    return pixels


def colours(pixels: NDArray[np.uint8]) -> int:
    """How many different colours the pixels have."""
    return len(np.unique(pixels.astype(np.int32) @ np.array([65536, 256, 1])))


def test_frame_is_an_rgb_array() -> None:
    pixels = frame()
    assert pixels.shape == (HEIGHT, WIDTH, 3)
    assert pixels.dtype == np.uint8
    assert pixels.flags.c_contiguous and pixels.flags.writeable
    assert colours(pixels) > 100
    np.testing.assert_array_equal(pixels, frame())
    # Channels are in the order red, green, blue: the badge of slip is orange, that of stick blue.
    for badge, order in ((frame(x_dot=0.1), 1), (pixels, -1)):
        red, green, blue = badge[40, 830].astype(int)[::order]
        assert red > green > blue
    assert frame(x=-0.5)[STAGE, 750:790].min() < 60 < frame(x=5.0)[STAGE, 750:790].min()  # the flag at the start


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mode": "ansi"}, "mode must be 'human' or 'rgb_array', got 'ansi'"),
        ({"fps": 0}, "fps must be a finite number > 0"),
        ({"torque_limit": -1.0}, "torque_limit must be a finite number > 0"),
    ],
)
def test_bad_arguments_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Renderer(**{"capsule": Capsule(), "mode": "rgb_array", "fps": 50, "torque_limit": 1.5, **changes})


def test_held_axes_stay_while_the_robot_moves() -> None:
    def labels(held: bool) -> list[NDArray[np.uint8]]:
        renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
        if held:
            renderer.hold_axes(ChartAxes(0.0, 2.0, 0.0, 50.0))
        drawn = [renderer.draw(**{**STATE, "x": 0.1 * n, "time": 0.4 * n}) for n in range(5)]
        renderer.close()
        return [pixels[CHART_TOP - 6 : CHART_BOTTOM, : CHART_LEFT - 8] for pixels in drawn if pixels is not None]

    assert len(np.unique(labels(held=True), axis=0)) == 1
    assert len(np.unique(labels(held=False), axis=0)) > 1


@pytest.mark.parametrize(
    ("name", "value", "region"),
    [
        ("theta", -0.3, STAGE),
        ("theta_dot", 5.0, STAGE),
        ("theta_reference", 0.8, STAGE),
        ("torque", 0.8, STAGE),
        ("torque", -0.8, STAGE),
        ("x_dot", 1e-9, STAGE),
        ("x_dot", 0.5, STAGE),
        ("x", 0.21, FLOOR_REGION),
        ("x", 0.23, CHART),
        ("M", 0.6, STAGE),
        ("mu", 0.2, STAGE),
        ("time", 2.0, slice(0, HEADER)),
    ],
)
def test_every_quantity_shows(name: str, value: float, region: slice) -> None:
    assert (frame()[region] != frame(**{name: value})[region]).any()


def test_growing_theta_swings_the_ball_to_the_left() -> None:
    still = frame(theta=0.0)[STAGE]
    left = np.argwhere((frame(theta=1.0)[STAGE] != still).any(axis=2))[:, 1]
    right = np.argwhere((frame(theta=-1.0)[STAGE] != still).any(axis=2))[:, 1]
    middle = WIDTH // 2
    # The angle's own figures at the right edge differ in both, so only the columns of the shell count.
    assert left.min() < middle - 100 < right.min()
    assert left[left < 720].max() < middle + 100 < right[right < 720].max()


def test_ruler_scrolls_and_repeats_with_new_labels_every_ten_centimetres() -> None:
    here, half, whole = (frame(x=1.0 + shift) for shift in (0.0, 0.05, 0.1))
    ticks, labels = slice(FLOOR + 10, FLOOR + 12), slice(FLOOR + 15, FLOOR + RULER)
    assert (here[ticks] != half[ticks]).any()
    np.testing.assert_array_equal(here[ticks], whole[ticks])
    assert (here[labels] != whole[labels]).any()
    # Moving on by one mark moves the whole ruler by one mark's pixels to the left.
    np.testing.assert_array_equal(here[labels, 156:800], whole[labels, 100:744])


def test_chart_starts_anew_when_time_goes_back() -> None:
    renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
    for k in range(30):
        renderer.draw(**{**STATE, "time": 20.0 + 0.02 * k, "x": 0.3 * math.sin(k)})
    again = renderer.draw(**STATE)
    assert again is not None
    np.testing.assert_array_equal(again, frame())


def test_chart_keeps_a_bounded_history_and_no_sample_twice() -> None:
    renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
    for k in range(30):
        renderer.draw(**{**STATE, "time": 0.5 * k, "x": 0.01 * k})
    scrolled = renderer.draw(**{**STATE, "time": 14.5, "x": 0.29})
    repeated = renderer.draw(**{**STATE, "time": 14.5, "x": 0.29})
    assert scrolled is not None and repeated is not None
    np.testing.assert_array_equal(scrolled, repeated)
    # A line of 10 s fills the chart's width: its colour stands in the left and the right tenth.
    blue = (scrolled[CHART].astype(int)[..., 2] - scrolled[CHART][..., 0]) > 100
    assert blue[:, 72:160].any() and blue[:, 850:936].any()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("l", [0.02, 0.3, 7.0])
def test_extreme_values_draw(sign: float, l: float) -> None:
    renderer = Renderer(Capsule(l=l), "rgb_array", 50, 1.5)
    for scale in (0.0, 1e-300, 1.0, 1e3, 1e6):
        pixels = renderer.draw(
            theta=sign * math.pi / 2,
            theta_dot=sign * 100.0 * scale,
            x=sign * 12.34 * scale,
            x_dot=-sign * 1.5 * scale,
            torque=sign * 10.0 * scale,
            time=33.0 * scale,
            M=0.75,
            mu=0.3,
            theta_reference=-sign * math.pi,
        )
        assert pixels is not None
        assert colours(pixels) > 100


def test_close_twice_then_draw_says_so() -> None:
    renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
    renderer.draw(**STATE)
    renderer.close()
    renderer.close()
    with pytest.raises(gymnasium.error.ClosedEnvironmentError, match=r"draw\(\) was called after close\(\)"):
        renderer.draw(**STATE)


def test_frames_survive_a_pygame_quit_by_others() -> None:
    renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
    renderer.draw(**STATE)
    pygame.quit()
    pixels = renderer.draw(**{**STATE, "time": 1.02, "x": 0.2123})
    assert pixels is not None
    np.testing.assert_array_equal(pixels[STAGE], frame(x=0.2123)[STAGE])


def test_missing_pygame_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match=r'pip install "capsule-gym\[render\]"'):
        Renderer(Capsule(), "rgb_array", 50, 1.5)


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
renderer.draw(theta=0.1, theta_dot=0.0, x=0.0, x_dot=0.0, torque=0.0, time=0.0, M=0.5, mu=0.01)
import pygame
assert not pygame.display.get_init()
changed = {name for name in os.environ if os.environ[name] != before.get(name)}
assert changed <= {"PYGAME_HIDE_SUPPORT_PROMPT"}, changed
renderer.close()
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "" and done.stderr == ""


class TestWindow:
    """Mode "human", on SDL's driver without a screen."""

    @pytest.fixture(autouse=True)
    def no_screen(self, monkeypatch: pytest.MonkeyPatch) -> Any:
        """Runs each test on the dummy driver and leaves no window behind."""
        monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
        yield
        pygame.display.quit()

    def test_draws_into_the_window(self) -> None:
        renderer = Renderer(Capsule(), "human", 200, 1.5, title="a title")
        for k in range(3):
            assert renderer.draw(**{**STATE, "time": 0.02 * k}) is None
        window = pygame.display.get_surface()
        assert window.get_size() == (WIDTH, HEIGHT)
        assert pygame.display.get_caption()[0] == "a title"
        shown = pygame.surfarray.array3d(window).swapaxes(0, 1)
        np.testing.assert_array_equal(shown[STAGE, 250:700], frame(time=0.04)[STAGE, 250:700])
        renderer.close()
        renderer.close()
        assert not pygame.display.get_init()
        with pytest.raises(gymnasium.error.ClosedEnvironmentError):
            renderer.draw(**STATE)

    def test_a_window_closed_by_its_user_stays_closed(self) -> None:
        renderer = Renderer(Capsule(), "human", 200, 1.5)
        renderer.draw(**STATE)
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        assert renderer.draw(**STATE) is None
        assert not pygame.display.get_init()
        assert renderer.draw(**STATE) is None
        renderer.close()

    def test_a_pygame_quit_by_others_counts_as_closed(self) -> None:
        renderer = Renderer(Capsule(), "human", 200, 1.5)
        renderer.draw(**STATE)
        pygame.quit()
        assert renderer.draw(**STATE) is None
        renderer.close()


WHITE, RED = (255, 255, 255), (255, 0, 0)


def covered_by(canvas: Canvas) -> np.ndarray:
    """How much of each pixel is covered by red, 0 to 1."""
    return 1.0 - canvas.array()[:, :, 1] / 255.0


@pytest.fixture
def canvas() -> Canvas:
    made = Canvas(60, 40)
    made.fill(WHITE)
    return made


def test_a_box_covers_its_pixels_and_no_others(canvas):
    canvas.box(10, 5, 20, 8, RED)
    covered = covered_by(canvas)
    assert (covered[5:13, 10:30] == 1.0).all()
    assert covered.sum() == 20 * 8


def test_a_border_leaves_the_inside_alone(canvas):
    canvas.box(10, 5, 20, 10, RED, line=2)
    assert covered_by(canvas).sum() == 20 * 10 - 16 * 6


def test_a_disc_has_its_area_and_smooth_edges(canvas):
    canvas.disc((30.0, 20.0), 10.0, RED)
    covered = covered_by(canvas)
    assert covered.sum() == pytest.approx(np.pi * 100.0, rel=0.03)
    assert np.count_nonzero((covered > 0.1) & (covered < 0.9)) > 20
    y, x = np.indices(covered.shape)
    assert (covered * x).sum() / covered.sum() == pytest.approx(29.5, abs=0.3)
    assert (covered * y).sum() / covered.sum() == pytest.approx(19.5, abs=0.3)


@pytest.mark.parametrize("degrees", [0, 20, 45, 70, 90])
def test_a_ribbon_is_as_wide_where_it_slants(canvas, degrees):
    along = 15.0 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    canvas.ribbon([(30 - along[0], 20 - along[1]), (30 + along[0], 20 + along[1])], 4.0, RED)
    assert covered_by(canvas).sum() == pytest.approx(30.0 * 4.0, rel=0.2)


@pytest.mark.parametrize("align", ["left", "centre", "right"])
def test_text_stands_at_its_edge(canvas, align):
    canvas.write("HHH", 16, RED, 30.0, 25.0, align)
    columns = np.flatnonzero(covered_by(canvas).max(axis=0) > 0.2)
    rows = np.flatnonzero(covered_by(canvas).max(axis=1) > 0.2)
    edge = {"left": columns[0], "centre": (columns[0] + columns[-1] + 1) / 2, "right": columns[-1] + 1}[align]
    assert edge == pytest.approx(30.0, abs=1.6)
    assert rows[-1] + 1 == pytest.approx(25.0, abs=1.1)


def test_a_cropped_layer_is_laid_where_it_was_covered_by(canvas):
    layer = Canvas(60, 40, transparent=True)
    layer.box(42, 11, 6, 7, RED)
    layer.crop()
    canvas.overlay(layer)
    covered = covered_by(canvas)
    assert (covered[11:18, 42:48] == 1.0).all()
    assert covered.sum() == 6 * 7


def shaded(place: int) -> np.ndarray:
    """A picture of many greys, with a few red pixels at that place."""
    frame = np.empty((100, 200, 3), np.uint8)
    frame[:] = np.add.outer(np.arange(100), np.arange(200))[..., None] * 255 // 298
    frame[10:14, place : place + 4] = RED
    return frame


def read(path) -> tuple[list[np.ndarray], list[float]]:
    """The pictures of a GIF, and how long each stands, in s."""
    with Image.open(path) as moving:
        pictures, seconds = [], []
        for n in range(moving.n_frames):
            moving.seek(n)
            pictures.append(np.asarray(moving.convert("RGB"), int))
            seconds.append(moving.info["duration"] / 1000)
        assert moving.info["loop"] == 0
    return pictures, seconds


def test_every_frame_is_there_for_its_time_with_its_colours(tmp_path):
    frames = [shaded(20 * n) for n in range(6)]
    write_gif(iter(frames), tmp_path / "moving.gif", width=200)
    pictures, seconds = read(tmp_path / "moving.gif")
    assert seconds == [FRAME_SECONDS] * 6
    for picture, frame in zip(pictures, frames, strict=True):
        assert np.abs(picture - frame).max() < 16


def test_size_and_pace_are_those_asked_for(tmp_path):
    write_gif([shaded(0), shaded(90)], tmp_path / "small.gif", frame_seconds=0.1, width=50)
    pictures, seconds = read(tmp_path / "small.gif")
    assert [picture.shape for picture in pictures] == [(25, 50, 3)] * 2
    assert seconds == [0.1, 0.1]


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


def test_without_pillow_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(ImportError, match=r'pip install "capsule-gym\[render\]"'):
        write_gif([shaded(0)], tmp_path / "none.gif")
    assert not list(tmp_path.iterdir())
