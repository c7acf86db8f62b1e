"""The moving picture of the robot: a window, RGB frames or a GIF.

pygame draws and pillow writes; both are imported only when needed.
"""

from __future__ import annotations

import functools
import importlib
import math
import os
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from capsule_gym.files import replacing
from capsule_gym.parameters import Capsule
from capsule_gym.task import ENV_ID

Colour = tuple[int, int, int] | tuple[int, int, int, int]
Points = NDArray[np.float64] | Sequence[tuple[float, float]]
Align = Literal["left", "centre", "right"]

# Everything is drawn at twice the size and averaged down, which anti-aliases every shape and text alike.
SCALE = 2
# Between the frames of a moving picture: 25 a second, which a GIF can keep exactly.
FRAME_SECONDS = 0.04
WIDTH, HEIGHT = 960, 450

# Layout in pixels of the finished frame.
HEADER, FLOOR, RULER = 76, 378, 36
COLUMN, VALUE_RIGHT, VALUE_BASELINE = 160, 108, 58
# Sizes of the robot in pixels; the rod's length sets the scale of the ruler.
MIDDLE = WIDTH / 2
ROD, BALL, PIVOT = 168.0, 19.0, 67.0
SHELL_HEIGHT = PIVOT + ROD + BALL + 12.0
SHELL_HALF = 224.0
PLATFORM_HALF, PLATFORM_HEIGHT = 68.0, 25.0
GAUGE = 72.0
SPRING_INNER, SPRING_OUTER, SPRING_TURNS = 9.0, 31.0, 2.5
# Pixels of the speed arrow per m/s, and its longest.
SPEED_ARROW, SPEED_ARROW_LIMIT = 320.0, 220.0
TRAIL_SECONDS = 0.07
BANNER, BANNER_HALF = FLOOR + 2, 330.0

PAPER: Colour = (247, 249, 252)
WHITE: Colour = (255, 255, 255)
FLOOR_FILL: Colour = (233, 238, 244)
GRID: Colour = (234, 239, 245)
HAIRLINE: Colour = (217, 224, 233)
TICK: Colour = (148, 160, 177)
GREY: Colour = (109, 122, 141)
INK: Colour = (30, 41, 59)
SLATE: Colour = (71, 85, 105)
SHELL: Colour = (128, 150, 181)
INSIDE: Colour = (231, 236, 243)
BALL_COLOUR: Colour = (13, 128, 124)
TORQUE: Colour = (139, 76, 199)
STICK: Colour = (37, 99, 186)
SLIP: Colour = (238, 128, 36)
GHOST: Colour = (196, 205, 217)


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
        message = 'pygame is not installed, run: pip install "capsule-gym[render]"'
        raise gymnasium.error.DependencyNotInstalled(message) from error
    return pygame


def blend(a: Colour, b: Colour, share: float) -> Colour:
    """The colour `share` of the way from a to b, without transparency."""
    red, green, blue, _ = import_pygame().Color(*a[:3]).lerp(b[:3], share)
    return red, green, blue


class Canvas:
    """A picture of WIDTH x HEIGHT pixels, the origin at the top left. It needs no window and no video driver.

    Args:
        transparent: whether the ground is see-through, for a layer that lies over another canvas.
    """

    def __init__(self, transparent: bool = False) -> None:
        self._pygame = pygame = import_pygame()
        pygame.font.init()
        size = (SCALE * WIDTH, SCALE * HEIGHT)
        self._surface = pygame.Surface(size, pygame.SRCALPHA if transparent else 0, 32)
        self._origin = (0, 0)
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
        return self._pygame.transform.smoothscale(self._surface, (WIDTH, HEIGHT))

    def box(
        self, x: float, y: float, width: float, height: float, colour: Colour, radius: float = 0.0, line: float = 0.0
    ) -> None:
        """A rectangle with corners of that radius: filled, or only an inner border of `line` pixels."""
        sides = [round(SCALE * side) for side in (x, y, width, height)]
        self._pygame.draw.rect(self._surface, colour, sides, round(SCALE * line), border_radius=round(SCALE * radius))

    def disc(self, centre: tuple[float, float], radius: float, colour: Colour, line: float = 0.0) -> None:
        """A disc, or only its border of `line` pixels."""
        place = [SCALE * at for at in centre]
        self._pygame.draw.circle(self._surface, colour, place, SCALE * radius, round(SCALE * line))

    def polygon(self, corners: Points, colour: Colour) -> None:
        """A filled polygon."""
        self._pygame.draw.polygon(self._surface, colour, np.rint(SCALE * np.asarray(corners)).tolist())

    def ribbon(self, points: Points, width: float, colour: Colour) -> None:
        """A line through the points as one polygon: pygame's own thick lines are thin where they slant, and gape."""
        points = np.asarray(points, np.float64)
        across = np.gradient(points, axis=0)[:, ::-1] * (-1.0, 1.0)
        across *= (0.5 * width / np.maximum(np.hypot(across[:, 0], across[:, 1]), 1e-9))[:, None]
        self.polygon(np.concatenate((points + across, (points - across)[::-1])), colour)

    def write(self, text: str, size: int, colour: Colour, x: float, baseline: float, align: Align = "left") -> None:
        """Text whose left edge, centre or right edge is at x."""
        image, ascent = self._text(text, size, colour)
        anchor = {"left": "topleft", "centre": "midtop", "right": "topright"}[align]
        self._surface.blit(image, image.get_rect(**{anchor: (round(SCALE * x), round(SCALE * baseline) - ascent)}))

    def _render(self, text: str, size: int, colour: Colour) -> tuple[Any, int]:
        """The text as a surface, and the height of its top above its baseline."""
        font = self._font(size)
        try:
            return font.render(text, True, colour), font.get_ascent()
        except self._pygame.error:
            # Other environments call pygame.quit() when they close, which voids every font in the process.
            self._pygame.font.init()
            self._font.cache_clear()
            return self._render(text, size, colour)


