"""The style of the figures: colours, line styles, notes, and reproducible files."""

import os
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from capsule_gym.files import replacing

# Okabe and Ito's colours, distinct in every common colour blindness; the dashes distinguish them in
# grey.
BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN = "#009E73"
PURPLE = "#AA4499"
INK = "#222222"
MUTED = "#767676"

WIDTH = 7.0
NOTE_COLUMNS = 122
DPI = 200

STYLE = Path(__file__).with_name("figures.mplstyle")
COLOURS = [BLUE, VERMILION, GREEN, PURPLE, "#E69F00", "#56B4E9", INK]

# The arguments of `Axes.plot` for each of the compared items.
PENS: dict[str, dict[str, Any]] = {
    "proposed": {"color": BLUE, "linestyle": "-"},
    "EPC": {"color": VERMILION, "linestyle": (0.0, (5.0, 1.6))},
}
# Wide and pale, since the computed trajectory is drawn on top of it.
REFERENCE: dict[str, Any] = {"color": "#c5ccd6", "lw": 3.6, "zorder": 1.5}
PUBLISHED_DASHES = (0.0, (1.2, 1.6))
# matplotlib stamps the date into SVG and its version into PNG.
STAMPS = {"svg": {"Date": None, "Creator": None}, "png": {"Software": None}}


@contextmanager
def style() -> Iterator[None]:
    """Draws and saves in the style of this project, whatever the user's configuration.

    Raises:
        ImportError: if matplotlib is not installed.
    """
    # With the backend of another environment, as in a shell of a notebook, matplotlib cannot be
    # imported. The figures have canvases of their own.
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        from matplotlib import style as matplotlib_style
    except ImportError as error:
        raise ImportError('figures need matplotlib: pip install "capsule-gym[paper]"') from error
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    cycle = {"axes.prop_cycle": f"cycler('color', {COLOURS})"}
    with matplotlib_style.context(["default", STYLE, cycle]):
        yield


def new_figure(height: float, width: float = WIDTH) -> Any:
    """An empty figure with its own canvas, `height` inches high.

    It has the full text width, or is `width` inches wide.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def add_note(figure: Any, text: str) -> None:
    """Adds a note below the figure."""
    text = textwrap.fill(text, NOTE_COLUMNS, break_on_hyphens=False)
    figure.supxlabel(text, x=0.012, ha="left", fontsize=7.5, color=INK, parse_math=False)


def mark_published(
    axes: Any, value: float, text: str, colour: str = INK, *, x: float = 0.99
) -> None:
    """Draws a dotted line across the axes at a published number.

    Its label is at x, a share of the width.
    """
    axes.axhline(value, color=colour, linestyle=PUBLISHED_DASHES, linewidth=1.1)
    axes.annotate(
        text,
        (x, value),
        xycoords=axes.get_yaxis_transform(),
        xytext=(0.0, 2.0),
        textcoords="offset points",
        ha="right" if x > 0.5 else "left",
        va="bottom",
        fontsize=7.0,
        color=colour,
    )


def save(figure: Any, stem: Path) -> list[Path]:
    """Writes `stem`.svg and `stem`.png atomically; the folder must exist.

    The same figure gives the same bytes.
    """
    # Computes the constrained layout once: it takes longer than the drawing, and would run for each
    # file.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    written = []
    for kind, metadata in STAMPS.items():
        path = stem.with_name(f"{stem.name}.{kind}")
        with replacing(path) as temporary:
            figure.savefig(temporary, format=kind, dpi=DPI, metadata=metadata)
        written.append(path)
    return written
