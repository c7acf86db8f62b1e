"""Moving pictures as files, written with pillow, which is imported only when needed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.files import replacing

# Between the frames of a moving picture: 25 a second, which a GIF can keep exactly.
FRAME_SECONDS = 0.04


def import_pillow() -> Any:
    """Imports pillow's `Image`.

    Raises:
        ImportError: if pillow is not installed.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError('pillow is not installed, run: pip install "capsule-gym[render]"') from error
    return Image


def write_gif(frames: Iterable[np.ndarray], path: Path, frame_seconds: float = FRAME_SECONDS, width: int = 640) -> None:
    """Writes pictures as a looping GIF.

    Args:
        frames: (height, width, 3) uint8 each.
        path: the GIF; written whole or not at all.
        frame_seconds: time between frames; GIF counts hundredths of a second.
        width: of the result, in pixels.

    Raises:
        ImportError: if pillow is not installed.
        ValueError: if there are no pictures.
    """
    Image = import_pillow()

    pictures = []
    for frame in frames:
        height = round(frame.shape[0] * width / frame.shape[1])
        pictures.append(Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS))
    if not pictures:
        raise ValueError("frames must hold at least one picture, got none: the episode ended before the first")
    # One palette for all frames: colours do not flicker, and only what moves is stored anew.
    # By coverage, not by frequency: the few pixels of a legend keep their colour too. Then means (kmeans): the middle
    # of a range of colours would give a background, most of the picture, a tint.
    middle = pictures[len(pictures) // 2]
    palette = middle.quantize(128, method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
    pictures = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    with replacing(path) as temporary:
        pictures[0].save(
            temporary,
            save_all=True,
            append_images=pictures[1:],
            duration=round(1000 * frame_seconds),
            loop=0,
            optimize=True,
        )
