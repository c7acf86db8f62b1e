"""Rendering of the robot in a window or as RGB frames.

pygame is imported only when needed.
"""

import math
import os
from collections.abc import Sequence
from functools import lru_cache
from typing import Any
from weakref import WeakSet

import gymnasium
import numpy as np
from numpy.typing import NDArray

from capsule_gym.parameters import Capsule
from capsule_gym.tasks.task import ENV_ID

Points = NDArray[np.float64] | Sequence[tuple[float, float]]

# Everything is drawn at this size and averaged down, which anti-aliases shapes and texts alike.
SCALE = 2
# Time between frames, s: 25 frames a second, which a GIF can represent exactly.
FRAME_SECONDS = 0.04
WIDTH, HEIGHT = 960, 450

# Layout in pixels of the finished frame.
GRID_TOP = 130
HEADER, FLOOR, RULER = 76, 378, 36
COLUMN, VALUE_RIGHT, VALUE_BASELINE = 160, 108, 58
# Sizes of the robot in pixels; the rod's length sets the scale of the ruler.
MIDDLE = WIDTH / 2
ROD, BALL, PIVOT = 168.0, 19.0, 67.0
SHELL_HEIGHT = PIVOT + ROD + BALL + 12.0
SHELL_HALF = 224.0
PLATFORM_HALF, PLATFORM_HEIGHT = 68.0, 25.0
GAUGE = 72.0
SMALLEST_ARROW = 0.015  # rad
SPRING_INNER, SPRING_OUTER, SPRING_TURNS = 9.0, 31.0, 2.5

PAPER = "#f7f9fc"
WHITE = "#ffffff"
FLOOR_FILL = "#e9eef4"
GRID = "#e2e8f0"
HAIRLINE = "#d9e0e9"
TICK = "#94a0b1"
GREY = "#6d7a8d"
INK = "#1e293b"
SLATE = "#475569"
SHELL = "#8096b5"
INSIDE = "#e7ecf3"
BALL_COLOUR = "#0d807c"
TORQUE = "#8b4cc7"
STICK = "#2563ba"
SLIP = "#ee8024"
GHOST = "#c4cdd9"


def _number(value: float, decimals: int) -> str:
    """A number of at most eight characters, with a true minus sign and never "-0"."""
    # Adding 0.0 turns the -0.0 that small negative values round to into 0.0.
    text = f"{round(value, decimals) + 0.0:.{decimals}f}"
    if len(text) > 8:
        text = f"{value:.1e}"
    return text.replace("-", "\N{MINUS SIGN}")


def _polar(angle: Any, radius: Any) -> tuple[Any, Any]:
    """The points at these angles from the upright, growing to the left, around the pivot."""
    return MIDDLE - radius * np.sin(angle), FLOOR - PIVOT - radius * np.cos(angle)


def _import_pygame() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        message = 'pygame is not installed, run: pip install "capsule-gym[render]"'
        raise gymnasium.error.DependencyNotInstalled(message) from error
    return pygame


# The renderers that draw in pygame's window, of which there is one in a process.
_SHOWN: "WeakSet[Renderer]" = WeakSet()


