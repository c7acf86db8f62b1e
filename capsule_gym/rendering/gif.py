"""GIFs, which pillow writes; it is imported only when needed."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from capsule_gym.checks import check_number
from capsule_gym.files import replacing
from capsule_gym.rendering.renderer import FRAME_SECONDS

FRAMES_OF_PALETTE = 8
# Of a time, hundredths of a second.
ROUNDING = 1e-6


def write_gif(
    frames: Iterable[np.ndarray], path: Path, frame_seconds: float = FRAME_SECONDS, width: int = 640
) -> None:
    """Writes pictures, each (height, width, 3), uint8, as a looping GIF, atomically.

    Args:
        frames: the pictures.
        path: path of the GIF.
        frame_seconds: time between frames, positive. GIF counts hundredths of a second: durations
            alternate so that the whole lasts as long as the frames, and frames that would last none
            are left out.
        width: width of the GIF, in pixels.

    Raises:
        ValueError: if there are no pictures, or `frame_seconds` is not positive.
    """
    from PIL import Image

    accepted = "a positive number (s)"
    check_number("frame_seconds", frame_seconds, accepted, low=0.0, open_low=True)
    pictures = []
    durations = []
    end = 0
    for n, frame in enumerate(frames, start=1):
        begin = end
        end = math.ceil(100.0 * n * frame_seconds - ROUNDING)
        if end == begin:
            continue
        durations.append(10 * (end - begin))
        height = round(frame.shape[0] * width / frame.shape[1])
        pictures.append(Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS))
    if not pictures:
        raise ValueError(
            "frames must contain at least one picture, got none: the episode ended before the first"
        )
    # One palette for all frames: colours do not flicker, and only moving parts are stored again.
    every = math.ceil(len(pictures) / FRAMES_OF_PALETTE)
    shown = [np.asarray(picture) for picture in pictures[::every]]
    together = Image.fromarray(np.concatenate(shown))
    # By coverage, so that the few pixels of a legend keep their colour; then means (kmeans), which
    # do not tint the background.
    coverage, undithered = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
    palette = together.quantize(128, method=coverage, kmeans=1, dither=undithered)
    first, *others = (each.quantize(palette=palette, dither=undithered) for each in pictures)
    with replacing(path) as temporary:
        first.save(
            temporary,
            save_all=True,
            append_images=others,
            duration=durations,
            loop=0,
            optimize=True,
        )
