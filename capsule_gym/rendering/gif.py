"""GIFs, which pillow writes; it is imported only when needed."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.files import replacing
from capsule_gym.rendering.renderer import FRAME_SECONDS

FRAMES_OF_PALETTE = 8


def write_gif(
    frames: Iterable[np.ndarray], path: Path, frame_seconds: float = FRAME_SECONDS, width: int = 640
) -> None:
    """Writes pictures, each (height, width, 3), uint8, as a looping GIF, atomically.

    Args:
        frames: the pictures.
        path: path of the GIF.
        frame_seconds: time between frames; GIF counts hundredths of a second.
        width: width of the GIF, in pixels.

    Raises:
        ValueError: if there are no pictures.
    """
    from PIL import Image

    pictures = []
    for frame in frames:
        height = round(frame.shape[0] * width / frame.shape[1])
        pictures.append(Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS))
    if not pictures:
        raise ValueError(
            "frames must contain at least one picture, got none: the episode ended before the first"
        )
    # One palette for all frames: colours do not flicker, and only moving parts are stored again. By
    # coverage, so that the few pixels of a legend keep their colour; then means (kmeans), which do
    # not tint the background.
    shown = pictures[:: -(-len(pictures) // FRAMES_OF_PALETTE)]
    together = Image.fromarray(np.concatenate([np.asarray(picture) for picture in shown]))
    palette = together.quantize(
        128, method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE
    )
    pictures = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    options: dict[str, Any] = {"duration": round(1000 * frame_seconds), "loop": 0, "optimize": True}
    with replacing(path) as temporary:
        pictures[0].save(temporary, save_all=True, append_images=pictures[1:], **options)
