"""Moving pictures as files, written with pillow, which is imported only when needed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from capsule_gym.files import replacing

# Between the frames of a moving picture: 25 a second, which a GIF can keep exactly.
FRAME_SECONDS = 0.04
# Of a palette, and how many of them are colours of the pictures themselves.
COLOURS, EXACT_COLOURS = 128, 16


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
    colours, entries = _palette(pictures)
    table = Image.new("P", (1, 1))
    table.putpalette(entries)
    for n, picture in enumerate(pictures):
        indexed = picture.quantize(palette=table, dither=Image.Dither.NONE)
        # Pillow looks for the nearest entry by the upper bits alone, and may take the neighbour of one that fits.
        packed, indices = _packed(picture), np.array(indexed)
        order = np.argsort(colours)
        places = order[np.searchsorted(colours, packed, sorter=order) % len(colours)]
        exact = colours[places] == packed
        indices[exact] = places[exact]
        indexed.putdata(indices.ravel())
        pictures[n] = indexed
    with replacing(path) as temporary:
        pictures[0].save(
            temporary,
            save_all=True,
            append_images=pictures[1:],
            duration=round(1000 * frame_seconds),
            loop=0,
            optimize=True,
        )


def _packed(picture: Any) -> np.ndarray:
    """The colours of a picture, each in one number."""
    red, green, blue = np.moveaxis(np.asarray(picture, np.uint32), -1, 0)
    return red << 16 | green << 8 | blue


def _palette(pictures: list[Any]) -> tuple[np.ndarray, list[int]]:
    """The colours that stay exactly as they are, packed, and all entries of the palette, these first.

    The most frequent colours are backgrounds: one that is missed by a little tints the whole picture. The others are
    chosen by coverage, not by frequency: the few pixels of a legend keep their colour too.
    """
    Image = import_pillow()
    middle = pictures[len(pictures) // 2]
    found, counts = np.unique([_packed(picture) for picture in (pictures[0], middle, pictures[-1])], return_counts=True)
    frequent = _unpacked(found[np.argsort(-counts, kind="stable")][: 8 * EXACT_COLOURS])
    kept: list[np.ndarray] = []
    for colour in frequent:
        # What is hardly to be told from one that is kept already becomes that one.
        if all(np.abs(colour - other).max() > 4 for other in kept):
            kept.append(colour)
    exact = np.array(kept[:EXACT_COLOURS])
    others = middle.quantize(COLOURS - len(exact), method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    return _packed(exact[None])[0], [*exact.ravel().tolist(), *others.getpalette()[: 3 * (COLOURS - len(exact))]]


def _unpacked(packed: np.ndarray) -> np.ndarray:
    """Red, green and blue of colours that are one number each."""
    return np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=-1).astype(int)
