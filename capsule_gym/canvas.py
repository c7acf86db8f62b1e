"""Anti-aliased shapes and text on an off-screen pygame surface, in pixels of the finished frame."""

from __future__ import annotations

import functools
import importlib
import os
import warnings
from collections.abc import Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int] | tuple[int, int, int, int]
Points = NDArray[np.float64] | Sequence[tuple[float, float]]
Align = Literal["left", "centre", "right"]

# Everything is drawn at twice the size and averaged down, which anti-aliases every shape and text alike.
SCALE = 2


def import_pygame() -> Any:
    """Imports pygame without its greeting and without the warnings of what it imports in turn.

    Raises:
        gymnasium.error.DependencyNotInstalled: if pygame is not installed.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pygame = importlib.import_module("pygame")
            # The first font would import this, and with it pkg_resources, which some setuptools deprecate.
            importlib.import_module("pygame.pkgdata")
    except ImportError as error:
        raise gymnasium.error.DependencyNotInstalled(
            'pygame is not installed, run: pip install "capsule-gym[render]"'
        ) from error
    return pygame


def blend(a: Colour, b: Colour, share: float) -> Colour:
    """The colour `share` of the way from a to b, without transparency."""
    red, green, blue, _ = import_pygame().Color(*a[:3]).lerp(b[:3], share)
    return red, green, blue


class Canvas:
    """A picture of the given size in pixels; the origin is at the top left.

    It needs no window and no video driver.

    Args:
        width: width of the finished frame, pixels.
        height: height of the finished frame, pixels.
        transparent: whether the ground is see-through, for a layer that lies over another canvas.
    """

    def __init__(self, width: int, height: int, *, transparent: bool = False) -> None:
        self._pygame = pygame = import_pygame()
        pygame.font.init()
        size = (SCALE * width, SCALE * height)
        self._surface = pygame.Surface(size, pygame.SRCALPHA if transparent else 0, 32)
        self._origin = (0, 0)
        self._size = (width, height)
        # pygame's own font comes with it, so no machine lacks it.
        self._font = functools.cache(lambda size: pygame.font.Font(None, SCALE * size))
        self._text = functools.lru_cache(maxsize=512)(self._render)

    def crop(self) -> None:
        """Forgets the see-through margins of a finished layer, so that it is laid over faster."""
        bounds = self._surface.get_bounding_rect()
        self._origin = bounds.topleft
        self._surface = self._surface.subsurface(bounds).copy()

    def overlay(self, layer: Canvas) -> None:
        """Lays another canvas over this one."""
        self._surface.blit(layer._surface, layer._origin)

    def frame(self) -> Any:
        """The finished picture as a pygame surface."""
        return self._pygame.transform.smoothscale(self._surface, self._size)

    def array(self) -> NDArray[np.uint8]:
        """The finished picture as a new array (height, width, 3)."""
        width, height = self._size
        pixels = bytearray(self._pygame.image.tobytes(self.frame(), "RGB"))
        return np.frombuffer(pixels, np.uint8).reshape(height, width, 3)

    def fill(self, colour: Colour) -> None:
        """Paints the whole canvas."""
        self._surface.fill(colour)

    def box(
        self,
        left: float,
        top: float,
        width: float,
        height: float,
        colour: Colour,
        *,
        radius: float = 0.0,
        line: float = 0.0,
    ) -> None:
        """A rectangle with corners of that radius: filled, or only an inner border of `line` pixels."""
        rectangle = [round(SCALE * side) for side in (left, top, width, height)]
        self._pygame.draw.rect(
            self._surface, colour, rectangle, round(SCALE * line), border_radius=round(SCALE * radius)
        )

    def disc(self, centre: tuple[float, float], radius: float, colour: Colour, *, line: float = 0.0) -> None:
        """A disc, or only its border of `line` pixels."""
        x, y = centre
        self._pygame.draw.circle(self._surface, colour, (SCALE * x, SCALE * y), SCALE * radius, round(SCALE * line))

    def polygon(self, corners: Points, colour: Colour) -> None:
        """A filled polygon."""
        self._pygame.draw.polygon(self._surface, colour, np.rint(SCALE * np.asarray(corners)).tolist())

    def ribbon(self, points: Points, width: float, colour: Colour) -> None:
        """A line through the points as one polygon: pygame's own thick lines are thin where they slant, and gape."""
        points = np.asarray(points, np.float64)
        along = np.empty_like(points)
        along[0], along[-1] = points[1] - points[0], points[-1] - points[-2]
        along[1:-1] = points[2:] - points[:-2]
        across = along[:, ::-1] * (-1.0, 1.0)
        across *= (0.5 * width / np.maximum(np.hypot(across[:, 0], across[:, 1]), 1e-9))[:, None]
        self.polygon(np.concatenate((points + across, (points - across)[::-1])), colour)

    def write(self, text: str, size: int, colour: Colour, x: float, baseline: float, align: Align = "left") -> None:
        """Text whose left edge, centre or right edge is at x."""
        image, ascent = self._text(text, size, colour)
        anchor = {"left": "topleft", "centre": "midtop", "right": "topright"}[align]
        self._surface.blit(image, image.get_rect(**{anchor: (round(SCALE * x), round(SCALE * baseline) - ascent)}))

    def _render(self, text: str, size: int, colour: Colour) -> tuple[Any, int]:
        """The text as a surface, and the height of its top above its baseline."""
        try:
            font = self._font(size)
            return font.render(text, True, colour), font.get_ascent()
        except self._pygame.error:
            # Other environments call pygame.quit() when they close, which voids every font in the process.
            self._pygame.font.init()
            self._font.cache_clear()
            font = self._font(size)
            return font.render(text, True, colour), font.get_ascent()
