import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from capsule_gym import Capsule, CapsuleEnv
from capsule_gym.rendering import Renderer, write_gif
from capsule_gym.rendering.renderer import FLOOR, HEADER, HEIGHT, WIDTH

pygame = pytest.importorskip("pygame")
Image = pytest.importorskip("PIL.Image")

STATE = {
    "theta": 0.3,
    "x": 0.2,
    "x_dot": 0.0,
    "torque": 0.0,
    "time": 1.0,
    "M": 0.5,
    "mu": 0.01,
}
STAGE = slice(HEADER + 1, FLOOR)


def frame(capsule=None, **changes):
    """One frame from a new renderer, so that nothing carries over."""
    renderer = Renderer(capsule or Capsule(), "rgb_array", 50, 1.5)
    pixels = renderer.draw(**STATE | changes)
    renderer.close()
    return pixels


# Frames in blocks of pixels: `python -m tests.capsule_gym.rendering.test_rendering` draws the
# picture anew.
EXPECTED = Path(__file__).with_name("frames.png")
BLOCK = 6
SCENES = (
    {},
    {"theta": -0.7, "torque": 1.1, "x_dot": 0.35, "ghost": ("rival", 0.9, 0.45)},
    {
        "capsule": Capsule(l=0.39),
        "theta": 1.2,
        "torque": -0.2,
        "x_dot": -0.05,
        "x": -0.31,
        "mu": 0.3,
        "M": 0.75,
    },
)