def _nice_step(least: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is at least `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next((n * power for n in (1.0, 2.0, 5.0) if n * power >= least * (1.0 - 1e-9)), 10.0 * power)


def _number(value: float, decimals: int) -> str:
    """A number of at most eight characters, with a true minus sign and never "-0"."""
    # Adding 0.0 turns the -0.0 that small negative values round to into 0.0.
    text = f"{round(value, decimals) + 0.0:.{decimals}f}"
    if len(text) > 8:
        text = f"{value:.1e}"
    return text.replace("-", "\N{MINUS SIGN}")


def _polar(angle: Any, radius: Any) -> tuple[Any, Any]:
    """The point, or points, at that angle from the upright, growing to the left, and that distance from the pivot."""
    return MIDDLE - radius * np.sin(angle), FLOOR - PIVOT - radius * np.cos(angle)


# The layers that never change are shared by all renderers: a batch has one renderer per environment.
@functools.lru_cache(maxsize=4)
def _backdrop(title: str) -> Canvas:
    """What never moves and lies behind everything."""
    canvas = Canvas()
    canvas.box(0, 0, WIDTH, HEIGHT, PAPER)
    canvas.box(0, 0, WIDTH, HEADER, WHITE)
    canvas.box(0, HEADER, WIDTH, 1, HAIRLINE)
    canvas.box(0, FLOOR, WIDTH, RULER, FLOOR_FILL)
    canvas.box(0, FLOOR + RULER, WIDTH, HEIGHT - FLOOR - RULER, WHITE)
    for column, label in enumerate(("TIME", "DISPLACEMENT", "SPEED", "MEAN SPEED", "TORQUE", "CONTACT")):
        canvas.write(label, 16, GREY, COLUMN * column + 24, 26)
        if column:
            canvas.box(COLUMN * column, 16, 1, HEADER - 32, HAIRLINE)
    for column, unit in enumerate(("s", "cm", "cm/s", "cm/s", "N m")):
        canvas.write(unit, 19, GREY, COLUMN * column + VALUE_RIGHT + 6, VALUE_BASELINE)
    canvas.write(title, 20, SLATE, 24, HEADER + 27)
    return canvas


@functools.cache
def _body(contact: Colour) -> Canvas:
    """The shell, the platform and the gauge's scale: the camera follows them, so they never move."""
    layer = Canvas(transparent=True)
    shell = (MIDDLE - SHELL_HALF, FLOOR - SHELL_HEIGHT, 2 * SHELL_HALF, SHELL_HEIGHT)
    layer.box(*shell, (*SHELL[:3], 34), radius=SHELL_HEIGHT / 2)
    layer.box(*shell, blend(WHITE, contact, 0.6), radius=SHELL_HEIGHT / 2, line=3)
    deck = FLOOR - PLATFORM_HEIGHT - 3
    layer.box(MIDDLE - PLATFORM_HALF, deck, 2 * PLATFORM_HALF, PLATFORM_HEIGHT, SLATE, radius=5)
    pivot = FLOOR - PIVOT
    tower = [(MIDDLE + side, y) for side, y in ((-46, deck + 2), (-30, pivot), (30, pivot), (46, deck + 2))]
    layer.polygon(tower, SLATE)
    layer.disc((MIDDLE, pivot), SPRING_OUTER + 8, SLATE)
    layer.disc((MIDDLE, pivot), SPRING_OUTER + 4, PAPER)
    for degrees in range(-90, 91, 15):
        long = 7 if degrees % 90 == 0 else 4
        angle = math.radians(degrees)
        layer.ribbon([_polar(angle, GAUGE - long), _polar(angle, GAUGE + long)], 1.0, TICK)
    half = SHELL_HALF - SHELL_HEIGHT / 2 + 6
    layer.box(MIDDLE - half, FLOOR - 1, 2 * half, 7, contact, radius=2)
    layer.crop()
    return layer


class Ghost(NamedTuple):
    """Another robot on the same floor, drawn pale behind the first.

    Attributes:
        name: shown with its distance.
        theta: angle of its pendulum from the upright, rad.
        x: displacement of its platform, m.
    """

    name: str
    theta: float
    x: float


class Renderer:
    """Draws the robot on its floor, and its figures.

    The camera follows the platform, so the ruler moves beneath it. Blue is stick, orange is slip.

    In mode "human" a closed window ends the show, not the programme: later draws do nothing. In mode "rgb_array" no
    window, display or video driver is touched.

    Args:
        capsule: the robot; its l sets the scale.
        mode: "human" for a window, "rgb_array" for frames.
        fps: frames per second that the window is held to.
        torque_limit: torque that fills the gauge, N m.
        title: shown in the picture, where some 30 characters fit, and on the window.
        on_key: called for every key of the window with pygame's name of it, and whether it is pressed or released.

    Raises:
        gymnasium.error.DependencyNotInstalled: if pygame is not installed.
    """

    def __init__(
        self,
        capsule: Capsule,
        mode: str,
        fps: int,
        torque_limit: float,
        title: str = ENV_ID,
        on_key: Callable[[str, bool], None] | None = None,
    ) -> None:
        self._mode, self._title, self._fps, self._torque_limit = mode, title, fps, torque_limit
        self._major = _nice_step(50.0 * capsule.l / ROD)
        # A whole number of canvas pixels between labelled marks: the marks then move as one and do not shimmer.
        self._major_pixels = round(SCALE * ROD / capsule.l * self._major) / SCALE
        self._closed, self._on_key, self._canvas = False, on_key, Canvas()
        self._pygame = import_pygame()
        self._window: Any = None
        if mode == "human":
            self._pygame.display.init()
            self._pygame.display.set_caption(title)
            self._window = self._pygame.display.set_mode((WIDTH, HEIGHT))
            self._clock = self._pygame.time.Clock()

    def draw(
        self,
        *,
        theta: float,
        theta_dot: float,
        x: float,
        x_dot: float,
        torque: float,
        time: float,
        M: float,
        mu: float,
        theta_reference: float | None = None,
        ghost: Ghost | None = None,
        note: str = "",
        banner: str = "",
    ) -> NDArray[np.uint8] | None:
        """Draws one frame and, in a window, waits until it is due.

        Args:
            theta: angle of the pendulum from the upright, rad.
            theta_dot: its rate, rad/s.
            x: displacement of the platform, m.
            x_dot: its velocity, m/s; it sticks where this is exactly 0.0.
            torque: motor torque, N m.
            time: time since the start of the episode, s.
            M: mass of the platform, kg.
            mu: friction coefficient.
            theta_reference: angle that a controller follows, rad; None draws none.
            ghost: another robot.
            note: a line of some 110 characters below the ruler.
            banner: a line of some 70 characters across the ruler.

        Returns:
            The frame as an array of uint8, (450, 960, 3), in mode "rgb_array"; None in mode "human".

        Raises:
            gymnasium.error.ClosedEnvironmentError: after `close`.
        """
        if self._closed:
            raise gymnasium.error.ClosedEnvironmentError("draw() was called after close(): make a new Renderer")
        if self._window is not None:
            self._handle_events()
        if self.closed:
            return None
        contact = STICK if x_dot == 0.0 else SLIP
        self._canvas.overlay(_backdrop(self._title))
        self._draw_floor(x)
        if ghost is not None:
            self._draw_ghost(ghost, x)
        self._canvas.overlay(_body(contact))
        self._draw_speed(x_dot)
        self._draw_torque(torque)
        self._draw_pendulum(theta, theta_dot, theta_reference)
        self._draw_figures(theta, time, x, x_dot, torque, contact)
        self._canvas.write(f"M {M:.3f} kg     \N{GREEK SMALL LETTER MU} {mu:.4f}", 17, GREY, 24, HEADER + 46)
        self._canvas.write(note, 16, GREY, 24, HEIGHT - 13)
        if banner:
            self._canvas.box(MIDDLE - BANNER_HALF, BANNER, 2 * BANNER_HALF, 32, INK, radius=6)
            self._canvas.write(banner, 20, WHITE, MIDDLE, BANNER + 22, "centre")
        frame = self._canvas.frame()
        if self._mode == "rgb_array":
            pixels = bytearray(self._pygame.image.tobytes(frame, "RGB"))
            return np.frombuffer(pixels, np.uint8).reshape(HEIGHT, WIDTH, 3)
        self._window.blit(frame, (0, 0))
        self._pygame.display.flip()
        self._clock.tick(self._fps)
        return None

    def close(self) -> None:
        """Closes the window, if there is one; safe to call again."""
        self._closed = True
        self._close_window()

    def _close_window(self) -> None:
        if self._window is not None:
            self._window = None
            self._pygame.display.quit()

    @property
    def closed(self) -> bool:
        """Whether nothing is drawn any more: after `close`, or since its user closed the window."""
        return self._closed or (self._mode == "human" and self._window is None)

    def _handle_events(self) -> None:
        """Passes the window's keys on, and closes it when its user or `pygame.quit()` of others does."""
        # Taking every event keeps the queue from filling up.
        events = self._pygame.event.get() if self._pygame.display.get_init() else None
        if events is None or any(event.type == self._pygame.QUIT for event in events):
            self._close_window()
            return
        for event in events:
            if self._on_key is not None and event.type in (self._pygame.KEYDOWN, self._pygame.KEYUP):
                self._on_key(self._pygame.key.name(event.key), event.type == self._pygame.KEYDOWN)

    def _draw_floor(self, x: float) -> None:
        """The ruler as it passes beneath the robot, and the flag at the start."""
        start = MIDDLE - x / self._major * self._major_pixels
        first = math.floor(-start / self._major_pixels)
        left = round(SCALE * (start + first * self._major_pixels)) / SCALE
        step = 100.0 * self._major
        # As many as distinguish its multiples.
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        for mark in range(math.ceil(WIDTH / self._major_pixels) + 2):
            at = left + mark * self._major_pixels
            self._canvas.box(at, HEADER + 54, 1, FLOOR - HEADER - 54, GRID)
            for part in range(10):
                length = 13 if part == 0 else 9 if part == 5 else 6
                self._canvas.box(at + part * self._major_pixels / 10, FLOOR, 1, length, TICK)
            self._canvas.write(_number(step * (first + mark), decimals), 17, GREY, at + 0.5, FLOOR + 28, "centre")
        if -100.0 < start < WIDTH + 100.0:
            self._canvas.polygon([(start, FLOOR - 92), (start + 28, FLOOR - 82), (start, FLOOR - 72)], INK)
            self._canvas.box(start - 0.5, FLOOR - 93, 2, 93, INK)
        self._canvas.box(0, FLOOR - 1, WIDTH, 2, TICK)

    def _draw_ghost(self, ghost: Ghost, x: float) -> None:
        """The other robot as an outline at its place on the floor, and its distance."""
        canvas, distance = self._canvas, ghost.x - x
        offset = distance / self._major * self._major_pixels
        if abs(offset) < WIDTH / 2 + SHELL_HALF:
            left, top = MIDDLE + offset - SHELL_HALF, FLOOR - SHELL_HEIGHT
            canvas.box(left, top, 2 * SHELL_HALF, SHELL_HEIGHT, GHOST, radius=SHELL_HEIGHT / 2, line=2)
            pivot, ball = ((at + offset, y) for at, y in (_polar(0.0, 0.0), _polar(ghost.theta, ROD)))
            canvas.ribbon([pivot, ball], 5.0, GHOST)
            canvas.disc(ball, BALL, GHOST)
        text = f"{ghost.name} {_number(100.0 * abs(distance), 1)} cm {'ahead' if distance > 0.0 else 'behind'}"
        canvas.write(text, 17, GREY, WIDTH - 24, HEADER + 46, "right")

    def _draw_speed(self, x_dot: float) -> None:
        """An arrow above the shell, as long as the platform is fast."""
        length = max(-SPEED_ARROW_LIMIT, min(SPEED_ARROW_LIMIT, SPEED_ARROW * x_dot))
        if abs(length) < 1.0:
            return
        y = FLOOR - SHELL_HEIGHT - 16
        head = math.copysign(min(13.0, abs(length)), length)
        tip = MIDDLE + length
        if abs(length) > abs(head):
            self._canvas.ribbon([(MIDDLE, y), (tip - 0.8 * head, y)], 5.0, SLIP)
        half = 0.7 * abs(head)
        self._canvas.polygon([(tip, y), (tip - head, y - half), (tip - head, y + half)], SLIP)

    def _draw_torque(self, torque: float) -> None:
        """An arc arrow around the pivot: from the upright, a quarter turn at the limit, the way the motor turns."""
        share = max(-1.0, min(1.0, torque / self._torque_limit))
        if abs(share) < 0.01:
            return
        end = 0.5 * math.pi * share
        head = math.copysign(min(0.22, abs(end)), end)
        if abs(end) > abs(head):
            arc = np.transpose(_polar(np.linspace(0.0, end - 0.8 * head, 13), GAUGE))
            self._canvas.ribbon(arc, 7.0, TORQUE)
        base, half = end - head, 50.0 * abs(head)
        self._canvas.polygon([_polar(end, GAUGE), _polar(base, GAUGE - half), _polar(base, GAUGE + half)], TORQUE)

    def _draw_pendulum(self, theta: float, theta_dot: float, theta_reference: float | None) -> None:
        """The spring, the reference, the rod, and the ball with a trail of its last moments."""
        canvas = self._canvas
        if theta_reference is not None:
            for start in np.arange(GAUGE + 18.0, ROD - BALL, 12.0):
                canvas.ribbon([_polar(theta_reference, start), _polar(theta_reference, start + 6.0)], 2.0, TICK)
            canvas.disc(_polar(theta_reference, ROD), BALL, TICK, line=2)
        swept = max(-1.0, min(1.0, TRAIL_SECONDS * theta_dot))
        trail = np.linspace(np.clip(theta - swept, -0.5 * math.pi, 0.5 * math.pi), theta, 17)
        for i in range(16):
            around = ((i, 1), (i, -1), (i + 1, -1), (i + 1, 1))
            corners = [_polar(trail[j], ROD + side * BALL * j / 16) for j, side in around]
            canvas.polygon(corners, blend(INSIDE, BALL_COLOUR, 0.45 * (i / 16) ** 1.5))
        # The inner end turns with the rod, the outer one is held by the platform.
        turns = np.linspace(theta, 2.0 * math.pi * SPRING_TURNS, 72)
        canvas.ribbon(np.transpose(_polar(turns, np.linspace(SPRING_INNER, SPRING_OUTER, 72))), 2.5, SHELL)
        canvas.ribbon([_polar(theta, 0.0), _polar(theta, ROD)], 7.0, INK)
        canvas.disc(_polar(theta, 0.0), 9, INK)
        canvas.disc(_polar(theta, 0.0), 4, WHITE)
        x, y = _polar(theta, ROD)
        canvas.disc((x, y), BALL, BALL_COLOUR)
        canvas.disc((x - 6, y - 7), 6, blend(BALL_COLOUR, WHITE, 0.35))

    def _draw_figures(self, theta: float, time: float, x: float, x_dot: float, torque: float, contact: Colour) -> None:
        """The numbers, right-aligned, so that no digit moves when another appears; stick, or slip and which way."""
        canvas, mean = self._canvas, x / time if time > 0.0 else 0.0
        figures = ((time, 2), (100.0 * x, 1), (100.0 * x_dot, 1), (100.0 * mean, 2), (torque, 2))
        for column, (value, decimals) in enumerate(figures):
            colour = TORQUE if column == 4 else INK
            canvas.write(_number(value, decimals), 32, colour, COLUMN * column + VALUE_RIGHT, VALUE_BASELINE, "right")
        degrees = _number(math.degrees(theta), 1) + "\N{DEGREE SIGN}"
        canvas.write("\N{GREEK SMALL LETTER THETA}", 22, GREY, WIDTH - 106, HEADER + 27)
        canvas.write(degrees, 22, INK, WIDTH - 24, HEADER + 27, "right")
        canvas.box(822, 33, 114, 31, contact, radius=15)
        canvas.write("STICK" if x_dot == 0.0 else "SLIP", 22, WHITE, 879, 55, "centre")
        if x_dot != 0.0:
            side = math.copysign(1.0, x_dot)
            canvas.polygon([(879 + side * dx, 48.5 + dy) for dx, dy in ((44, 0), (33, -7), (33, 7))], WHITE)


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
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError('pillow is not installed, run: pip install "capsule-gym[render]"') from error
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
    options: dict[str, Any] = {"duration": round(1000 * frame_seconds), "loop": 0, "optimize": True}
    with replacing(path) as temporary:
        pictures[0].save(temporary, save_all=True, append_images=pictures[1:], **options)