class Renderer:
    """Draws the robot on its floor, and its figures.

    The camera follows the platform, so the ruler moves beneath it. Blue is stick, orange is slip.

    In mode "human" draws do nothing after the window is closed. In mode "rgb_array" no window,
    display or video driver is used.

    Args:
        capsule: the robot; its l sets the scale.
        mode: "human" for a window, "rgb_array" for frames.
        fps: frames per second of the window.
        torque_limit: torque that the arc arrow shows as a quarter turn, N m.
        title: shown in the picture, where some 30 characters fit, and on the window.

    Raises:
        gymnasium.error.DependencyNotInstalled: if pygame is not installed.
        RuntimeError: in mode "human" without a display.

    Attributes:
        closed: whether draws do nothing, after `close` or after the user has closed the window.
    """

    def __init__(
        self, capsule: Capsule, mode: str, fps: float, torque_limit: float, title: str = ENV_ID
    ) -> None:
        self._mode = mode
        self._title = title
        self._fps = fps
        self._torque_limit = torque_limit
        # Metres between labelled marks, a power of ten that is 42 to 420 pixels.
        self._major = 10.0 ** math.ceil(math.log10(capsule.l / 4.0))
        # A whole number of canvas pixels between labelled marks: the marks then move as one and do
        # not shimmer.
        self._major_pixels = round(SCALE * ROD / capsule.l * self._major) / SCALE
        self.closed = False
        self._pygame = pygame = _import_pygame()
        self._canvas = pygame.Surface((SCALE * WIDTH, SCALE * HEIGHT), 0, 32)
        self._pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        self._frame = pygame.image.frombuffer(self._pixels, (WIDTH, HEIGHT), "RGB")
        # Most texts are the same from frame to frame.
        self._text = lru_cache(256)(self._draw_text)
        self._window: Any = None
        if mode == "human":
            self._open_window()

    def _open_window(self) -> None:
        pygame = self._pygame
        pygame.display.init()
        # Without a display SDL draws into memory, and no window appears.
        if pygame.display.get_driver() == "offscreen" and not os.environ.get("SDL_VIDEODRIVER"):
            pygame.display.quit()
            raise RuntimeError(
                "a window needs a display, and there is none; frames and GIFs need no display"
            )
        pygame.display.set_caption(self._title)
        self._window = pygame.display.set_mode((WIDTH, HEIGHT))
        _SHOWN.add(self)
        self._clock = pygame.time.Clock()

    def draw(
        self,
        *,
        theta: float,
        x: float,
        x_dot: float,
        torque: float,
        time: float,
        M: float,
        mu: float,
        ghost: tuple[str, float, float] | None = None,
    ) -> NDArray[np.uint8] | None:
        """Draws one frame and, in a window, waits until it is due.

        Args:
            theta: angle of the pendulum from the upright, rad.
            x: displacement of the platform, m.
            x_dot: its velocity, m/s; it sticks where this is exactly 0.0.
            torque: motor torque, N m.
            time: time since the start of the episode, s.
            M: mass of the platform, kg.
            mu: friction coefficient.
            ghost: the name, theta and x of another robot on the same floor, drawn pale behind the
                first.

        Returns:
            The frame as an array of uint8, (450, 960, 3), in mode "rgb_array"; None in mode "human"
            and once closed.
        """
        pygame = self._pygame
        if self._window is not None:
            self._close_if_asked()
        if self.closed:
            return None
        self._draw_background(x)
        if ghost is not None:
            self._draw_ghost(*ghost, x)
        plant = f"M {M:.3f} kg     \N{GREEK SMALL LETTER MU} {mu:.4f}"
        self._write(self._title, 20, SLATE, 24, HEADER + 27)
        self._write(plant, 17, GREY, 24, HEADER + 46)
        self._draw_robot(theta, torque, STICK if x_dot == 0.0 else SLIP)
        self._draw_figures(time, x, x_dot, torque)
        averaged = pygame.transform.smoothscale(self._canvas, (WIDTH, HEIGHT))
        self._frame.blit(averaged, (0, 0))
        if self._mode == "rgb_array":
            return self._pixels.copy()
        self._window.blit(self._frame, (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)
        return None

    def _close_if_asked(self) -> None:
        """Closes the window if the user or `pygame.quit()` in other code has closed it."""
        pygame = self._pygame
        lost = not pygame.display.get_init()
        # Taking every event keeps the queue from filling up.
        if lost or any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            # Ends the others, too: the user has closed the window of all.
            pygame.display.quit()

    def close(self) -> None:
        """Closes the window, unless another renderer draws in it; safe to call again."""
        self.closed = True
        if self._window is not None:
            self._window = None
            _SHOWN.discard(self)
            if not _SHOWN:
                self._pygame.display.quit()

    def _draw_background(self, x: float) -> None:
        """Draws the ruler with the platform at x in the middle, and the inside of the shell."""
        self._canvas.fill(WHITE)
        self._box(0, HEADER, WIDTH, 1, HAIRLINE)
        self._box(0, HEADER + 1, WIDTH, FLOOR - HEADER - 1, PAPER)
        self._box(0, FLOOR, WIDTH, RULER, FLOOR_FILL)
        start = MIDDLE - x / self._major * self._major_pixels
        first = math.floor(-start / self._major_pixels)
        left = round(SCALE * (start + first * self._major_pixels)) / SCALE
        marks = math.ceil(WIDTH / self._major_pixels) + 2
        centimetres = 100.0 * self._major
        decimals = max(0, -round(math.log10(centimetres)))
        self._draw_shell(MIDDLE, INSIDE)
        for mark in range(marks):
            at = left + mark * self._major_pixels
            label = _number(centimetres * (first + mark), decimals)
            self._box(at, GRID_TOP, 1, FLOOR - GRID_TOP, GRID)
            self._box(at, FLOOR, 1, 13, TICK)
            for part in range(1, 10):
                self._box(at + part * self._major_pixels / 10, FLOOR, 1, 6, TICK)
            self._write(label, 17, GREY, at + 0.5, FLOOR + 28, "midtop")
        self._box(0, FLOOR - 1, WIDTH, 2, TICK)

    def _draw_ghost(self, name: str, theta: float, ghost_x: float, x: float) -> None:
        """Draws the other robot as an outline at its place on the floor, and its distance."""
        distance = ghost_x - x
        offset = distance / self._major * self._major_pixels
        if abs(offset) < WIDTH / 2 + SHELL_HALF:
            self._draw_shell(MIDDLE + offset, GHOST, 2)
            ball_x, ball_y = _polar(theta, ROD)
            ball_x += offset
            self._ribbon([(MIDDLE + offset, FLOOR - PIVOT), (ball_x, ball_y)], 5.0, GHOST)
            self._disc((ball_x, ball_y), BALL, GHOST)
            self._write(name, 16, GREY, ball_x + BALL + 6, ball_y + 5)
        centimetres = _number(100.0 * abs(distance), 1)
        side = "ahead" if distance > 0.0 else "behind"
        text = f"{name} {centimetres} cm {side}"
        self._write(text, 17, GREY, WIDTH - 24, HEADER + 27, "topright")

    def _draw_shell(self, middle: float, colour: str, line: float = 0.0) -> None:
        """Draws the shell of a robot: filled, or an inner border of `line` pixels."""
        left, top = middle - SHELL_HALF, FLOOR - SHELL_HEIGHT
        radius = SHELL_HEIGHT / 2
        self._box(left, top, 2 * SHELL_HALF, SHELL_HEIGHT, colour, radius, line)

    def _draw_robot(self, theta: float, torque: float, contact: str) -> None:
        """Draws the contact and the platform, the motor's torque, the spring and the pendulum."""
        pivot, ball = _polar(0.0, 0.0), _polar(theta, ROD)
        foot = SHELL_HALF - SHELL_HEIGHT / 2 + 6
        deck = FLOOR - PLATFORM_HEIGHT - 3
        post = SPRING_OUTER + 8
        self._draw_shell(MIDDLE, contact, 3)
        self._box(MIDDLE - foot, FLOOR - 1, 2 * foot, 7, contact)
        self._box(MIDDLE - PLATFORM_HALF, deck, 2 * PLATFORM_HALF, PLATFORM_HEIGHT, SLATE, 5)
        self._box(MIDDLE - post, FLOOR - PIVOT, 2 * post, PIVOT - PLATFORM_HEIGHT, SLATE)
        self._disc(pivot, post, SLATE)
        self._disc(pivot, SPRING_OUTER + 4, PAPER)
        self._draw_torque(torque)
        # The inner end of the spring turns with the rod, the platform holds the outer one.
        angles = np.linspace(theta, 2.0 * math.pi * SPRING_TURNS, 72)
        radii = np.linspace(SPRING_INNER, SPRING_OUTER, 72)
        self._ribbon(np.transpose(_polar(angles, radii)), 2.5, SHELL)
        self._ribbon([pivot, ball], 7.0, INK)
        self._disc(pivot, 9, INK)
        self._disc(ball, BALL, BALL_COLOUR)

    def _draw_torque(self, torque: float) -> None:
        """Draws an arc arrow the way the motor turns: from the upright, a quarter turn at most."""
        end = 0.5 * math.pi * max(-1.0, min(1.0, torque / self._torque_limit))
        if abs(end) <= SMALLEST_ARROW:
            return
        head = math.copysign(min(0.22, abs(end)), end)
        base = end - head
        half = 50.0 * abs(head)
        arc = np.linspace(0.0, base + 0.2 * head, 13)
        tip = [_polar(end, GAUGE), _polar(base, GAUGE - half), _polar(base, GAUGE + half)]
        self._ribbon(np.transpose(_polar(arc, GAUGE)), 7.0, TORQUE)
        self._polygon(tip, TORQUE)

    def _draw_figures(self, time: float, x: float, x_dot: float, torque: float) -> None:
        """Draws the numbers and the contact.

        Numbers are right-aligned, so that no digit moves when another appears.
        """
        mean_speed = 100.0 * x / time if time > 0.0 else 0.0
        figures = (
            ("TIME", _number(time, 2), "s", INK),
            ("DISPLACEMENT", _number(100.0 * x, 1), "cm", INK),
            ("SPEED", _number(100.0 * x_dot, 1), "cm/s", INK),
            ("MEAN SPEED", _number(mean_speed, 2), "cm/s", INK),
            ("TORQUE", _number(torque, 2), "N m", TORQUE),
        )
        for column, (label, number, unit, colour) in enumerate(figures):
            left = COLUMN * column
            self._write(label, 16, GREY, left + 24, 26)
            self._write(number, 32, colour, left + VALUE_RIGHT, VALUE_BASELINE, "topright")
            self._write(unit, 19, GREY, left + VALUE_RIGHT + 6, VALUE_BASELINE)
            self._box(left + COLUMN, 16, 1, HEADER - 32, HAIRLINE)
        contact, colour = ("STICK", STICK) if x_dot == 0.0 else ("SLIP", SLIP)
        left = COLUMN * len(figures) + 24
        self._write("CONTACT", 16, GREY, left, 26)
        self._write(contact, 32, colour, left, VALUE_BASELINE)

    def _box(
        self,
        x: float,
        y: float,
        width: float,
        height: float,
        colour: str,
        radius: float = 0.0,
        line: float = 0.0,
    ) -> None:
        """Draws a rectangle with rounded corners: filled, or an inner border of `line` pixels."""
        sides = [round(SCALE * side) for side in (x, y, width, height)]
        border, corners = round(SCALE * line), round(SCALE * radius)
        self._pygame.draw.rect(self._canvas, colour, sides, border, border_radius=corners)

    def _disc(self, centre: tuple[float, float], radius: float, colour: str) -> None:
        """Draws a filled disc."""
        x, y = centre
        self._pygame.draw.circle(self._canvas, colour, (SCALE * x, SCALE * y), SCALE * radius)

    def _polygon(self, corners: Points, colour: str) -> None:
        """Draws a filled polygon."""
        scaled = np.rint(SCALE * np.asarray(corners))
        self._pygame.draw.polygon(self._canvas, colour, scaled.tolist())

    def _ribbon(self, points: Points, width: float, colour: str) -> None:
        """Draws a line through the points as one polygon.

        pygame's thick lines have gaps and are thin where slanted.
        """
        points = np.asarray(points, np.float64)
        ends = np.concatenate((points[:1], points, points[-1:]))
        along = ends[2:] - ends[:-2]
        across = along[:, ::-1] * (-1.0, 1.0)
        lengths = np.hypot(along[:, :1], along[:, 1:])
        across *= 0.5 * width / np.maximum(lengths, 1e-9)
        left, right = points + across, points - across
        self._polygon(np.concatenate((left, right[::-1])), colour)

    def _write(
        self,
        text: str,
        size: int,
        colour: str,
        x: float,
        baseline: float,
        anchor: str = "topleft",
    ) -> None:
        """Draws text whose left ("topleft"), middle ("midtop") or right ("topright") is at x."""
        image, ascent = self._text(text, size, colour)
        place = round(SCALE * x), round(SCALE * baseline) - ascent
        self._canvas.blit(image, image.get_rect(**{anchor: place}))

    def _draw_text(self, text: str, size: int, colour: str) -> tuple[Any, int]:
        """The picture of a text, and its height above the baseline in pixels of the canvas."""
        # Other environments call pygame.quit() when they close, which voids every font in the
        # process. pygame contains its default font, so every machine has it.
        self._pygame.font.init()
        font = self._pygame.font.Font(None, SCALE * size)
        return font.render(text, True, colour), font.get_ascent()
