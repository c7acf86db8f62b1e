"""Moving pictures: what a GIF keeps of its frames, and that it is written whole or not at all."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from capsule_gym.rendering import FRAME_SECONDS, write_gif

Image = pytest.importorskip("PIL.Image")
RED = (255, 0, 0)


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


def test_a_background_keeps_its_very_colour(tmp_path):
    # One that is hardly blue, beside blues and reds and greys in plenty.
    background = (247, 249, 252)
    frame = np.full((100, 200, 3), background, np.uint8)
    frame[60:, :100] = shaded(0)[60:, :100]
    frame[60:, 100:, 0] = np.linspace(0, 255, 40)[:, None]
    frame[60:, 100:, 2] = np.linspace(0, 255, 100)
    write_gif([frame, frame], tmp_path / "plain.gif", width=200)
    (picture, *_), _ = read(tmp_path / "plain.gif")
    assert np.unique(picture[:55].reshape(-1, 3), axis=0).tolist() == [list(background)]


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
