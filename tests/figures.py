"""What figures of matplotlib show."""

import numpy as np
from matplotlib.colors import to_hex


def assert_lines(axes, *expected):
    """Asserts the lines of a panel in their order; of each, x, y and colour."""
    lines = [line for line in axes.lines if len(line.get_xdata())]
    assert_colours([line.get_color() for line in lines], expected)
    for line, (x, y, _) in zip(lines, expected, strict=True):
        points = np.transpose(np.broadcast_arrays(x, y))
        np.testing.assert_allclose(line.get_xydata(), points, rtol=1e-12, atol=1e-12)


def assert_bars(axes, *expected):
    """Asserts the horizontal bars of a panel in their order; of each, its place and colour.

    The place is the height of its centre and its length.
    """
    assert_colours([bar.get_facecolor() for bar in axes.patches], expected)
    places = [(bar.get_y() + 0.5 * bar.get_height(), bar.get_width()) for bar in axes.patches]
    np.testing.assert_allclose(places, [bar[:2] for bar in expected], atol=1e-12)


def assert_colours(found, expected):
    """Asserts colours, the last of each expected tuple."""
    assert list(map(to_hex, found)) == [to_hex(colour) for *_, colour in expected]


def texts(ticks_or_texts):
    """The texts of ticks or of a legend."""
    return [each.get_text() for each in ticks_or_texts]
