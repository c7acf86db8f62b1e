"""The canvas: where a shape lies, and that it is drawn smoothly."""

from __future__ import annotations

import numpy as np
import pytest

from capsule_gym.rendering import Canvas, blend

pytest.importorskip("pygame")

WHITE, RED = (255, 255, 255), (255, 0, 0)


def drawn(canvas: Canvas) -> np.ndarray:
    """How much of each pixel is covered by red, 0 to 1."""
    return 1.0 - canvas.array()[:, :, 1] / 255.0


@pytest.fixture
def canvas() -> Canvas:
    made = Canvas(60, 40)
    made.fill(WHITE)
    return made


def test_the_array_is_the_callers_own(canvas):
    first = canvas.array()
    assert (first.shape, first.dtype) == ((40, 60, 3), np.uint8)
    assert first.flags.writeable and first.flags.c_contiguous
    first[:] = 0
    assert (canvas.array() == 255).all()


def test_a_box_covers_its_pixels_and_no_others(canvas):
    canvas.box(10, 5, 20, 8, RED)
    covered = drawn(canvas)
    assert (covered[5:13, 10:30] == 1.0).all()
    assert covered.sum() == 20 * 8


def test_a_border_leaves_the_inside_alone(canvas):
    canvas.box(10, 5, 20, 10, RED, line=2)
    assert drawn(canvas).sum() == 20 * 10 - 16 * 6


def test_a_disc_has_its_area_and_smooth_edges(canvas):
    canvas.disc((30.0, 20.0), 10.0, RED)
    covered = drawn(canvas)
    assert covered.sum() == pytest.approx(np.pi * 100.0, rel=0.03)
    assert np.count_nonzero((covered > 0.1) & (covered < 0.9)) > 20
    y, x = np.indices(covered.shape)
    assert (covered * x).sum() / covered.sum() == pytest.approx(29.5, abs=0.3)
    assert (covered * y).sum() / covered.sum() == pytest.approx(19.5, abs=0.3)


@pytest.mark.parametrize("degrees", [0, 20, 45, 70, 90])
def test_a_ribbon_is_as_wide_where_it_slants(canvas, degrees):
    along = 15.0 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    canvas.ribbon([(30 - along[0], 20 - along[1]), (30 + along[0], 20 + along[1])], 4.0, RED)
    assert drawn(canvas).sum() == pytest.approx(30.0 * 4.0, rel=0.2)


@pytest.mark.parametrize("align", ["left", "centre", "right"])
def test_text_stands_at_its_edge(canvas, align):
    canvas.write("HHH", 16, RED, 30.0, 25.0, align)
    columns = np.flatnonzero(drawn(canvas).max(axis=0) > 0.2)
    rows = np.flatnonzero(drawn(canvas).max(axis=1) > 0.2)
    edge = {"left": columns[0], "centre": (columns[0] + columns[-1] + 1) / 2, "right": columns[-1] + 1}[align]
    assert edge == pytest.approx(30.0, abs=1.6)
    assert rows[-1] + 1 == pytest.approx(25.0, abs=1.1)


def test_a_cropped_layer_is_laid_where_it_was_drawn(canvas):
    layer = Canvas(60, 40, transparent=True)
    layer.box(42, 11, 6, 7, RED)
    layer.crop()
    canvas.overlay(layer)
    covered = drawn(canvas)
    assert (covered[11:18, 42:48] == 1.0).all()
    assert covered.sum() == 6 * 7


def test_blends_lie_on_the_way_between_the_colours():
    assert blend((0, 100, 200), (200, 100, 0), 0.0) == (0, 100, 200)
    assert blend((0, 100, 200), (200, 100, 0), 1.0) == (200, 100, 0)
    assert blend((0, 100, 200, 7), (200, 100, 0, 9), 0.25) == pytest.approx((50, 100, 150), abs=1)