def draw_scenes():
    """The scenes, as means over blocks of pixels, shape (scenes, rows, columns, 3)."""
    frames = np.stack([frame(**scene) for scene in SCENES])
    blocks = frames.reshape(-1, HEIGHT // BLOCK, BLOCK, WIDTH // BLOCK, BLOCK, 3)
    return blocks.mean(axis=(2, 4))


def test_a_frame_is_an_array_that_the_caller_may_change():
    pixels = frame()
    assert pixels.shape == (HEIGHT, WIDTH, 3)
    assert pixels.dtype == np.uint8
    assert pixels.flags.c_contiguous
    assert pixels.flags.writeable


def test_the_frames_are_those_that_were_looked_at():
    drawn = draw_scenes()
    with Image.open(EXPECTED) as picture:
        expected = np.asarray(picture.convert("RGB"), float).reshape(drawn.shape)
    # Another version of the font moves its edges by a fraction of a pixel.
    np.testing.assert_allclose(drawn, expected, atol=8.0)
    # Robot, grid and ruler of the scenes without a rival have no text.
    np.testing.assert_allclose(drawn[::2, 22:65], expected[::2, 22:65], atol=1.0)


def test_a_frame_holds_nothing_of_those_before():
    renderer = Renderer(Capsule(), "rgb_array", 50, 1.5)
    rng = np.random.default_rng(0)
    for n in range(24):
        values = rng.normal(0.0, (0.5, 0.4, 0.2, 0.6, 9.0, 0.2, 0.1))
        state = dict(zip(STATE, values, strict=True))
        if n % 3 == 0:
            state["x_dot"] = 0.0
        if n % 4 == 1:
            state["ghost"] = ("rival", 0.4, state["x"] + 0.3)
        np.testing.assert_array_equal(renderer.draw(**state), frame(**state))


def test_frames_need_no_display_and_importing_needs_no_pygame():
    code = """
import os, sys
for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
    os.environ.pop(name, None)
before = dict(os.environ)
from capsule_gym import Capsule, CapsuleEnv
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
    call = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout == ""
    assert done.returncode == 0


def window_pixels():
    """The picture in the window, shape (width, height, 3)."""
    return pygame.surfarray.array3d(pygame.display.get_surface())


def test_a_window_shows_the_frames(no_screen):
    renderer = Renderer(Capsule(), "human", 200, 1.5, title="a title")
    for n in range(3):
        assert renderer.draw(**STATE | {"time": 0.02 * n}) is None
    assert pygame.display.get_caption()[0] == "a title"
    shown = window_pixels().swapaxes(0, 1)
    assert shown.shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_array_equal(shown[STAGE, 250:700], frame(time=0.04)[STAGE, 250:700])
    renderer.close()


def test_a_window_opens_with_the_display_of_the_system(no_screen, monkeypatch):
    pygame.display.init()
    # No variable names a driver, as on a desktop.
    monkeypatch.delenv("SDL_VIDEODRIVER")
    renderer = Renderer(Capsule(), "human", 200, 1.5)
    assert pygame.display.get_init()
    renderer.close()


def test_an_environment_draws_every_step_in_its_window(no_screen):
    env = CapsuleEnv(render_mode="human")
    env.reset(seed=0)
    shown = []
    for _ in range(3):
        env.step(np.ones(1, np.float32))
        shown.append(window_pixels())
    first, second, third = shown
    assert (first != second).any()
    assert (second != third).any()
    env.close()
    assert not pygame.display.get_init()


def test_an_environment_without_a_render_mode_draws_nothing():
    env = CapsuleEnv()
    with pytest.warns(UserWarning, match=r"draws nothing without a render_mode"):
        assert env.render() is None


@pytest.mark.parametrize("by_user", [False, True])
def test_a_closed_window_stays_closed(no_screen, by_user):
    renderer = Renderer(Capsule(), "human", 200, 1.5)
    renderer.draw(**STATE)
    if by_user:
        pygame.event.post(pygame.event.Event(pygame.QUIT))
    else:
        renderer.close()
    for _ in range(2):
        assert renderer.draw(**STATE) is None
        assert renderer.closed
        assert not pygame.display.get_init()
    renderer.close()


def test_a_window_stays_open_while_another_environment_draws_in_it(no_screen):
    first, second = (CapsuleEnv(render_mode="human") for _ in range(2))
    for env in (first, second):
        env.reset(seed=0)
        env.step(np.ones(1, np.float32))
    first.close()
    shown = window_pixels()
    second.step(np.ones(1, np.float32))
    assert (window_pixels() != shown).any()
    second.close()
    assert not pygame.display.get_init()


def test_a_user_closes_the_window_of_all_renderers(no_screen):
    renderers = [Renderer(Capsule(), "human", 200, 1.5) for _ in range(2)]
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for renderer in renderers:
        renderer.draw(**STATE)
        assert renderer.closed
    assert not pygame.display.get_init()


# Time between frames, s, number of frames, and the number and durations (ms) in the GIF.
RHYTHMS = [
    (0.015, 50, 50, {10, 20}),
    (0.008, 50, 40, {10}),
    (1 / 60, 60, 60, {10, 20}),
    (0.002, 1, 1, {10}),
]


@pytest.mark.parametrize(("seconds", "count", "kept", "durations"), RHYTHMS)
def test_a_gif_lasts_as_long_as_its_frames(seconds, count, kept, durations, tmp_path):
    path = tmp_path / "moving.gif"
    frames = np.zeros((count, 4, 60, 3), np.uint8)
    for n, picture in enumerate(frames):
        picture[:, n] = 255
    write_gif(frames, path, frame_seconds=seconds, width=60)
    shown = []
    with Image.open(path) as moving:
        for n in range(moving.n_frames):
            moving.seek(n)
            shown.append(moving.info["duration"])
    assert len(shown) == kept
    assert set(shown) == durations
    assert sum(shown) == pytest.approx(max(1000.0 * seconds * count, 10.0))


@pytest.mark.parametrize("seconds", [0.0, -0.02, np.nan])
def test_a_time_between_frames_that_is_not_positive_raises_an_error(seconds, tmp_path):
    with pytest.raises(ValueError, match=f"frame_seconds must be a positive .* got {seconds}"):
        write_gif([np.zeros((4, 6, 3), np.uint8)], tmp_path / "moving.gif", seconds)


def test_every_frame_is_there_for_its_time_with_its_colours(tmp_path):
    path = tmp_path / "moving.gif"
    # Many greys, with a few red pixels that move.
    grey = np.add.outer(np.arange(100), np.arange(200)) * 255 // 298
    frames = np.tile(grey[..., None], (6, 1, 1, 3)).astype(np.uint8)
    for n, picture in enumerate(frames):
        picture[10:14, 20 * n : 20 * n + 4] = (255, 0, 0)
    write_gif(iter(frames), path, frame_seconds=0.1, width=200)
    with Image.open(path) as moving:
        assert moving.n_frames == 6
        assert moving.info["loop"] == 0
        for n, expected in enumerate(frames):
            moving.seek(n)
            shown = np.asarray(moving.convert("RGB"), int)
            assert np.abs(shown - expected).max() < 16
            assert moving.info["duration"] == 100


if __name__ == "__main__":
    picture = np.concatenate(draw_scenes()).round().astype(np.uint8)
    Image.fromarray(picture).save(EXPECTED, optimize=True)
