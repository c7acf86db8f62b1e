"""The renderer: what the frames show, that no display is needed, and that nothing leaks."""

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
    HEADER,
    HEIGHT,
    RULER,
    WIDTH,
    ChartAxes,
    Renderer,
)

pygame = pytest.importorskip("pygame")

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
    assert pixels.mean() > 128
    assert colours(pixels) > 100


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


def test_channels_are_in_the_order_red_green_blue() -> None:
    badge_slip, badge_stick = frame(x_dot=0.1)[40, 830].astype(int), frame()[40, 830].astype(int)
    assert badge_slip[0] > badge_slip[1] > badge_slip[2]
    assert badge_stick[0] < badge_stick[1] < badge_stick[2]


def test_a_frame_is_not_overwritten_by_the_next() -> None:
    renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
    first = renderer.draw(**STATE)
    assert first is not None
    copy = first.copy()
    renderer.draw(**{**STATE, "theta": -1.0, "time": 1.02})
    np.testing.assert_array_equal(first, copy)


def test_the_same_state_gives_the_same_frame() -> None:
    np.testing.assert_array_equal(frame(), frame())


@pytest.mark.parametrize(
    ("name", "value", "region"),
    [
        ("theta", -0.3, STAGE),
        ("theta_dot", 5.0, STAGE),
        ("theta_reference", 0.8, STAGE),
        ("torque", 0.8, STAGE),
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


@pytest.mark.parametrize(("name", "value"), [("torque", 0.8), ("x_dot", 0.5)])
def test_the_sign_shows_in_the_stage(name: str, value: float) -> None:
    assert (frame(**{name: value})[STAGE] != frame(**{name: -value})[STAGE]).any()


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


def test_start_is_marked_only_near_the_start() -> None:
    away, near = frame(x=5.0)[STAGE], frame(x=-0.5)[STAGE]
    flag = slice(750, 790)
    assert near[:, flag].min() < 60 < away[:, flag].min()


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


def test_figures_keep_their_places() -> None:
    """Each column of the header keeps its own ground clear at both edges, whatever the values."""
    for sign in (-1.0, 1.0):
        pixels = frame(x=sign * 12.34, x_dot=sign * 1.5, torque=sign * 1.5, theta=sign * math.pi / 2, time=1234.5)
        for column in range(1, 6):
            edge = pixels[30 : HEADER - 8, 160 * column - 8 : 160 * column + 8]
            hairline = edge[0, 8]
            clear = (edge == 255).all(axis=2) | (edge == hairline).all(axis=2)
            assert clear[:, :7].all() and clear[:, 10:].all()


def test_numpy_scalars_and_whole_numbers_are_accepted() -> None:
    as_numpy = {name: np.float64(value) for name, value in STATE.items()}
    np.testing.assert_array_equal(frame(**as_numpy), frame())
    frame(theta=0, x=0, x_dot=0, torque=0, time=0)


def test_mode_is_checked() -> None:
    with pytest.raises(ValueError, match=r"mode must be 'human' or 'rgb_array', got 'ansi'"):
        Renderer(Capsule(), "ansi", 50, 1.5)


@pytest.mark.parametrize(("fps", "torque_limit", "name"), [(0, 1.5, "fps"), (50, -1.0, "torque_limit")])
def test_numbers_are_checked(fps: int, torque_limit: float, name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} must be a finite number > 0"):
        Renderer(Capsule(), "rgb_array", fps, torque_limit)


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

    def test_frames_are_held_to_the_rate(self) -> None:
        renderer = Renderer(Capsule(), "human", 20, 1.5)
        renderer.draw(**STATE)
        start = pygame.time.get_ticks()
        for _ in range(3):
            renderer.draw(**STATE)
        assert pygame.time.get_ticks() - start >= 140
        renderer.close()

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

    def test_frames_leave_a_window_of_the_user_alone(self) -> None:
        pygame.display.init()
        window = pygame.display.set_mode((64, 48))
        renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
        renderer.draw(**STATE)
        renderer.close()
        assert pygame.display.get_surface() is window
